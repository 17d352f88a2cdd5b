"""``moteslam evaluate``: trajectories against another one, relations or positions, or by the scans of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moteslam.errors import InputError, MoteslamError
from moteslam.eval.cli import options
from moteslam.eval.cli.evaluate_options import refuse_options
from moteslam.eval.cli.text import say, say_json, warn
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.eval.evaluation import (
        AgainstPositions,
        AgainstRelations,
        AgainstTrajectory,
        Evaluated,
        UnderRecording,
    )
    from moteslam.eval.metrics.relations import Relations
    from moteslam.robot.platform import Platform
    from moteslam.robot.recording import Recording
    from moteslam.robot.trajectory import Positions, Trajectory
    from moteslam.slam.inputs.scans import Scans


def evaluate(
    context: typer.Context,
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="EST... [REF]",
            help="Trajectories to score (TUM, KITTI, CSV, g2o, BAG:TOPIC); last of several the reference, also "
            ".relations or positions.",
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
    each belong to exactly one pose. Against measured positions of the lidar (lines P t x y), the absolute error of its
    position; where it stands on the robot, --recording says.

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
    from moteslam.eval.cli.evaluate_tables import loop_lines, metric_table, say_scores
    from moteslam.eval.evaluation import Evaluated, measured, read_reference
    from moteslam.eval.loop_table import read_loops
    from moteslam.eval.metrics.evidence import oriented
    from moteslam.eval.metrics.loops import score_loops
    from moteslam.eval.metrics.relations import is_relations
    from moteslam.robot.formats import open_recording
    from moteslam.robot.formats.stamps import MAX_STAMP
    from moteslam.robot.trajectories import read_trajectory
    from moteslam.robot.trajectory import Trajectory
    from moteslam.slam.inputs.synchronise import synchronise

    refuse_options(context, paths, recording, map_file)
    for file in (save, plot):
        options.refuse_existing(file, force=force)
    if plot is not None:
        options.expect_picture(plot)
    estimates, reference = (paths[:-1], paths[-1]) if len(paths) > 1 else (paths, None)
    for file in estimates:
        if is_relations(file):
            problem = (
                "holds relations, or quaternions of other lengths than 1; expected trajectories, and relations last"
            )
            raise InputError(problem, file=file)
    if not abs(time_offset) < MAX_STAMP:
        raise InputError(f"{time_offset:g}, expected seconds", field="--time-offset")
    trajectories = {str(file): read_trajectory(file) for file in estimates}
    if time_offset:
        trajectories = {name: replace(one, stamps=one.stamps + time_offset) for name, one in trajectories.items()}
    scores = {name: Evaluated() for name in trajectories}
    opened = None if recording is None else open_recording(recording, sequence=sequence, platform=platform)
    truth = None if reference is None else read_reference(reference)
    if not isinstance(truth, Trajectory):
        for one in trajectories.values():
            warn(one.warnings)
    if reference is not None and truth is not None:
        against = _against(
            trajectories,
            truth,
            reference,
            robot=None if opened is None else opened.platform,
            align=not no_align,
            scale=scale,
            delta=delta,
            unit=unit,
            all_pairs=all_pairs,
            max_difference=max_difference,
            interpolate=not no_interpolate,
        )
        scores = {name: Evaluated(against=result) for name, result in against.items()}
    scans = None
    if opened is not None:
        scans = synchronise(opened).scans
        under = _under(trajectories, opened, scans)
        scores = {name: replace(score, under=under[name]) for name, score in scores.items()}
    ledger = None
    if loops is not None:
        assert isinstance(truth, Trajectory)  # or --loops was refused
        ledger = score_loops(read_loops(loops), oriented(truth)[0], opened, scans=scans)
    more: dict[str, Any] = {} if ledger is None else {"loops": {"file": str(loops), **ledger.as_dict()}}
    values = {}
    if metrics or true_map is not None:
        given: dict[str, Any] = {"recording": opened, "occupancy": map_file, "true_map": true_map, "names": metrics}
        values = {name: measured(trajectory, truth, **given) for name, trajectory in trajectories.items()}
        more["metrics"] = {
            name: {metric: value.as_dict() for metric, value in each.items()} for name, each in values.items()
        }
    _write(scores, reference, recording, more, save=save, plot=plot)
    if as_json:
        say_json(_summary(scores, reference, recording) | more)
        return
    say_scores(scores, reference, recording)
    for name, each in values.items():
        say(f"metrics of {literal(name)}")
        say(metric_table(each))
    if ledger is not None:
        say(f"loops of {literal(loops)}")
        say(loop_lines(ledger))


def _against(
    trajectories: Mapping[str, Trajectory],
    truth: Trajectory | Relations | Positions,
    reference: Path,
    *,
    robot: Platform | None,
    align: bool,
    scale: bool,
    delta: float,
    unit: str,
    all_pairs: bool,
    max_difference: float | None,
    interpolate: bool,
) -> dict[str, AgainstTrajectory | AgainstRelations | AgainstPositions]:
    """Every trajectory against the reference; errors name the option or the reference."""
    from moteslam.eval.evaluation import against_positions, against_relations, against_trajectory
    from moteslam.eval.metrics.relations import Relations
    from moteslam.robot.trajectory import Positions

    results: dict[str, AgainstTrajectory | AgainstRelations | AgainstPositions] = {}
    try:
        for name, trajectory in trajectories.items():
            if isinstance(truth, Relations):
                results[name] = against_relations(trajectory, truth, interpolate=interpolate, tolerance=max_difference)
            elif isinstance(truth, Positions):
                results[name] = against_positions(
                    trajectory, truth, robot=robot, align=align, scale=scale, max_difference=max_difference
                )
            else:
                results[name] = against_trajectory(
                    trajectory,
                    truth,
                    align=align,
                    scale=scale,
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
    return results


def _under(trajectories: Mapping[str, Trajectory], recording: Recording, scans: Scans) -> dict[str, UnderRecording]:
    """The recording's scans under every trajectory; errors of one name its file."""
    from moteslam.eval.evaluation import under_recording

    results: dict[str, UnderRecording] = {}
    for name, trajectory in trajectories.items():
        try:
            results[name] = under_recording(trajectory, recording, scans=scans)
        except MoteslamError as error:
            if error.file is not None:
                raise
            raise InputError(error.problem, file=name) from error
    warn(recording.warnings)
    return results


