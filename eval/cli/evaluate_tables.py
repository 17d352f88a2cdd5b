"""What ``moteslam evaluate`` prints, from the dict that its ``--json`` prints."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from moteslam.eval.tables import aligned, literal
from moteslam.robot.values import counted

Row = Mapping[str, Any]
"""Of a trajectory: ``estimate``, ``reference`` with ``kind`` and figures, and ``recording`` with ``residuals``."""
STATISTICS = ("rmse", "mean", "median", "std", "max")
HEAD = ("error", "count", "RMSE", "mean", "median", "std", "max")


def lines_of(rows: Sequence[Row], more: Mapping[str, Any]) -> Iterator[str]:
    """The scores of trajectories, all by the same; then metrics and loops."""
    kind, reference = rows[0].get("kind"), literal(rows[0].get("reference"))
    if kind == "trajectory" and len(rows) > 1:
        yield f"against {reference}"
        yield _comparison(rows)
    elif kind is not None:
        for row in rows:
            yield f"{literal(row['estimate'])} against {reference}"
            yield from _relations(row) if kind == "relations" else [aligned([HEAD, *_errors(row)])]
    if "residuals" in rows[0]:
        yield f"scans of {literal(rows[0]['recording'])}"
        yield _residuals(rows)
    for name, values in more.get("metrics", {}).items():
        yield f"metrics of {literal(name)}"
        yield aligned([("metric", "value"), *((metric, _value(value)) for metric, value in values.items())])
    if "loops" in more:
        yield f"loops of {literal(more['loops']['file'])}"
        yield from loop_lines(more["loops"])


def doubts_of(rows: Sequence[Row]) -> Iterator[str]:
    """What is doubtful in the comparisons, each beginning with a file."""
    for row in rows:
        name, reference = row["estimate"], row.get("reference")
        for issue in (*row.get("warnings", ()), *row.get("residuals", {}).get("warnings", ())):
            message = issue["message"]
            named = message.startswith((f"{name}: ", f"{reference}: "))  # those of reading
            yield message if named else f"{name}: {message}"


def loop_lines(loops: Row) -> Iterator[str]:
    """Precision and recall of loops, a line each, with the counts that they are shares of, or why there is none."""
    if loops["precision"] is not None:
        right, accepted = loops["accepted"] - round(loops["false"]), counted(loops["accepted"], "accepted loop")
        yield f"loop precision {100 * loops['precision']:.1f} %: {right} of {accepted} right"
    if loops["overruled"]:
        overruled = counted(loops["overruled"], "loop")
        yield f"overruled by the final path: {overruled}, {loops['overruled_false']} of them false"
    if loops["recall"] is not None:
        share = f"{loops['bound']} of {counted(loops['possible'] or 0, 'key scan')} with a possible loop"
        yield f"loop recall {100 * loops['recall']:.1f} %: {share} bound by an accepted one"
    yield from (issue["message"] for issue in loops["warnings"])


def _value(value: Row) -> str:
    return f"{value['value']:.4g} {value['unit']}".strip() if "value" in value else f"- {value['absent']}"


def _errors(row: Row) -> list[tuple[str, ...]]:
    """A line for each kind of error, as of ``HEAD``."""
    name = "ATE" if row["aligned"] else "ATE, not aligned"
    if row["scaled"]:
        name = f"ATE, scaled by {row['ate']['scale']:.4f}"
    errors = [(name, row["ate"])]
    if (rpe := row.get("rpe")) is not None:
        of = "RPE" if rpe["rotation_deg"] is not None else "RPE of distances"
        errors.append((f"{of} over {rpe['delta']:g} {rpe['unit']}", rpe))
    return [
        (f"{name} [{unit}]", str(found["count"]), *(f"{found[each]:.{digits}f}" for each in STATISTICS))
        for name, error in errors
        for what, unit, digits in (("translation_m", "m", 4), ("rotation_deg", "deg", 3))
        if (found := error.get(what)) is not None
    ]


def _comparison(rows: Sequence[Row]) -> str:
    """A line a trajectory; relative errors where any has one."""
    ate = "ATE, scale fitted," if rows[0]["scaled"] else "ATE" if rows[0]["aligned"] else "ATE, not aligned,"
    pairs = next((f"{row['rpe']['delta']:g} {row['rpe']['unit']}" for row in rows if row["rpe"] is not None), None)
    head = ("estimate", "poses", f"{ate} RMSE [m]", "median", "max", "heading RMSE [deg]")
    lines: list[tuple[str, ...]] = [(*head, f"RPE over {pairs}, RMSE [m]") if pairs else head]
    for row in rows:
        along, turn, rpe = row["ate"]["translation_m"], row["ate"]["rotation_deg"], row["rpe"]
        errors = (f"{along[name]:.4f}" for name in ("rmse", "median", "max"))
        heading = "-" if turn is None else f"{turn['rmse']:.3f}"
        over = ("-" if rpe is None else f"{rpe['translation_m']['rmse']:.4f}",) if pairs else ()
        lines.append((row["estimate"], str(along["count"]), *errors, heading, *over))
    return aligned(lines)


def _relations(row: Row) -> Iterator[str]:
    lines = [("relations", "count", "translation [m]", "rotation [deg]")]
    for name, score in (("clear", row["clear"]), ("at stamps", row["at_stamps"]), ("all used", row["all"])):
        if score is None:
            lines.append((name, "0", "-", "-"))
            continue
        along, turn = score["translation_m"], score["rotation_deg"]
        values = (f"{along['mean']:.4f} +- {along['std']:.4f}", f"{turn['mean']:.3f} +- {turn['std']:.3f}")
        lines.append((name, str(along["count"]), *values))
    yield aligned(lines)
    used = f"{row['used']} of {row['total']} relations used, {row['interpolated']} of them between poses"
    yield f"\x1b[1m{used}\x1b[0m" if sys.stdout.isatty() else used


def _residuals(rows: Sequence[Row]) -> str:
    lines = [("estimate", "scans", "residual median [mm]", "90 % below [mm]", "beyond 3 cm", "unseen", "no return")]
    for row in rows:
        found = row["residuals"]
        median, below = (f"{1000 * found[name]:.1f}" for name in ("median_m", "quantile_90_m"))
        beyond, unseen, none = (
            f"{100 * found[f'{name}_share']:.1f} %" for name in ("beyond_3_cm", "unseen", "no_return")
        )
        lines.append((row["estimate"], str(found["scans"]), median, below, beyond, unseen, none))
    return aligned(lines)
