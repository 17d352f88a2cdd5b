"""``moteslam simulate``: a scenario in, a recording and its truth out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from moteslam.errors import ConfigError
from moteslam.eval.cli import options
from moteslam.eval.cli.progress import progress_bar, simulation_bar
from moteslam.eval.cli.text import note, say, say_json, table
from moteslam.eval.cli.wanted import MAX_BATCH, Wanted, logging_of, named_in_errors
from moteslam.eval.literal import literal


def simulate(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Bundled name, random-corridors, or a .toml file.")
    ],
    out: Annotated[Path, typer.Option(help=options.OUT)],
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**63 - 1, help="Of all randomness; the scenario's own by default.")
    ] = None,
    platform: options.Robot = None,
    noise: options.NoiseClass = None,
    settings: options.Settings = None,
    no_gyro: Annotated[bool, typer.Option("--no-gyro", help="A robot without IMU.")] = False,
    log_every: Annotated[
        float | None, typer.Option(metavar="M", help="Keep a scan only after M metres, or after --log-turn.")
    ] = None,
    log_turn: Annotated[
        float | None, typer.Option(metavar="RAD", help="Keep a scan only after this turn, or after --log-every.")
    ] = None,
    odometry_noise: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="DISTANCE ROTATION", help="Add these shares of noise to each step of the odometry."),
    ] = None,
    file_format: Annotated[
        Literal["ucsd", "carmen"], typer.Option("--format", metavar="ucsd|carmen", help="To write the recording in.")
    ] = "ucsd",
    batch: Annotated[
        int | None, typer.Option(min=1, max=MAX_BATCH, metavar="N", help="Make N, with seeds from --seed on.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Processes of a batch; all cores by default.")
    ] = None,
    true_map: Annotated[
        float | None, typer.Option(metavar="M", help="Write the true map too, in cells of M metres.")
    ] = None,
    camera: Annotated[
        bool, typer.Option("--camera", help="Record colour and depth images, even if the scenario does not.")
    ] = False,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Simulate a scenario and write what is recorded.

    The folder has the UCSD layout, or a CARMEN log, with the truth beside it; of a batch, one such folder a seed.

    \b
    Examples:
      moteslam simulate corridor --out corridor --seed 3
      moteslam simulate office --platform turtlebot3 --set noise.lidar.dropout=0.1 --out small
      moteslam simulate big_loop --platform lms200 --log-every 0.75 --log-turn 0.5 --format carmen --out keys
      moteslam simulate random-corridors --out many --batch 20 --true-map 0.05
      moteslam simulate my_rooms.toml --out rooms
      moteslam simulate corridor --out coloured --camera
      moteslam replay corridor --out result
    """  # noqa: D301
    from moteslam.eval.cli.batch import Job, about, run_batch
    from moteslam.robot.files import result_folder
    from moteslam.sim.output import file_name, log_name, write_simulation
    from moteslam.sim.scenario import MAX_SEED
    from moteslam.sim.world.random_corridors import NAME as RANDOM_CORRIDORS

    if true_map is not None and not 0.001 <= true_map <= 10:
        raise ConfigError(f"{true_map:g} m, expected 0.001 to 10", field="--true-map")
    wanted = Wanted(
        scenario,
        platform=platform,
        noise=noise,
        settings=(*(settings or ()), *(("platform.imu=false",) if no_gyro else ())),
        camera=camera,
        map_resolution=true_map,
        logging=logging_of(log_every, log_turn, odometry_noise, file_format=file_format),
        file_format=file_format,
    )
    loaded = wanted.load(seed)
    if batch is not None:
        first = loaded.seed if seed is None else seed
        if first > MAX_SEED - (batch - 1):
            raise ConfigError(f"{first}, expected at most {MAX_SEED - (batch - 1)} for {batch} of them", field="--seed")
        with result_folder(out, force=force) as folder:
            name = file_name(scenario if scenario == RANDOM_CORRIDORS else loaded.name)
            todo = [Job(wanted, number, folder / f"{name}-{number}") for number in range(first, first + batch)]
            found = run_batch(todo, processes=jobs)
        _say_batch(found, out, as_json=as_json)
        return
    with result_folder(out, force=force) as folder, named_in_errors(scenario):
        with simulation_bar() as report:
            simulation = wanted.simulate(loaded, seed, report)
        with progress_bar("images", 1.0, "") as bar:
            write_simulation(
                folder,
                simulation,
                map_resolution=true_map,
                file_format=file_format,
                announce=note,
                progress=lambda _what, share: bar.update(share),
            )
    one = about(simulation)
    if as_json:
        say_json({"out": str(out), **one})
        return
    counts = ", ".join(f"{count} {name}" for name, count in one["readings"].items())
    distance = f"{one['distance_m']:.1f} m in {one['duration_s']:.0f} s ({one['end']})"
    say(f"{literal(loaded.name)}: {distance}; readings: {counts}")
    if file_format == "carmen":
        say(f"log in {literal(out / log_name(loaded.name))}, truth beside it")
    else:
        say(f"recording and truth in {literal(out)}")


def _say_batch(found: list[dict[str, Any]], out: Path, *, as_json: bool) -> None:
    if as_json:
        say_json({"out": str(out), "simulations": found})
        return
    rows = [["scenario", "seed", "distance [m]", "time [s]", "end"]]
    rows += [
        [literal(one["scenario"]), str(one["seed"]), f"{one['distance_m']:.1f}", f"{one['duration_s']:.0f}", one["end"]]
        for one in found
    ]
    say(table(rows, right=(1, 2, 3)))
    say(f"recordings and truths in {literal(out)}")
