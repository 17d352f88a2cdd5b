"""The tables that ``moteslam evaluate`` prints, from the dict that its ``--json`` prints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from moteslam.eval.cli.text import bold, note, say, table
from moteslam.eval.literal import literal
from moteslam.robot.values import counted

Row = Mapping[str, Any]
"""Of a trajectory: ``estimate``, ``reference`` with ``kind`` and figures, and ``recording`` with ``residuals``."""


def say_evaluations(rows: Sequence[Row], more: Mapping[str, Any]) -> None:
    """Print the scores of trajectories, all by the same, and a warning for each doubt; then metrics and loops."""
    for row in rows:
        _warn_and_head(row, alone=len(rows) == 1)
    kind, reference = rows[0].get("kind"), literal(rows[0].get("reference"))
    if kind == "trajectory" and len(rows) > 1:
        say(f"against {reference}")
        say(_comparison_table(rows))
    if "residuals" in rows[0]:
        for row in rows:
            for issue in row["residuals"]["warnings"]:
                note(f"warning: {row['estimate']}: {issue['message']}")
        say(f"scans of {literal(rows[0]['recording'])}")
        say(_residual_table(rows))
    for name, values in more.get("metrics", {}).items():
        say(f"metrics of {literal(name)}")
        say(table([(literal(metric), _value(value)) for metric, value in values.items()]))
    if "loops" in more:
        say(f"loops of {literal(more['loops']['file'])}")
        say(loop_lines(more["loops"]))


def loop_lines(loops: Mapping[str, Any]) -> str:
    """Precision and recall of loops, a line each, with the counts that they are shares of, or why there is none."""
    lines = []
    if loops["precision"] is not None:
        right, accepted = loops["accepted"] - round(loops["false"]), counted(loops["accepted"], "accepted loop")
        lines.append(f"loop precision {100 * loops['precision']:.1f} %: {right} of {accepted} right")
    if loops["overruled"]:
        overruled = counted(loops["overruled"], "loop")
        lines.append(f"overruled by the final path: {overruled}, {loops['overruled_false']} of them false")
    if loops["recall"] is not None:
        share = f"{loops['bound']} of {counted(loops['possible'] or 0, 'key scan')} with a possible loop"
        lines.append(f"loop recall {100 * loops['recall']:.1f} %: {share} bound by an accepted one")
    return "\n".join([*lines, *(issue["message"] for issue in loops["warnings"])])


def _value(value: Row) -> str:
    return f"{value['value']:.4g} {value['unit']}".strip() if "value" in value else f"- {value['absent']}"


def _warn_and_head(row: Row, *, alone: bool) -> None:
    """What is said of each trajectory by itself."""
    name, reference, kind = row["estimate"], row.get("reference"), row.get("kind")
    if kind == "relations" or (kind == "trajectory" and alone):
        say(f"{literal(name)} against {literal(reference)}")
        say(_relation_table(row) if kind == "relations" else _trajectory_table(row))
    for issue in row.get("warnings", ()):  # those of reading begin with the file
        message = issue["message"]
        about = "" if message.startswith((f"{name}: ", f"{reference}: ")) else f"{name}: "
        note(f"warning: {about}{message}")


def _trajectory_table(row: Row) -> str:
    errors, rpe = [(_ate_name(row), row["ate"])], row["rpe"]
    if rpe is not None:
        of = "RPE" if rpe["rotation_deg"] is not None else "RPE of distances"
        errors.append((f"{of} over {rpe['delta']:g} {rpe['unit']}", rpe))
    lines: list[tuple[str, ...]] = [("error", "count", "RMSE", "mean", "median", "std", "max")]
    for name, error in errors:
        for what, unit, digits in (("translation_m", "m", 4), ("rotation_deg", "deg", 3)):
            if (found := error[what]) is not None:
                lines.append((f"{name} [{unit}]", str(found["count"]), *_shown(found, digits)))
    return table(lines, right=range(1, 7))


def _shown(found: Row, digits: int) -> list[str]:
    return [f"{found[name]:.{digits}f}" for name in ("rmse", "mean", "median", "std", "max")]


def _ate_name(row: Row) -> str:
    if row["scaled"]:
        return f"ATE, scaled by {row['ate']['scale']:.4f}"
    return "ATE" if row["aligned"] else "ATE, not aligned"


def _comparison_table(rows: Sequence[Row]) -> str:
    ate = "ATE, scale fitted," if rows[0]["scaled"] else "ATE" if rows[0]["aligned"] else "ATE, not aligned,"
    pairs = next((f"{row['rpe']['delta']:g} {row['rpe']['unit']}" for row in rows if row["rpe"] is not None), None)
    head = ("estimate", "poses", f"{ate} RMSE [m]", "median", "max", "heading RMSE [deg]")
    lines: list[tuple[str, ...]] = [(*head, f"RPE over {pairs}, RMSE [m]") if pairs else head]
    for row in rows:
        along, turn, rpe = row["ate"]["translation_m"], row["ate"]["rotation_deg"], row["rpe"]
        errors = (f"{along[name]:.4f}" for name in ("rmse", "median", "max"))
        heading = "-" if turn is None else f"{turn['rmse']:.3f}"
        over = ("-" if rpe is None else f"{rpe['translation_m']['rmse']:.4f}",) if pairs else ()
        lines.append((literal(row["estimate"]), str(along["count"]), *errors, heading, *over))
    return table(lines, right=range(1, len(lines[0])))


def _relation_table(row: Row) -> str:
    lines = [("relations", "count", "translation [m]", "rotation [deg]")]
    for name, score in (("clear", row["clear"]), ("at stamps", row["at_stamps"]), ("all used", row["all"])):
        if score is None:
            lines.append((name, "0", "-", "-"))
            continue
        along, turn = score["translation_m"], score["rotation_deg"]
        values = (f"{along['mean']:.4f} +- {along['std']:.4f}", f"{turn['mean']:.3f} +- {turn['std']:.3f}")
        lines.append((name, str(along["count"]), *values))
    used = bold(f"{row['used']} of {row['total']} relations used, {row['interpolated']} of them between poses")
    return f"{table(lines, right=(1, 2, 3))}\n{used}"


def _residual_table(rows: Sequence[Row]) -> str:
    head = ("estimate", "scans", "residual median [mm]", "90 % below [mm]", "beyond 3 cm", "unseen", "no return")
    lines: list[tuple[str, ...]] = [head]
    for row in rows:
        found = row["residuals"]
        lengths = (f"{1000 * found[name]:.1f}" for name in ("median_m", "quantile_90_m"))
        shares = (f"{100 * found[name]:.1f} %" for name in ("beyond_3_cm_share", "unseen_share", "no_return_share"))
        lines.append((literal(row["estimate"]), str(found["scans"]), *lengths, *shares))
    return table(lines, right=range(1, 7))
