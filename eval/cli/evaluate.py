"""``moteslam evaluate``: trajectories against another one, or against hand-checked relations."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moteslam.errors import InputError, MoteslamError, OutputError
from moteslam.eval.cli import options
from moteslam.eval.cli.text import bold, literal, note, say, say_json, table

if TYPE_CHECKING:
    from moteslam.eval.evaluation import AgainstRelations, AgainstTrajectory


def evaluate(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="EST... REF",
            help="Trajectories to score, TUM format; last the reference, a TUM trajectory or .relations.",
        ),
    ],
    no_align: Annotated[
        bool, typer.Option("--no-align", help="Take all in the frame they are in, for the absolute error.")
    ] = False,
    delta: Annotated[float, typer.Option(help="Length of a pair for the relative error.")] = 1.0,
    unit: Annotated[str, typer.Option(metavar="m|s|frames", help="Unit of --delta.")] = "m",
    all_pairs: Annotated[
        bool, typer.Option("--all-pairs", help="A pair from every pose on, not one after another.")
    ] = False,
    max_difference: Annotated[
        float | None,
        typer.Option(min=0, metavar="S", help="Between stamps that belong together [0.01; 0.0001 for relations]."),
    ] = None,
    no_interpolate: Annotated[
        bool, typer.Option("--no-interpolate", help="Only relations with a pose at both of their stamps.")
    ] = False,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the result as JSON, with the error at every stamp.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw errors and trajectories as PNG.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace existing files of --save and --plot.")] = False,
    as_json: options.Json = False,
) -> None:
    """Score trajectories by another one, or by relations.

    Absolute and relative errors against a trajectory; against hand-checked relations, the mean and standard deviation
    of their errors. Several trajectories are scored side by side. A reference with more poses than the estimate is
    interpolated at the estimate's stamps; else each pose takes the nearest stamp. Relations are interpolated between
    poses; clear relations are those whose stamps each belong to exactly one pose.

    \b
    Examples:
      moteslam evaluate demo/trajectory.tum demo/truth.tum
      moteslam evaluate demo/trajectory.tum demo/truth.tum --delta 5 --unit s --json
      moteslam evaluate mine.tum theirs.tum odometry.tum truth.tum --plot errors.png
      moteslam evaluate result/trajectory.tum intel.relations
    """  # noqa: D301
    from moteslam.eval.evaluation import against_relations, against_trajectory
    from moteslam.eval.metrics.relations import is_relations, read_relations
    from moteslam.robot.trajectory import read_tum

    if len(paths) < 2:
        raise typer.BadParameter(
            "one file, expected trajectories and, last, their reference", param_hint="'EST... REF'"
        )
    for file in (save, plot):
        options.refuse_existing(file, force=force)
    if plot is not None and plot.suffix.lower() != ".png":
        raise OutputError("expected a name that ends in .png", file=plot)
    *estimates, reference = paths
    for file in estimates:
        if is_relations(file):
            raise InputError("holds relations, expected TUM trajectories, and the relations last", file=file)
    trajectories = {str(file): read_tum(file) for file in estimates}
    results: dict[str, AgainstTrajectory | AgainstRelations] = {}
    try:
        if is_relations(reference):
            relations = read_relations(reference)
            for name, trajectory in trajectories.items():
                results[name] = against_relations(
                    trajectory, relations, interpolate=not no_interpolate, tolerance=max_difference
                )
        else:
            truth = read_tum(reference)
            for name, trajectory in trajectories.items():
                results[name] = against_trajectory(
                    trajectory,
                    truth,
                    align=not no_align,
                    delta=delta,
                    unit=unit,
                    all_pairs=all_pairs,
                    max_difference=max_difference,
                )
    except MoteslamError as error:
        if error.file is None and error.field in ("delta", "unit", "max_difference"):
            raise InputError(error.problem, field=f"--{error.field.replace('_', '-')}") from error
        if error.file is None:
            raise InputError(error.problem, file=reference, field=error.field) from error
        raise
    _write(results, reference, save=save, plot=plot)
    if as_json:
        say_json(_summary(results, reference))
    else:
        _print(results, reference)


def _summary(results: dict[str, AgainstTrajectory | AgainstRelations], reference: Path) -> dict[str, Any]:
    """What ``--json`` prints: of one trajectory itself, of several a list."""
    rows = [{"estimate": name, "reference": str(reference), **result.as_dict()} for name, result in results.items()]
    return rows[0] if len(rows) == 1 else {"reference": str(reference), "results": rows}


def _write(
    results: dict[str, AgainstTrajectory | AgainstRelations], reference: Path, *, save: Path | None, plot: Path | None
) -> None:
    from moteslam.robot.files import folder_for

    if save is not None:
        from moteslam.eval.results import write_json

        rows = [
            {"estimate": name, "reference": str(reference), **result.as_dict(), "errors": result.errors()}
            for name, result in results.items()
        ]
        with folder_for(save):
            write_json(save, {"results": rows})
    if plot is not None:
        from moteslam.eval.report.comparison import draw_comparison

        with folder_for(plot):
            draw_comparison(plot, results, title=f"against {reference.name}")


def _print(results: dict[str, AgainstTrajectory | AgainstRelations], reference: Path) -> None:
    from moteslam.eval.evaluation import AgainstRelations, AgainstTrajectory

    for name, result in results.items():
        if isinstance(result, AgainstRelations):
            say(f"{literal(name)} against {literal(reference)}")
            say(_relation_table(result))
        elif len(results) == 1:
            say(f"{literal(name)} against {literal(reference)}")
            say(_trajectory_table(result))
        if isinstance(result, AgainstTrajectory):
            for issue in result.issues:
                note(f"warning: {name}: {issue}")
    compared = {name: result for name, result in results.items() if isinstance(result, AgainstTrajectory)}
    if len(compared) > 1:
        say(f"against {literal(reference)}")
        say(_comparison_table(compared))


def _relation_table(against: AgainstRelations) -> str:
    result = against.result
    rows = [("relations", "count", "translation [m]", "rotation [deg]")]
    for name, score in (("clear", result.clear), ("at stamps", result.at_stamps), ("all used", result.all)):
        if score is None:
            rows.append((name, "0", "-", "-"))
            continue
        along, turn = score.translation, score.rotation
        values = (f"{along.mean:.4f} +- {along.std:.4f}", f"{turn.mean:.3f} +- {turn.std:.3f}")
        rows.append((name, str(along.count), *values))
    used = bold(f"{result.used} of {result.total} relations used, {result.interpolated} of them between poses")
    return f"{table(rows, right=(1, 2, 3))}\n{used}"


def _trajectory_table(result: AgainstTrajectory) -> str:
    rows: list[tuple[str, ...]] = [("error", "count", "RMSE", "mean", "median", "std", "max")]
    scores = [("ATE" if result.aligned else "ATE, not aligned", result.ate.translation, result.ate.rotation)]
    if result.rpe is not None:
        rpe = result.rpe
        scores.append((f"RPE over {rpe.delta:g} {rpe.unit}", rpe.translation, rpe.rotation))
    for name, along, turn in scores:
        for what, form in (("m", "{:.4f}"), ("deg", "{:.3f}")):
            s = along if what == "m" else turn
            values = (s.rmse, s.mean, s.median, s.std, s.max)
            shown: Sequence[float] = values if what == "m" else [degrees(value) for value in values]
            rows.append((f"{name} [{what}]", str(s.count), *(form.format(value) for value in shown)))
    return table(rows, right=range(1, 7))


def _comparison_table(results: dict[str, AgainstTrajectory]) -> str:
    """A row a trajectory."""
    first = next(iter(results.values()))
    ate = "ATE" if first.aligned else "ATE, not aligned,"
    pairs = next((f"{r.rpe.delta:g} {r.rpe.unit}" for r in results.values() if r.rpe is not None), None)
    head = ("estimate", "poses", f"{ate} RMSE [m]", "median", "max", "heading RMSE [deg]")
    rows: list[tuple[str, ...]] = [(*head, f"RPE over {pairs}, RMSE [m]") if pairs else head]
    for name, result in results.items():
        along, turn = result.ate.translation, result.ate.rotation
        values = (f"{along.rmse:.4f}", f"{along.median:.4f}", f"{along.max:.4f}", f"{degrees(turn.rmse):.3f}")
        rpe = ("-" if result.rpe is None else f"{result.rpe.rmse:.4f}",) if pairs else ()
        rows.append((literal(name), str(along.count), *values, *rpe))
    return table(rows, right=range(1, len(rows[0])))
