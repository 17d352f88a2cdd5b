"""``moteslam evaluate``: a trajectory against another, or against hand-checked relations."""

from __future__ import annotations

from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moteslam.errors import InputError, MoteslamError
from moteslam.eval.cli import options
from moteslam.eval.cli.text import literal, say, say_json, table

if TYPE_CHECKING:
    from moteslam.eval.metrics.relations import RelationResult
    from moteslam.robot.trajectory import Trajectory


def evaluate(
    estimate: Annotated[Path, typer.Argument(metavar="EST", help="Trajectory to score, TUM format.")],
    reference: Annotated[Path, typer.Argument(metavar="REF", help="TUM trajectory or .relations; the content tells.")],
    no_align: Annotated[
        bool, typer.Option("--no-align", help="Take both in the frame they are in, for the absolute error.")
    ] = False,
    delta: Annotated[float, typer.Option(help="Length of a stretch for the relative error.")] = 1.0,
    unit: Annotated[str, typer.Option(metavar="m|s|frames", help="Unit of --delta.")] = "m",
    all_pairs: Annotated[
        bool, typer.Option("--all-pairs", help="A stretch from every pose on, not one after another.")
    ] = False,
    max_difference: Annotated[
        float | None,
        typer.Option(min=0, metavar="S", help="Between stamps that belong together [0.01; 0.0001 for relations]."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Score a trajectory by another, or by relations.

    Absolute and relative errors against a trajectory; against hand-checked relations, the mean and standard deviation
    of their errors. A reference with more poses than the estimate is interpolated at the estimate's stamps; else each
    pose takes the nearest stamp. Clear relations are those whose stamps each belong to exactly one pose.

    \b
    Examples:
      moteslam evaluate demo/trajectory.tum demo/truth.tum
      moteslam evaluate demo/trajectory.tum demo/truth.tum --delta 5 --unit s --json
      moteslam evaluate result/trajectory.tum intel.relations
    """  # noqa: D301
    from moteslam.eval.metrics.relations import TOLERANCE, is_relations, read_relations, relation_errors
    from moteslam.robot.trajectory import read_tum

    if is_relations(estimate):
        raise InputError("holds relations, expected a TUM trajectory as EST and the relations as REF", file=estimate)
    trajectory = read_tum(estimate)
    try:
        if is_relations(reference):
            tolerance = TOLERANCE if max_difference is None else max_difference
            result = relation_errors(trajectory, read_relations(reference), tolerance=tolerance)
            summary = {"kind": "relations", **result.as_dict()}
            lines = _relation_table(result)
        else:
            summary, lines = _against_trajectory(
                trajectory,
                read_tum(reference),
                align=not no_align,
                delta=delta,
                unit=unit,
                all_pairs=all_pairs,
                max_difference=max_difference,
            )
    except MoteslamError as error:
        if error.file is None:
            raise InputError(error.problem, file=reference, field=error.field) from error
        raise
    if as_json:
        say_json({"estimate": str(estimate), "reference": str(reference), **summary})
    else:
        say(f"{literal(estimate)} against {literal(reference)}")
        say(lines)


def _relation_table(result: RelationResult) -> str:
    rows = [("relations", "count", "translation [m]", "rotation [deg]")]
    for name, score in (("clear", result.clear), ("all", result.all)):
        if score is None:
            rows.append((name, "0", "-", "-"))
            continue
        along, turn = score.translation, score.rotation
        rows.append(
            (
                name,
                str(along.count),
                f"{along.mean:.4f} +- {along.std:.4f}",
                f"{turn.mean:.3f} +- {turn.std:.3f}",
            )
        )
    left_out = result.total - result.matched
    tail = f"\n{left_out} of {result.total} relations have no pose at one of their stamps" if left_out else ""
    return table(rows, right=(1, 2, 3)) + tail


def _against_trajectory(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    align: bool,
    delta: float,
    unit: str,
    all_pairs: bool,
    max_difference: float | None,
) -> tuple[dict[str, Any], str]:
    """The summary for ``--json``, and the table."""
    from moteslam.eval.metrics.association import MAX_DIFFERENCE
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.eval.metrics.rpe import relative_pose_error

    apart = MAX_DIFFERENCE if max_difference is None else max_difference
    ate = absolute_trajectory_error(estimate, reference, align=align, max_difference=apart)
    rpe = relative_pose_error(
        estimate,
        reference,
        delta=delta,
        unit=unit,  # type: ignore[arg-type]  # checked there
        all_pairs=all_pairs,
        max_difference=apart,
    )
    rows: list[tuple[str, ...]] = [("error", "count", "RMSE", "mean", "median", "std", "max")]
    for name, along, turn in (
        ("ATE" if align else "ATE, not aligned", ate.translation, ate.rotation),
        (f"RPE over {delta:g} {unit}", rpe.translation, rpe.rotation),
    ):
        for what, form in (("m", "{:.4f}"), ("deg", "{:.3f}")):
            s = along if what == "m" else turn
            values = (s.rmse, s.mean, s.median, s.std, s.max)
            shown = values if what == "m" else map(degrees, values)
            rows.append((f"{name} [{what}]", str(s.count), *(form.format(value) for value in shown)))
    summary = {"kind": "trajectory", "aligned": align, "ate": ate.as_dict(), "rpe": rpe.as_dict()}
    return summary, table(rows, right=range(1, 7))
