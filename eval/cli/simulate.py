"""``moteslam simulate``: a scenario in, a recording and its truth out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moteslam.errors import ConfigError
from moteslam.eval.cli import options
from moteslam.eval.cli.batch import MAX_BATCH, Job, about, chosen_scenario, named_in_errors, run_batch
from moteslam.eval.cli.progress import progress_bar
from moteslam.eval.cli.text import literal, note, say, say_json, table

if TYPE_CHECKING:
    from moteslam.sim.scenario import Scenario
    from moteslam.sim.simulate import Simulation


def simulate(
    scenario: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="Bundled name, random-corridors, or a .toml file.")
    ],
    out: Annotated[Path, typer.Option(help=options.OUT)],
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**63 - 1, help="Of all randomness; the scenario's own by default.")
    ] = None,
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

    The folder has the UCSD layout, with the truth beside the arrays; of a batch, one such folder a seed.

    \b
    Examples:
      moteslam simulate corridor --out corridor --seed 3
      moteslam simulate random-corridors --out unseen --seed 7
      moteslam simulate random-corridors --out many --batch 20 --true-map 0.05
      moteslam simulate my_rooms.toml --out rooms
      moteslam simulate corridor --out coloured --camera
      moteslam replay corridor --out result
    """  # noqa: D301
    from moteslam.robot.result_folder import result_folder
    from moteslam.sim.output import write_simulation
    from moteslam.sim.scenario import MAX_SEED, with_camera
    from moteslam.sim.world.random_corridors import NAME as RANDOM_CORRIDORS

    loaded = chosen_scenario(scenario, seed)
    if true_map is not None and not 0.001 <= true_map <= 10:
        raise ConfigError(f"{true_map:g} m, expected 0.001 to 10", field="--true-map")
    if batch is not None:
        first = loaded.seed if seed is None else seed
        if first > MAX_SEED - (batch - 1):
            raise ConfigError(f"{first}, expected at most {MAX_SEED - (batch - 1)} for {batch} of them", field="--seed")
        with result_folder(out, force=force) as folder:
            name = scenario if scenario == RANDOM_CORRIDORS else loaded.name
            todo = [
                Job(scenario, number, folder / f"{_file_name(name)}-{number}", true_map, camera)
                for number in range(first, first + batch)
            ]
            found = run_batch(todo, processes=jobs)
        _say_batch(found, out, as_json=as_json)
        return
    with result_folder(out, force=force) as folder, named_in_errors(scenario):
        simulation = simulate_with_progress(with_camera(loaded) if camera else loaded, seed)
        with progress_bar("images", 1.0, "") as bar:
            write_simulation(
                folder,
                simulation,
                map_resolution=true_map,
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


def _file_name(name: str) -> str:
    """A scenario's name as part of a folder's name."""
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name).lstrip(".") or "scenario"


def simulate_with_progress(scenario: Scenario, seed: int | None) -> Simulation:
    """Simulate with a progress bar on a terminal.

    Raises:
        ConfigError: a robot that gets stuck on its route.
    """
    from moteslam.sim.simulate import simulate as run

    with progress_bar("simulation", 2.0, "") as bar:
        return run(scenario, seed, progress=lambda what, share: bar.update(share + (1.0 if what == "lidar" else 0.0)))
