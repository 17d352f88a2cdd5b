"""``moteslam simulate``: a scenario in, a recording and its truth out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import literal, say, say_json

if TYPE_CHECKING:
    from moteslam.sim.scenario import Scenario
    from moteslam.sim.simulate import Simulation


def simulate(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help="Bundled name, or a .toml file.")],
    out: Annotated[Path, typer.Option(help=options.OUT)],
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**63 - 1, help="Of all randomness; the scenario's own by default.")
    ] = None,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Simulate a scenario and write what is recorded.

    The folder has the UCSD layout, with the truth beside the arrays.

    \b
    Examples:
      moteslam simulate corridor --out corridor --seed 3
      moteslam simulate my_rooms.toml --out rooms
      moteslam replay corridor --out result
    """  # noqa: D301
    from moteslam.robot.files import result_folder
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import write_simulation

    loaded = load_scenario(scenario)
    with result_folder(out, force=force) as folder:
        simulation = simulate_with_progress(loaded, seed)
        write_simulation(folder, simulation)
    truth, recording = simulation.truth, simulation.recording
    streams = {
        name: len(stream) for name in ("lidar", "encoders", "imu") if (stream := getattr(recording, name)) is not None
    }
    duration = float(truth.stamps[-1] - truth.stamps[0])
    if as_json:
        say_json(
            {
                "out": str(out),
                "scenario": loaded.name,
                "seed": simulation.scenario.seed,
                "distance_m": truth.length,
                "duration_s": duration,
                "end": simulation.end,
                "readings": streams,
            }
        )
        return
    counts = ", ".join(f"{count} {name}" for name, count in streams.items())
    say(f"{literal(loaded.name)}: {truth.length:.1f} m in {duration:.0f} s ({simulation.end}); readings: {counts}")
    say(f"recording and truth in {literal(out)}")


def simulate_with_progress(scenario: Scenario, seed: int | None) -> Simulation:
    """Simulate with a progress bar on a terminal.

    Raises:
        ConfigError: a robot that gets stuck on its route.
    """
    from moteslam.eval.cli.progress import progress_bar
    from moteslam.sim.simulate import simulate as run

    with progress_bar("simulation", 2.0, "") as bar:
        return run(scenario, seed, progress=lambda what, share: bar.update(share + (1.0 if what == "lidar" else 0.0)))
