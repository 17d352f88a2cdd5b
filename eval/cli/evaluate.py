"""``moteslam evaluate``: trajectories against another one or relations, or by the scans of a recording."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import hypot
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from moteslam.errors import InputError, in_file
from moteslam.eval.cli import options
from moteslam.eval.cli.options import arg, flag, opt
from moteslam.eval.cli.text import answer, warn
from moteslam.eval.tables import BETWEEN, FORMATS, Column, Rows, fitting, literal, number, rows_of

NEEDED = {
    "a recording": ("sequence", "platform"),
    "a reference": ("plot", "max_difference", "time_offset"),
    "a reference trajectory": ("no_align", "scale", "delta", "unit", "all_pairs", "loops", "map", "nearest"),
    "a --map": ("true_map",),
}
"""What options are about: without it they would change nothing, and are refused."""

Row = Mapping[str, Any]
"""Of a trajectory: ``estimate``, ``reference`` with ``kind`` and figures, and ``recording`` with ``residuals``."""
LOOP_COUNTS = ("accepted", "overruled", "overruled_false", "possible", "bound")
LARGEST = 10.0  # No two points of a robot are farther apart [m]
WHOSE = "the reference "  # Begins a doubt of it
STATISTICS = ("rmse", "mean", "median", "std", "max")
RESIDUALS = (
    Column("estimate", "estimate"),
    Column("scans", "residuals/scans"),
    Column("residual median", "residuals/median_m", "number", "m"),
    Column("90 % below", "residuals/quantile_90_m", "number", "m", like="residuals/median_m"),
    Column("beyond 3 cm", "residuals/beyond_3_cm_share", ".1f", "%", 100),
    Column("unseen", "residuals/unseen_share", ".1f", "%", 100),
    Column("no return", "residuals/no_return_share", ".1f", "%", 100),
)


def evaluate(
    context: typer.Context,
    paths: Annotated[
        list[Path],
        arg(
            "Trajectories to score (TUM, KITTI, CSV, g2o, BAG:TOPIC); the last of several is the reference, also "
            ".relations.",
            "EST... [REF]",
        ),
    ],
    recording: Annotated[
        Path | None, opt("Also score by the scans of this recording; then one EST needs no REF.", "PATH")
    ] = None,
    loops: Annotated[
        Path | None, opt("Also score a loops.csv: precision, and with --recording recall.", "FILE")
    ] = None,
    map_file: Annotated[
        Path | None, opt("The map_server map that belongs to the one EST, for metrics.", "FILE.yaml", "--map")
    ] = None,
    true_map: Annotated[Path | None, opt("The true map in the frame of REF, to score --map.", "FILE.yaml")] = None,
    metrics: Annotated[list[str] | None, opt("Also measure this one; repeatable.", "NAME", "--metric")] = None,
    sequence: options.Sequence = None,
    platform: options.PlatformFile = None,
    no_align: Annotated[bool, flag("--no-align", "Do not align for the absolute error: all are in one frame.")] = False,
    scale: Annotated[
        bool, flag("--scale", "Fit also the scale for the absolute error: ranges or wheels may be off.")
    ] = False,
    delta: Annotated[float, opt("Length of a pair for the relative error.")] = 1.0,
    unit: Annotated[Literal["m", "s", "frames"], opt("Unit of --delta.", "m|s|frames")] = "m",
    all_pairs: Annotated[bool, flag("--all-pairs", "Begin a pair at every pose, not at the last's end.")] = False,
    max_difference: Annotated[
        float | None, opt("Most between stamps that belong together [0.01; 0.0001 for relations].", "S", min=0)
    ] = None,
    nearest: Annotated[
        bool, flag("--nearest", "Take the pose at the nearest stamp, as evo does, never interpolate.")
    ] = False,
    est_offset: Annotated[
        tuple[float, float, float],
        opt("Where REF's point of the robot lies, seen from EST's, such as the lidar.", "X Y THETA"),
    ] = (0.0, 0.0, 0.0),
    time_offset: Annotated[float, opt("Seconds to add to the stamps of every EST.", "S")] = 0.0,
    save: Annotated[Path | None, opt("Write the result as JSON, with the error at every stamp.", "FILE")] = None,
    plot: Annotated[Path | None, opt("Draw errors and trajectories.", "FILE.png|pdf|svg")] = None,
    form: options.Format = "text",
    force: Annotated[bool, flag("--force", "Replace existing files of --save and --plot.")] = False,
    as_json: options.Json = False,
) -> None:
    """Score trajectories by another one, relations, or scans.

    A trajectory as REF gives absolute and relative errors, hand-checked relations the mean and standard deviation of
    their errors. Several trajectories are scored side by side. Of EST and REF the one with more poses is interpolated
    at the stamps of the other. If they have equally many, or with --nearest, poses at the nearest stamps are compared,
    as `evo_ape tum REF EST -a` does. Motion out of x and y is compared in space, a reference without orientation by
    positions and distances. A trajectory in a ROS bag is BAG:TOPIC or BAG:tf:PARENT:CHILD. Relations are interpolated
    between poses. In clear relations each stamp belongs to exactly one pose.

    --recording gives the residuals of every EST: distances of endpoints to lines of scans less than 2 m of path away.

    --map with --true-map tells how much of the map is right, laid on the true one by the alignment of EST and REF.
    --metric measures any metric by name, and names what it lacks.

    --loops scores the accepted loops: the share that is right by REF, and of the key scans whose place was seen before
    the share that is bound to it.

    \b
    Examples:
      moteslam evaluate demo/trajectory.tum demo/truth.tum
      moteslam evaluate mine.tum theirs.tum truth.tum --plot errors.png
      moteslam evaluate result/trajectory.tum intel.relations
      moteslam evaluate lidar_path.tum truth.tum --est-offset -0.127 0 0 --format latex
      moteslam evaluate theirs.tum truth.tum --map theirs.yaml --true-map truth_map.yaml --metric rpe_10m
      moteslam evaluate result/trajectory_final.tum truth.tum --loops result/loops.csv --recording robot.log.gz
    """  # noqa: D301
    from moteslam.eval.metrics.association import oriented
    from moteslam.eval.metrics.relations import is_relations, read_relations
    from moteslam.eval.run_tables import read_loops
    from moteslam.eval.scores import Reference, against, carried, measured, under_recording
    from moteslam.robot.formats import open_recording
    from moteslam.robot.formats.streams import MAX_STAMP
    from moteslam.robot.trajectories import read_trajectory
    from moteslam.robot.trajectory import Trajectory
    from moteslam.slam.inputs.synchronise import synchronise

    _refuse_options(context, paths)
    with options.new_file(save, force=force), options.new_file(plot, *options.FIGURES, force=force):
        estimates, reference = (paths[:-1], paths[-1]) if len(paths) > 1 else (paths, None)
        if wrong := next(filter(is_relations, estimates), None):
            problem = "holds relations, or quaternions of other lengths than 1"
            raise InputError(f"{problem}; expected trajectories, and relations last", file=wrong)
        if not abs(time_offset) < MAX_STAMP:
            raise InputError(f"{time_offset:g}, expected seconds", field="--time-offset")
        if not hypot(*est_offset[:2]) <= LARGEST:
            raise InputError(f"{est_offset[:2]}, expected at most {LARGEST:g} m", field="--est-offset")
        trajectories = {str(file): read_trajectory(file) for file in estimates}
        for name, one in trajectories.items():
            one = replace(one, stamps=one.stamps + time_offset) if time_offset else one
            with options.named("--est-offset"):
                trajectories[name] = carried(oriented(one)[0], est_offset) if any(est_offset) else one
        opened = None if recording is None else open_recording(recording, sequence=sequence, platform=platform)
        truth: Reference | None = None
        if reference is not None:
            truth = read_relations(reference) if is_relations(reference) else read_trajectory(reference)
        scans = None if opened is None else synchronise(opened).scans
        if not isinstance(truth, Trajectory):
            for one in trajectories.values():
                warn(one.warnings)
        results: dict[str, Any] = {}
        rows: list[dict[str, Any]] = [{"estimate": name} for name in trajectories]
        errors: list[dict[str, Any]] = [{} for _ in rows]  # at every stamp
        how: dict[str, Any] = {"align": not no_align, "scale": scale, "delta": delta, "unit": unit}
        how |= {"all_pairs": all_pairs, "max_difference": max_difference, "nearest": nearest}
        for (name, one), row, by_stamp in zip(trajectories.items(), rows, errors, strict=True):
            if truth is not None and reference is not None:
                with in_file(reference), options.named(delta="--delta", max_difference="--max-difference"):
                    results[name], figures, by_stamp["errors"] = against(one, truth, **how)
                row |= {"reference": str(reference), **figures}
            if opened is not None:
                with in_file(name):
                    figures, medians = under_recording(one, opened, scans)
                row |= {"recording": str(recording), "residuals": figures}
                by_stamp["residuals"] = {**figures, "errors": medians}
        if opened is not None:
            warn(opened.warnings)
        found: dict[str, Any] = {}
        if metrics or true_map is not None or loops is not None:
            known: dict[str, Any] = {"recording": opened, "occupancy": map_file, "true_map": true_map}
            known["loops"] = None if loops is None else read_loops(loops)
            with options.named(metrics="--metric"):
                each = {name: measured(one, truth, metrics, **known) for name, one in trajectories.items()}
            found["metrics"] = {of: {name: value.as_dict() for name, value in one.items()} for of, one in each.items()}
        if save is not None:
            from moteslam.eval.results import write_json

            write_json(save, {"results": [row | more for row, more in zip(rows, errors, strict=True)], **found})
        if plot is not None:
            from moteslam.eval.report.curves import draw_comparison

            assert reference is not None  # or --plot was refused
            draw_comparison(plot, results, title=f"against {reference.name}")
    if not as_json:
        warn(_doubts(rows))
    one_or_all = rows[0] if len(rows) == 1 else {"reference": str(reference), "results": rows}
    parts = [part for part in _parts(rows, found) if BETWEEN[form] or not isinstance(part, str)]
    lines = (BETWEEN[form].format(part) if isinstance(part, str) else FORMATS[form](part) for part in parts)
    answer(one_or_all | found, lines, as_json=as_json)


def _refuse_options(context: typer.Context, paths: list[Path]) -> None:
    """Refuse what does not go together, also what was given with the value that it has by default."""
    from moteslam.eval.metrics.relations import is_relations

    sources = {name: context.get_parameter_source(name) for name in context.params}
    given = {name.removesuffix("_file") for name, source in sources.items() if source and source.name == "COMMANDLINE"}
    there = {"a recording": "recording" in given, "a reference": len(paths) > 1, "a --map": "map" in given}
    there["a reference trajectory"] = len(paths) > 1 and not is_relations(paths[-1])
    lone = [(name, needed) for needed, names in NEEDED.items() for name in names if name in given and not there[needed]]
    hint, problem = "EST... [REF]", ""
    if len(paths) < 2 and "recording" not in given:
        problem = "one file, expected trajectories and, last, their reference, or a --recording"
    elif "map" in given and given.isdisjoint(("true_map", "metrics")):
        hint, problem = "--map", "given without --true-map, expected the map to compare it with"
    elif "map" in given and len(paths) > 2:
        hint, problem = "--map", "given with several EST, expected the one whose map it is"
    elif lone:
        hint, problem = f"--{lone[0][0].replace('_', '-')}", f"given without {lone[0][1]}"
    elif given >= {"scale", "no_align"}:
        hint, problem = "--scale", "given with --no-align, expected one of the two"
    if problem:
        raise typer.BadParameter(problem, param_hint=f"'{hint}'")


def _parts(rows: Sequence[Row], more: Mapping[str, Any]) -> Iterator[str | Rows]:
    from moteslam.eval.metrics.registry import title_of

    first, kind, how = rows[0], rows[0].get("kind"), ""
    whose, metrics = f"{literal(first['estimate'])} " * (len(rows) == 1), more.get("metrics", {})
    if kind == "trajectory":  # how the estimate was laid on the reference
        scaled, nearest = " and scaled" * first["scaled"], ", poses at the nearest stamps" * first["nearest"]
        how = f", laid on it rigidly{scaled}{nearest}" if first["aligned"] else ", as they are, not aligned"
    if kind is not None:
        yield f"{whose}against {literal(first['reference'])}{how}"
    if kind == "trajectory" and len(rows) > 1:
        yield [*zip(*_comparison(rows), *_side_by_side(metrics), strict=True)]
    elif kind is not None:
        yield from _relations(rows) if kind == "relations" else [_errors(first)]
    if "residuals" in first:
        yield f"scans of {literal(first['recording'])}"
        yield rows_of(RESIDUALS, rows)
    if len(rows) == 1:
        for name, values in metrics.items():
            yield f"metrics of {literal(name)}"
            yield [["metric", "value"], *([title_of(metric), _value(value)] for metric, value in values.items())]
            if "value" in values.get("map_recall", {}) and "residuals" not in first:
                yield "recall, F1 and distance count walls, too, that the robot never saw: --recording leaves them out"
    elif metrics and kind != "trajectory":
        yield "metrics"
        yield [*zip(["estimate", *metrics], *_side_by_side(metrics), strict=True)]
    for name, values in metrics.items() if len(rows) > 1 else ():
        absent = (f"{title_of(metric)}: {value['absent']}" for metric, value in values.items() if "absent" in value)
        yield from (f"{literal(name)}: {one}" for one in absent)


def _doubts(rows: Sequence[Row]) -> Iterator[str]:
    """What is doubtful in the comparisons, each beginning with a file."""
    for row in rows:
        files = f"{row['estimate']}: ", f"{row.get('reference')}: "
        for issue in (*row.get("warnings", ()), *row.get("residuals", {}).get("warnings", ())):
            message = issue["message"]  # those of reading begin so
            of_reference = message.startswith(WHOSE)
            yield message if message.startswith(files) else files[of_reference] + message.removeprefix(WHOSE)


def _value(value: Row) -> str:
    if "value" not in value:
        return f"- {value['absent']}"
    unit, factor = fitting(value["unit"], [value["value"]])
    return f"{number(factor * value['value'])} {unit}".strip() + _counts(value)


def _counts(value: Row) -> str:
    more = ", ".join(f"{name.replace('_', ' ')} {value[name]}" for name in LOOP_COUNTS if name in value)
    return f" ({more})" * bool(more)


def _side_by_side(metrics: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """A column a metric: its head, and below it a cell an estimate."""
    from moteslam.eval.metrics.registry import title_of

    columns = []
    for name in next(iter(metrics.values()), ()):
        values = [each[name] for each in metrics.values()]
        unit = next((one["unit"] for one in values if "unit" in one), "")
        head, *cells = Column(title_of(name), "value", "number", unit).cells(values)
        columns.append([head, *(cell + _counts(of) for cell, of in zip(cells, values, strict=True))])
    return columns


def _errors(row: Row) -> Rows:
    name = f"ATE, scaled by {row['ate']['scale']:.4f}" if row["scaled"] else "ATE"
    errors = [(name, row["ate"])]
    if (rpe := row.get("rpe")) is not None:
        of = "RPE" if rpe["rotation_deg"] is not None else "RPE of distances"
        errors.append((f"{of} over {rpe['delta']:g} {rpe['unit']}", rpe))
    table = [["error", "count", "RMSE", *STATISTICS[1:]]]
    for name, error in errors:
        for what, unit in (("translation_m", "m"), ("rotation_deg", "deg")):
            if (found := error.get(what)) is not None:
                fit, factor = fitting(unit, [found["rmse"]])
                figures = [number(factor * found[each]) for each in STATISTICS]
                what_of = "heading" if what == "rotation_deg" and error is row["ate"] else name
                table.append([f"{what_of} [{fit}]", str(found["count"]), *figures])
    return table


def _comparison(rows: Sequence[Row]) -> list[list[str]]:
    """As ``_side_by_side``, of the errors."""
    pairs = [f"RPE over {row['rpe']['delta']:g} {row['rpe']['unit']}" for row in rows if row["rpe"] is not None]
    rmse = "ate/translation_m/rmse"
    columns = [
        *(Column("estimate", "estimate"), Column("poses", "ate/translation_m/count")),
        Column("ATE RMSE", rmse, "number", "m"),
        *(Column(name, f"ate/translation_m/{name}", "number", "m", like=rmse) for name in ("median", "max")),
        Column("heading RMSE", "ate/rotation_deg/rmse", "number", "deg"),
        *(Column(head, "rpe/translation_m/rmse", "number", "m", like=rmse) for head in pairs[:1]),
    ]
    return [column.cells(rows) for column in columns]


def _relations(rows: Sequence[Row]) -> Iterator[str | Rows]:
    several = len(rows) > 1
    kinds = {"clear": "clear", "at stamps": "at_stamps", "all used": "all"}
    scores = [(name, row["estimate"], row[place]) for name, place in kinds.items() for row in rows]
    unit, factor = fitting("m", [score["translation_m"]["mean"] for *_, score in scores if score is not None])
    table = [["relations", *["estimate"] * several, "count", f"translation [{unit}]", "rotation [deg]"]]
    for name, estimate, score in scores:
        cells = ["0", "-", "-"]
        if score is not None:
            along, turn = score["translation_m"], score["rotation_deg"]
            values = [[size * one[part] for part in ("mean", "std")] for one, size in ((along, factor), (turn, 1.0))]
            cells = [str(along["count"]), *(" +- ".join(map(number, pair)) for pair in values)]
        table.append([name, *[estimate] * several, *cells])
    yield table
    for row in rows:
        used = f"{row['used']} of {row['total']} relations used, {row['interpolated']} of them between poses"
        yield f"{literal(row['estimate'])}: {used}" if several else used
