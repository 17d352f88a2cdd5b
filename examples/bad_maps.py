"""What bad maps look like: six faults, each beside the map without it.

    python examples/bad_maps.py [FOLDER]

docs/bad-map.md says how each comes about, and what to do.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import moteslam
from moteslam.eval.cli.main import script
from moteslam.sim.logged import Logging, logged

PAPER = moteslam.resolve_config("paper")
DEFAULT = moteslam.resolve_config("default", ["particles=5"])
NO_LOOPS = moteslam.resolve_config("default", ["particles=5", "backend.method=none"])


def drive(scenario: str, seconds: float, *settings: str, seed: int = 0) -> moteslam.Recording:
    """What the robot recorded."""
    read = moteslam.load_scenario(scenario, settings=list(settings)).with_(duration=seconds)
    return moteslam.simulate(read, seed=seed).recording


def key_scans() -> moteslam.Recording:
    """A large loop as key scans of a poor odometry."""
    simulation = moteslam.simulate(moteslam.load_scenario("big_loop", settings=["platform=lms200"]), seed=2)
    return logged(simulation, Logging(every=0.75, turn=0.5, noise=(0.2, 0.2))).recording


def mounted(recording: moteslam.Recording, **mount: float) -> moteslam.Recording:
    """The recording with the lidar stated elsewhere than it is."""
    return replace(recording, platform=recording.platform.with_(lidar=mount))


def wider(recording: moteslam.Recording, scale: float) -> moteslam.Recording:
    """The recording with wider angles between its beams than there were."""
    lidar = recording.lidar
    figures = {"angle_min": scale * lidar.angle_min, "angle_increment": scale * lidar.angle_increment}
    return replace(recording, lidar=replace(lidar, **figures))


def later(recording: moteslam.Recording, seconds: float) -> moteslam.Recording:
    """The recording with the scans stamped by a clock that goes ahead."""
    return replace(recording, lidar=replace(recording.lidar, stamps=recording.lidar.stamps + seconds))


def main(folder: Path = Path()) -> dict[str, int]:
    """Draw all six; return at how many scans the filter was lost in the runs with a fault."""
    folder.mkdir(parents=True, exist_ok=True)
    carried = "faults=[{kind='carried', start=40, along=8, lidar='off'}]"
    corridor, loop, office = drive("corridor", 60), key_scans(), drive("office", 60)
    glass = moteslam.load_scenario("glass_front")
    walls = [segment - (*glass.start[:2], *glass.start[:2]) for segment in moteslam.Simulator(glass).world.segments]
    cases = {
        "doubled": ((loop, DEFAULT), (loop, NO_LOOPS)),
        "bent": ((corridor, DEFAULT), (wider(corridor, 1.05), DEFAULT)),
        "ghosts": ((walls, None), (drive("glass_front", 60), DEFAULT)),
        "lost": ((drive("corridor", 80), PAPER), (drive("corridor", 80, carried), PAPER)),
        "clock": ((office, PAPER), (later(office, 2.0), PAPER)),
        "mount": ((corridor, PAPER), (mounted(corridor, yaw=np.pi), PAPER)),
    }
    lost = {}
    for name, runs in cases.items():
        figure, panels = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
        panels[0].set_title("as it should be" if name != "ghosts" else "the walls")
        panels[1].set_title(name)
        for axes, (recording, config) in zip(panels, runs, strict=True):
            axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
            if config is None:
                for x0, y0, x1, y1 in recording:
                    axes.plot((x0, x1), (y0, y1), color="0.15", lw=1)
                continue
            found = moteslam.run_slam(recording, config)
            grey = np.where(found.map.values > 0, 0.15, np.where(found.map.values < 0, 1.0, 0.88))
            axes.imshow(grey, origin="lower", extent=found.map.extent, cmap="gray", vmin=0, vmax=1)
            axes.plot(*found.trajectory_final.poses[:, :2].T, color="tab:blue", lw=1)
            if name == "doubled":
                axes.set(xlim=(-8, 16), ylim=(-3, 8))
        lost[name] = int((found.diagnostics["state"] == moteslam.LocalisationState.LOST).sum())
        figure.savefig(folder / f"bad_maps_{name}.png", dpi=80)
        plt.close(figure)
        print(f"{name}: lost at {lost[name]} scans")
    return lost


if __name__ == "__main__":
    script(main)
