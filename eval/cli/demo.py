"""``moteslam demo``: from nothing to a score."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import answer, simulation_bar
from moteslam.eval.tables import literal


@options.with_options(run=options.SlamOptions)
def demo(
    out: Annotated[Path, typer.Option(help=options.OUT)] = Path("demo"),
    scenario: Annotated[str, typer.Option(metavar="NAME", help="Scenario to drive.")] = "corridor",
    platform: options.Robot = None,
    noise: options.NoiseClass = None,
    duration: Annotated[float | None, typer.Option(min=12, metavar="S", help="Stop the drive after S seconds.")] = None,
    *,
    run: options.SlamOptions,
) -> None:
    """Simulate a corridor, run SLAM, score and draw it.

    The estimate is scored against the simulator's truth, which SLAM does not see.

    \b
    Examples:
      moteslam demo
      moteslam demo --duration 20 --out short
      moteslam demo --scenario loop --seed 7 --out loop
      moteslam demo --scenario office --platform turtlebot3 --noise as_recorded --out small
    """  # noqa: D301
    config = run.resolved()

    from moteslam.eval.cli.running import run_into, run_lines
    from moteslam.eval.cli.simulate import scenario_of
    from moteslam.kernels import runtime
    from moteslam.robot.files import result_folder
    from moteslam.sim.simulate import simulate

    driven = scenario_of(scenario, run.seed, platform=platform, noise=noise, duration=duration)
    with result_folder(out, force=run.force) as folder:
        runtime.init(run.arch, run.threads)  # a device that is not there is refused before the drive
        with options.in_file(scenario), simulation_bar() as report:
            simulation = simulate(driven, run.seed, progress=report)
        found = run_into(
            folder,
            simulation.recording,
            config,
            run,
            truth=simulation.truth,
            true_map=simulation.true_map(config.map.cell_size),
            about={"scenario": driven.name},
        )
    found = {"out": str(out), **found}
    look = [] if run.no_figures else [f"look at {literal(out / 'trajectories.png')}"]
    lines = chain(run_lines(found, f"{driven.name}: {simulation.truth.length:.1f} m"), look)
    answer(found, lines, as_json=run.as_json)
