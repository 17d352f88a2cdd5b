"""``moteslam demo``: from nothing to a score."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import say, say_json
from moteslam.eval.literal import literal


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
    resolved = run.resolved()
    if run.print_config:
        options.print_config(resolved, as_json=run.as_json)
        return

    from moteslam.eval.cli.progress import simulation_bar
    from moteslam.eval.cli.running import Device, lost_line, run_into, run_summary, score_table, size_of
    from moteslam.eval.cli.wanted import Wanted, named_in_errors
    from moteslam.robot.files import result_folder
    from moteslam.sim.simulate import simulate

    driven = Wanted(scenario, platform=platform, noise=noise).load(run.seed)
    if duration is not None:
        driven = driven.model_copy(update={"duration": min(duration, driven.duration)})
    device = Device(run.arch, run.threads)
    with result_folder(out, force=run.force) as folder:
        device.start()
        with named_in_errors(scenario), simulation_bar() as report:
            simulation = simulate(driven, run.seed, progress=report)
        done = run_into(
            folder,
            simulation.recording,
            resolved,
            seed=run.seed,
            device=device,
            truth=simulation.truth,
            true_map=simulation.true_map(resolved.map.cell_size),
            figures=not run.no_figures,
            about={"scenario": driven.name},
        )
    if run.as_json:
        say_json(run_summary(done, out))
        return
    assert done.scores is not None
    stamps = done.estimate.trajectory.stamps
    say(
        f"{literal(driven.name)}: {simulation.truth.length:.1f} m in {stamps[-1] - stamps[0]:.0f} s, "
        f"{size_of(done.estimate)}"
    )
    if lost := lost_line(done.estimate):
        say(lost)
    say(score_table(done.scores))
    say(f"result in {literal(out)}" + ("" if run.no_figures else f"; look at {literal(out / 'trajectories.png')}"))
