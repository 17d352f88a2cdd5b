"""The tables that ``moteslam evaluate`` prints: errors against a reference, residuals of scans, and loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import degrees
from pathlib import Path

from moteslam.eval.cli.text import bold, note, say, table
from moteslam.eval.evaluation import AgainstPositions, AgainstRelations, AgainstTrajectory, Evaluated, UnderRecording
from moteslam.eval.literal import literal
from moteslam.eval.metrics.loops import LoopResult
from moteslam.eval.metrics.registry import Value
from moteslam.robot.values import counted


def say_scores(scores: Mapping[str, Evaluated], reference: Path | None, recording: Path | None) -> None:
    """Print the scores of trajectories by their names, and a warning for each of their issues.

    Args:
        scores: by the name of the trajectory, all by the same.
        reference, recording: what they are scored by; None where they are not.
    """
    against = {name: score.against for name, score in scores.items() if score.against is not None}
    under = {name: score.under for name, score in scores.items() if score.under is not None}
    if against:
        _print_against(against, str(reference))
    if under:
        for name, result in under.items():
            for issue in result.issues:
                note(f"warning: {name}: {issue}")
        say(f"scans of {literal(recording)}")
        say(_residual_table(under))


def loop_lines(result: LoopResult) -> str:
    """Precision and recall of loops, a line each, with the counts that they are shares of, or why there is none."""
    lines = []
    if result.precision is not None:
        right, accepted = result.accepted - result.false, counted(result.accepted, "accepted loop")
        lines.append(f"loop precision {100 * result.precision:.1f} %: {right} of {accepted} right")
    if result.overruled:
        overruled = counted(result.overruled, "loop")
        lines.append(f"overruled by the final path: {overruled}, {result.overruled_false} of them false")
    if result.recall is not None:
        share = f"{result.bound} of {counted(result.possible or 0, 'key scan')} with a possible loop"
        lines.append(f"loop recall {100 * result.recall:.1f} %: {share} bound by an accepted one")
    return "\n".join([*lines, *map(str, result.issues)])


def metric_table(values: Mapping[str, Value]) -> str:
    """A line a metric: its value with the unit, or why there is none."""
    rows = [
        (literal(name), f"{value.number:.4g} {value.unit}".strip() if value.number is not None else f"- {value.reason}")
        for name, value in values.items()
    ]
    return table(rows)


def _print_against(
    results: Mapping[str, AgainstTrajectory | AgainstRelations | AgainstPositions], reference: str
) -> None:
    for name, result in results.items():
        if isinstance(result, AgainstRelations):
            say(f"{literal(name)} against {literal(reference)}")
            say(_relation_table(result))
        elif isinstance(result, AgainstTrajectory) and len(results) == 1:
            say(f"{literal(name)} against {literal(reference)}")
            say(_trajectory_table(result))
        if isinstance(result, AgainstTrajectory | AgainstPositions):
            for issue in result.issues:  # those of reading begin with the file
                about = "" if issue.message.startswith((f"{name}: ", f"{reference}: ")) else f"{name}: "
                note(f"warning: {about}{issue}")
    located = {name: result for name, result in results.items() if isinstance(result, AgainstPositions)}
    if located:
        say(f"positions of the lidar against {literal(reference)}")
        say(_position_table(located))
    compared = {name: result for name, result in results.items() if isinstance(result, AgainstTrajectory)}
    if len(compared) > 1:
        say(f"against {literal(reference)}")
        say(_comparison_table(compared))


def _residual_table(results: Mapping[str, UnderRecording]) -> str:
    """A row a trajectory."""
    rows: list[tuple[str, ...]] = [
        ("estimate", "scans", "residual median [mm]", "90 % below [mm]", "beyond 3 cm", "unseen", "no return")
    ]
    for name, under in results.items():
        result = under.result
        shares = (result.beyond_3_cm, result.unseen, result.no_return)
        values = (f"{1000 * result.median:.1f}", f"{1000 * result.quantile_90:.1f}")
        rows.append((literal(name), str(len(result.stamps)), *values, *(f"{100 * share:.1f} %" for share in shares)))
    return table(rows, right=range(1, 7))


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


def _position_table(results: Mapping[str, AgainstPositions]) -> str:
    """A row a trajectory."""
    rows: list[tuple[str, ...]] = [("estimate", "error", "count", "RMSE", "mean", "median", "std", "max")]
    for name, result in results.items():
        s = result.ate.translation
        values = (f"{value:.4f}" for value in (s.rmse, s.mean, s.median, s.std, s.max))
        rows.append((literal(name), f"{_ate_name(result)} [m]", str(s.count), *values))
    return table(rows, right=range(2, 8))


def _ate_name(result: AgainstTrajectory | AgainstPositions) -> str:
    if result.scaled:
        return f"ATE, scaled by {result.ate.scale:.4f}"
    return "ATE" if result.aligned else "ATE, not aligned"


def _trajectory_table(result: AgainstTrajectory) -> str:
    rows: list[tuple[str, ...]] = [("error", "count", "RMSE", "mean", "median", "std", "max")]
    scores = [(_ate_name(result), result.ate.translation, result.ate.rotation)]
    if result.rpe is not None:
        rpe = result.rpe
        of = "RPE" if rpe.rotation is not None else "RPE of distances"
        scores.append((f"{of} over {rpe.delta:g} {rpe.unit}", rpe.translation, rpe.rotation))
    for name, along, turn in scores:
        for what, form in (("m", "{:.4f}"), ("deg", "{:.3f}")):
            if (s := along if what == "m" else turn) is None:
                continue
            values = (s.rmse, s.mean, s.median, s.std, s.max)
            shown: Sequence[float] = values if what == "m" else [degrees(value) for value in values]
            rows.append((f"{name} [{what}]", str(s.count), *(form.format(value) for value in shown)))
    return table(rows, right=range(1, 7))


def _comparison_table(results: dict[str, AgainstTrajectory]) -> str:
    """A row a trajectory."""
    first = next(iter(results.values()))
    ate = "ATE, scale fitted," if first.scaled else "ATE" if first.aligned else "ATE, not aligned,"
    pairs = next((f"{r.rpe.delta:g} {r.rpe.unit}" for r in results.values() if r.rpe is not None), None)
    head = ("estimate", "poses", f"{ate} RMSE [m]", "median", "max", "heading RMSE [deg]")
    rows: list[tuple[str, ...]] = [(*head, f"RPE over {pairs}, RMSE [m]") if pairs else head]
    for name, result in results.items():
        along, turn = result.ate.translation, result.ate.rotation
        heading = "-" if turn is None else f"{degrees(turn.rmse):.3f}"
        values = (f"{along.rmse:.4f}", f"{along.median:.4f}", f"{along.max:.4f}", heading)
        rpe = ("-" if result.rpe is None else f"{result.rpe.rmse:.4f}",) if pairs else ()
        rows.append((literal(name), str(along.count), *values, *rpe))
    return table(rows, right=range(1, len(rows[0])))
