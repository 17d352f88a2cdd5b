"""``moteslam evaluate``: trajectories against another one or relations, or by the scans of a recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moteslam.errors import InputError, MoteslamError
from moteslam.eval.cli import options
from moteslam.eval.cli.text import say_json, warn

if TYPE_CHECKING:
    from moteslam.eval.evaluation import Evaluation

NEEDED = {
    **dict.fromkeys(("sequence", "platform"), "a recording"),
    **dict.fromkeys(("plot", "max_difference", "time_offset"), "a reference"),
    **dict.fromkeys(("no_align", "scale", "delta", "unit", "all_pairs", "loops"), "a reference trajectory"),
    "no_interpolate": "a .relations reference",
    "map_file": "a reference trajectory",
    "true_map": "a --map",
}
"""What an option is about: without it the option would change nothing, and is refused."""


def evaluate(
    context: typer.Context,
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="EST... [REF]",
            help="Trajectories to score (TUM, KITTI, CSV, g2o, BAG:TOPIC); last of several the reference, also "
            ".relations.",
        ),
    ],
    recording: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Also the residuals of this recording's scans; one EST needs no REF then."),
    ] = None,
    loops: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Also precision, with --recording recall, of the loops of a loops.csv."),
    ] = None,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", metavar="FILE.yaml", help="The map that goes with the one EST, map_server; for metrics."),
    ] = None,
    true_map: Annotated[
        Path | None, typer.Option(metavar="FILE.yaml", help="The true map in the frame of REF: also scores --map.")
    ] = None,
    metrics: Annotated[
        list[str] | None, typer.Option("--metric", metavar="NAME", help="Also these of moteslam metrics; repeatable.")
    ] = None,
    sequence: options.Sequence = None,
    platform: options.PlatformFile = None,
    no_align: Annotated[
        bool, typer.Option("--no-align", help="Take all in the frame they are in, for the absolute error.")
    ] = False,
    scale: Annotated[
        bool, typer.Option("--scale", help="Fit the scale too, for the absolute error: ranges or wheels may be off.")
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
    time_offset: Annotated[float, typer.Option(metavar="S", help="Seconds to add to the stamps of every EST.")] = 0.0,
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
    """Score trajectories by another one, by relations, or by the scans of their recording.

    Absolute and relative errors against a trajectory; against hand-checked relations, the mean and standard deviation
    of their errors. Several trajectories are scored side by side. Of estimate and reference the one with more poses is
    interpolated at the stamps of the other; where they have as many, each takes the nearest stamp. Motion out of x and
    y is compared in space, a reference without orientation by positions and distances. A trajectory in a ROS bag is
    BAG:TOPIC or BAG:tf:PARENT:CHILD. Relations are interpolated between poses; clear relations are those whose stamps
    each belong to exactly one pose.

    With --recording, the residuals of every EST: the distances of endpoints to the lines of scans less than 2 m of
    path away.

    With --map and --true-map, how much of the map is right, laid on the true one as EST is on REF. With --metric, any
    metric by name; what it needs and was not given is named.

    With --loops, the loops that a run accepted: how many are right by the reference, and of the key scans whose place
    was seen before, how many are bound to it.

    \b
    Examples:
      moteslam evaluate demo/trajectory.tum demo/truth.tum
      moteslam evaluate demo/trajectory.tum demo/truth.tum --delta 5 --unit s --json
      moteslam evaluate mine.tum theirs.tum odometry.tum truth.tum --plot errors.png
      moteslam evaluate result/trajectory.tum intel.relations
      moteslam evaluate result/trajectory_final.tum --recording robot.log.gz
      moteslam evaluate result/trajectory_final.tum robot4_reference.txt --recording robot4
      moteslam evaluate theirs.tum robot.bag:/ground_truth --time-offset -2.5
      moteslam evaluate theirs.tum truth.tum --map theirs.yaml --true-map truth_map.yaml --metric rpe_10m
      moteslam evaluate result/trajectory_final.tum truth.tum --loops result/loops.csv --recording robot.log.gz
    """  # noqa: D301
    from moteslam.eval.cli.evaluate_tables import say_evaluations
    from moteslam.eval.evaluation import against, measured, read_reference, under_recording
    from moteslam.eval.metrics.association import oriented
    from moteslam.eval.metrics.loops import score_loops
    from moteslam.eval.metrics.relations import is_relations
    from moteslam.eval.run_tables import read_loops
    from moteslam.robot.formats import open_recording
    from moteslam.robot.formats.streams import MAX_STAMP
    from moteslam.robot.trajectories import read_trajectory
    from moteslam.robot.trajectory import Trajectory
    from moteslam.slam.inputs.synchronise import synchronise

    _refuse_options(context, paths, recording, map_file)
    options.expect_new(save, force=force)
    options.expect_new(plot, ".png", force=force)
    estimates, reference = (paths[:-1], paths[-1]) if len(paths) > 1 else (paths, None)
    for file in estimates:
        if is_relations(file):
            problem = "holds relations, or quaternions of other lengths than 1"
            raise InputError(f"{problem}; expected trajectories, and relations last", file=file)
    if not abs(time_offset) < MAX_STAMP:
        raise InputError(f"{time_offset:g}, expected seconds", field="--time-offset")
    trajectories = {str(file): read_trajectory(file) for file in estimates}
    if time_offset:
        trajectories = {name: replace(one, stamps=one.stamps + time_offset) for name, one in trajectories.items()}
    opened = None if recording is None else open_recording(recording, sequence=sequence, platform=platform)
    truth = None if reference is None else read_reference(reference)
    if not isinstance(truth, Trajectory):
        for one in trajectories.values():
            warn(one.warnings)
    compared: dict[str, Evaluation] = {}
    if reference is not None and truth is not None:
        with _named(reference):
            for name, one in trajectories.items():
                compared[name] = against(
                    one,
                    truth,
                    align=not no_align,
                    scale=scale,
                    delta=delta,
                    unit=unit,
                    all_pairs=all_pairs,
                    max_difference=max_difference,
                    interpolate=not no_interpolate,
                )
    under: dict[str, Evaluation] = {}
    scans = None if opened is None else synchronise(opened).scans
    if opened is not None:
        for name, one in trajectories.items():
            with _named(name):
                under[name] = under_recording(one, opened, scans=scans)
        warn(opened.warnings)
    found: dict[str, Any] = {}
    if loops is not None:
        assert isinstance(truth, Trajectory)  # or --loops was refused
        ledger = score_loops(read_loops(loops), oriented(truth)[0], opened, scans=scans)
        found["loops"] = {"file": str(loops), **ledger.as_dict()}
    if metrics or true_map is not None:
        found["metrics"] = {}
        for name, one in trajectories.items():
            values = measured(one, truth, recording=opened, occupancy=map_file, true_map=true_map, names=metrics)
            found["metrics"][name] = {metric: value.as_dict() for metric, value in values.items()}

    def row(name: str, *, errors: bool = False) -> dict[str, Any]:
        row: dict[str, Any] = {"estimate": name}
        if name in compared:
            row |= {"reference": str(reference), **compared[name].figures}
            row |= {"errors": compared[name].errors} if errors else {}
        if name in under:
            more = {"errors": under[name].errors} if errors else {}
            row |= {"recording": str(recording), "residuals": under[name].figures | more}
        return row

    rows = [row(name) for name in trajectories]
    if save is not None:
        from moteslam.eval.results import write_json
        from moteslam.robot.files import folder_for

        with folder_for(save):
            write_json(save, {"results": [row(name, errors=True) for name in trajectories], **found})
    if plot is not None:
        from moteslam.eval.report.curves import draw_comparison
        from moteslam.robot.files import folder_for

        assert reference is not None  # or --plot was refused
        with folder_for(plot):
            results = {name: each.result for name, each in compared.items()}
            draw_comparison(plot, results, title=f"against {reference.name}")
    if as_json:
        say_json((rows[0] if len(rows) == 1 else {"reference": str(reference), "results": rows}) | found)
    else:
        say_evaluations(rows, found)


@contextmanager
def _named(file: Path | str) -> Iterator[None]:
    """Errors within name the option, or the file if they name none."""
    try:
        yield
    except MoteslamError as error:
        if error.file is None and error.field in ("delta", "unit", "max_difference"):
            raise InputError(error.problem, field=f"--{error.field.replace('_', '-')}") from error
        if error.file is None:
            raise InputError(error.problem, file=file) from error
        raise


def _refuse_options(context: typer.Context, paths: list[Path], recording: Path | None, map_file: Path | None) -> None:
    """Refuse what does not go together."""

    def is_given(name: str) -> bool:  # be it with the value that it has by default
        source = context.get_parameter_source(name)
        return source is not None and source.name == "COMMANDLINE"

    def refuse(problem: str, name: str) -> typer.BadParameter:
        return typer.BadParameter(problem, param_hint=f"'--{name.removesuffix('_file').replace('_', '-')}'")

    if len(paths) < 2 and recording is None:
        problem = "one file, expected trajectories and, last, their reference, or a --recording"
        raise typer.BadParameter(problem, param_hint="'EST... [REF]'")
    if map_file is not None and not (is_given("true_map") or is_given("metrics")):
        raise refuse("given without --true-map, expected the map to compare it with", "map")
    if map_file is not None and len(paths) > 2:
        raise refuse("given with several EST, expected the one whose map it is", "map")
    there = set() if recording is None else {"a recording"}
    there |= set() if map_file is None else {"a --map"}
    there |= _kinds(paths[-1]) if len(paths) > 1 else set()
    own = {"a recording": "a --recording", "a --map": "the map that it is compared with"}
    for name, needed in NEEDED.items():
        if is_given(name) and needed not in there:
            raise refuse(f"given without {needed}, expected {own.get(needed, 'one as the last file')}", name)
    if is_given("scale") and is_given("no_align"):
        raise refuse("given with --no-align, expected one of the two", "scale")


def _kinds(reference: Path) -> set[str]:
    """What a reference is, in the words of ``NEEDED``."""
    from moteslam.eval.metrics.relations import is_relations

    if is_relations(reference):
        return {"a reference", "a .relations reference"}
    return {"a reference", "a reference trajectory"}
