"""``moteslam platforms``, ``metrics`` and ``scenarios``: what comes with the package, and what it looks like."""

from math import degrees
from pathlib import Path
from typing import Annotated, Any

import typer

from moteslam.errors import in_file
from moteslam.eval.cli import options
from moteslam.eval.cli.options import arg, flag, opt
from moteslam.eval.cli.simulate import scenario_of
from moteslam.eval.cli.text import answer, progress_bar, say, simulation_bar
from moteslam.eval.tables import aligned, literal

SCAN = {"beams": "", "rate": "_hz", "range_min": "_m", "range_max": "_m"}
SCAN |= {"angle_min": "_rad", "angle_increment": "_rad"}
"""What is told of a robot's lidar, with its units."""


def platforms(
    name: Annotated[str | None, arg("Print this robot as TOML, with every key.", "[NAME|FILE]")] = None,
    as_json: options.Json = False,
) -> None:
    """List the bundled robots, or print one of them as TOML.

    The TOML is a whole robot, from which you can make your own.

    \b
    Examples:
      moteslam platforms
      moteslam platforms turtlebot3 > mine.toml
      moteslam simulate corridor --platform mine.toml --out run
    """  # noqa: D301
    import tomli_w

    from moteslam.robot.platforms import bundled_platforms, load_platform, platform_table

    if name is not None:
        chosen = platform_table(load_platform(name))
        answer(chosen, [tomli_w.dumps(chosen).rstrip("\n")], as_json=as_json)
        return
    found: dict[str, dict[str, Any]] = {
        each: {
            "description": robot.description,
            **{f"{key}{unit}": getattr(robot.lidar.scan, key) for key, unit in SCAN.items()},
            "top_speed_m_s": robot.top_speed,
            "noise_classes": ["datasheet"] if robot.as_recorded is None else ["datasheet", "as_recorded"],
        }
        for each, robot in ((each, load_platform(each)) for each in bundled_platforms())
    }
    rows = [("robot", "beams", "field of view", "rate", "range", "top speed", "what it is")]
    for each, one in found.items():
        view = degrees((one["beams"] - 1) * abs(one["angle_increment_rad"]))
        reach = f"{one['range_min_m']:g} to {one['range_max_m']:g} m"
        speed = "-" if one["top_speed_m_s"] is None else f"{one['top_speed_m_s']:g} m/s"
        scan = (str(one["beams"]), f"{view:.1f} deg", f"{one['rate_hz']:g} Hz", reach)
        rows.append((each, *scan, speed, one["description"]))
    answer(found, [aligned(rows)], as_json=as_json)


def metrics(as_json: options.Json = False) -> None:
    """List the metrics: what they measure, and their units.

    Metrics of trajectories are measured for the final and the online one and for dead reckoning, such as final.ate.
    Relative errors take any length, time or number of poses: rpe_2.5m, rpe_5s, rpe_10frames_rotation.

    \b
    Examples:
      moteslam metrics
      moteslam metrics --json
    """  # noqa: D301
    from moteslam.eval.metrics.registry import METRICS

    found: dict[str, dict[str, Any]] = {
        name: {
            "of": "run" if one.of_trajectory is None else "trajectory",
            **{key: getattr(one, key) for key in ("unit", "better", "costly", "meaning", "source")},
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


app = typer.Typer(rich_markup_mode=None)


@app.callback(invoke_without_command=True)
def scenarios(context: typer.Context, as_json: options.Json = False) -> None:
    """List the bundled scenarios and why each is hard.

    \b
    Examples:
      moteslam scenarios
      moteslam scenarios --json
      moteslam scenarios show corridor --out corridor.png
    """  # noqa: D301
    if context.invoked_subcommand is not None:
        return
    from moteslam.sim.scenario import bundled_scenarios

    bundled = bundled_scenarios()
    random = "random-corridors-N  building number N of as many as you like"
    answer(bundled, [aligned(list(bundled.items())), random], as_json=as_json)


@app.command()
def show(
    scenario: options.ScenarioName,
    out: Annotated[Path, opt("A new file; folders above it are made.", "FILE.png|pdf|svg")],
    seed: Annotated[int | None, opt("Seed of a random building.", min=0, max=2**63 - 1)] = None,
    drive: Annotated[bool, flag("--drive", "Drive it, and draw the driven path.")] = False,
    force: options.ForceFile = False,
) -> None:
    """Draw a scenario as a plan: walls and what they are made of, who moves, and the route.

    \b
    Examples:
      moteslam scenarios show office --out office.png
      moteslam scenarios show random-corridors --seed 7 --drive --out unseen.png
    """  # noqa: D301
    from moteslam.eval.report.scenarios import draw_scenario
    from moteslam.sim.simulate import true_drive

    with options.new_file(out, *options.FIGURES, force=force):
        chosen = scenario_of(scenario, seed)
        with in_file(scenario):
            driven = true_drive(chosen, seed).poses[:, :2] if drive else None
        draw_scenario(out, chosen, driven=driven)
    say(f"{literal(chosen.name)} in {literal(out)}")


@app.command()
def animate(
    scenario: options.ScenarioName,
    out: Annotated[Path, opt("The .gif, .webp or .mp4 to write; folders above it are made.")],
    seed: options.Seed = None,
    platform: options.Robot = None,
    noise: options.NoiseClass = None,
    duration: Annotated[float | None, opt("Stop after S seconds.", "S", min=12)] = None,
    fps: Annotated[float, opt("Frames per second, 1 to 50.", "N")] = 15.0,
    speed: Annotated[float | None, opt("Faster than real time; else the film takes at most 15 s.", "X")] = None,
    preset: options.Preset = None,
    settings: options.Settings = None,
    force: options.ForceFile = False,
) -> None:
    """Simulate a scenario, run SLAM, and film it: robot, beams, particles, and the map as it grows.

    An .mp4 is H.264, VP9 or AV1, the first that the OpenCV here encodes; browsers play all three.

    \b
    Examples:
      moteslam scenarios animate people --out people.gif
      moteslam scenarios animate corridor --duration 60 --speed 5 --fps 25 --out corridor.mp4
    """  # noqa: D301
    from moteslam.eval.report.film import Pace, check_film, film, write_film
    from moteslam.sim.simulate import simulate
    from moteslam.slam.online import OnlineSlam

    check_film(out)
    with options.named(fps="--fps", speed="--speed"):
        Pace.of(0.0, fps=fps, speed=speed)  # before the simulation, whose duration is not known yet
    config = options.SlamOptions(preset=preset, settings=settings).resolved()
    chosen = scenario_of(scenario, seed, platform=platform, noise=noise, duration=duration)
    with options.new_file(out, force=force):
        with in_file(scenario), simulation_bar() as report:
            simulation = simulate(chosen, seed, progress=report)
        session = OnlineSlam.over(simulation.recording, config, seed=simulation.scenario.seed)
        assert simulation.recording.lidar is not None
        stamps = simulation.recording.lidar.stamps
        with options.named(fps="--fps", speed="--speed"):
            pace = Pace.of(float(stamps[-1] - stamps[0]), fps=fps, speed=speed)
        with progress_bar("SLAM", len(session), "scans") as progress:
            write_film(out, film(simulation, session, pace, progress), fps=fps)
    say(f"{literal(chosen.name)}: {len(pace.moments(stamps))} frames, {pace}, in {literal(out)}")
