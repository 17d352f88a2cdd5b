"""``moteslam platforms``: the robots that come with the package."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import say, say_json, table
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.robot.platform import Platform


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
    from moteslam.robot.fan import field_of_view
    from moteslam.robot.platforms import bundled_platforms, load_platform, platform_table

    if name is not None:
        chosen = platform_table(load_platform(name))
        if as_json:
            say_json(chosen)
        else:
            import tomli_w

            say(tomli_w.dumps(chosen).rstrip("\n"))
        return
    robots = {each: load_platform(each) for each in bundled_platforms()}
    if as_json:
        say_json({each: _figures(robot) for each, robot in robots.items()})
        return
    rows = [("robot", "beams", "field of view", "rate", "range", "top speed", "what it is")]
    for each, robot in robots.items():
        scan = robot.lidar.scan
        rows.append(
            (
                each,
                str(scan.beams),
                f"{degrees(field_of_view(scan.beams, scan.angle_increment)):.1f} deg",
                f"{scan.rate:g} Hz",
                f"{scan.range_min:g} to {scan.range_max:g} m",
                "-" if robot.top_speed is None else f"{robot.top_speed:g} m/s",
                literal(robot.description),
            )
        )
    say(table(rows, right=(1, 2, 3)))


def _figures(robot: Platform) -> dict[str, object]:
    """What sets a robot apart, for JSON."""
    scan = robot.lidar.scan
    return {
        "description": robot.description,
        "beams": scan.beams,
        "angle_min_rad": scan.angle_min,
        "angle_increment_rad": scan.angle_increment,
        "rate_hz": scan.rate,
        "range_min_m": scan.range_min,
        "range_max_m": scan.range_max,
        "top_speed_m_s": robot.top_speed,
        "noise_classes": ["datasheet"] if robot.as_recorded is None else ["datasheet", "as_recorded"],
    }