def _row(
    name: str, score: Evaluated, reference: Path | None, recording: Path | None, *, errors: bool = False
) -> dict[str, Any]:
    """A trajectory's scores as they go into JSON."""
    row: dict[str, Any] = {"estimate": name}
    if score.against is not None:
        row |= {"reference": str(reference), **score.against.as_dict()}
        row |= {"errors": score.against.errors()} if errors else {}
    if score.under is not None:
        residuals = score.under.as_dict() | ({"errors": score.under.errors()} if errors else {})
        row |= {"recording": str(recording), "residuals": residuals}
    return row


def _summary(scores: Mapping[str, Evaluated], reference: Path | None, recording: Path | None) -> dict[str, Any]:
    """What ``--json`` prints: of one trajectory itself, of several a list."""
    rows = [_row(name, score, reference, recording) for name, score in scores.items()]
    return rows[0] if len(rows) == 1 else {"reference": str(reference), "results": rows}


def _write(
    scores: Mapping[str, Evaluated],
    reference: Path | None,
    recording: Path | None,
    more: Mapping[str, Any],
    *,
    save: Path | None,
    plot: Path | None,
) -> None:
    from moteslam.robot.files import folder_for

    if save is not None:
        from moteslam.eval.results import write_json

        with folder_for(save):
            rows = [_row(name, score, reference, recording, errors=True) for name, score in scores.items()]
            write_json(save, {"results": rows, **more})
    if plot is not None:
        from moteslam.eval.report.comparison import draw_comparison

        assert reference is not None  # or --plot was refused
        results = {name: score.against for name, score in scores.items() if score.against is not None}
        with folder_for(plot):
            draw_comparison(plot, results, title=f"against {reference.name}")
