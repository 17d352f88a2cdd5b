"""``moteslam platforms``, the robots that come with the package, and ``moteslam metrics``, what runs are scored by."""

from __future__ import annotations

from math import degrees
from typing import Annotated, Any

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import answer
from moteslam.eval.tables import aligned


def platforms(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME|FILE]", help="Print this robot as TOML, with every key.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """List the bundled robots and their lidars, or print one of them as TOML.

    What is printed is a whole robot, to begin one of your own with.

    \b
    Examples:
      moteslam platforms
      moteslam platforms turtlebot3 > mine.toml
      moteslam simulate corridor --platform mine.toml --out run
    """  # noqa: D301
    import tomli_w

    from moteslam.robot.platform import field_of_view
    from moteslam.robot.platforms import bundled_platforms, load_platform, platform_table

    if name is not None:
        chosen = platform_table(load_platform(name))
        answer(chosen, [tomli_w.dumps(chosen).rstrip("\n")], as_json=as_json)
        return
    found: dict[str, dict[str, Any]] = {
        each: {
            "description": robot.description,
            "beams": robot.lidar.scan.beams,
            "angle_min_rad": robot.lidar.scan.angle_min,
            "angle_increment_rad": robot.lidar.scan.angle_increment,
            "rate_hz": robot.lidar.scan.rate,
            "range_min_m": robot.lidar.scan.range_min,
            "range_max_m": robot.lidar.scan.range_max,
            "top_speed_m_s": robot.top_speed,
            "noise_classes": ["datasheet"] if robot.as_recorded is None else ["datasheet", "as_recorded"],
        }
        for each, robot in ((each, load_platform(each)) for each in bundled_platforms())
    }
    rows = [("robot", "beams", "field of view", "rate", "range", "top speed", "what it is")]
    for each, one in found.items():
        view = degrees(field_of_view(one["beams"], one["angle_increment_rad"]))
        reach = f"{one['range_min_m']:g} to {one['range_max_m']:g} m"
        speed = "-" if one["top_speed_m_s"] is None else f"{one['top_speed_m_s']:g} m/s"
        scan = (str(one["beams"]), f"{view:.1f} deg", f"{one['rate_hz']:g} Hz", reach)
        rows.append((each, *scan, speed, one["description"]))
    answer(found, [aligned(rows)], as_json=as_json)


def metrics(as_json: options.Json = False) -> None:
    """List the metrics: unit, what they measure, where they are defined.

    Metrics of trajectories are measured of the final and the online one and of dead reckoning, and named by it:
    final.ate. Relative errors are to be had over any length, time or number of poses: rpe_2.5m, rpe_5s,
    rpe_10frames_rotation.

    \b
    Examples:
      moteslam metrics
      moteslam metrics --json
    """  # noqa: D301
    from moteslam.eval.metrics.registry import METRICS

    found: dict[str, dict[str, Any]] = {
        name: {
            "of": "run" if one.of_trajectory is None else "trajectory",
            "unit": one.unit,
            "better": one.better,
            "costly": one.costly,
            "meaning": one.meaning,
            "source": one.source,
        }
        for name, one in METRICS.items()
    }
    lines = []
    for title, of in (("of each trajectory", "trajectory"), ("of a run", "run")):
        rows = [("", "unit", "better", "", "")]
        for name, one in found.items():
            if one["of"] == of:
                source = one["source"] + "; costly" * one["costly"]
                rows.append((name, one["unit"], one["better"] or "", one["meaning"], source))
        lines += [title, aligned(rows), ""]
    answer(found, lines, as_json=as_json)
