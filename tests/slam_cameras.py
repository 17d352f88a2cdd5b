"""A robot with a camera over a floor of tiles, for tests of what the colours of the floor give a filter."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from moteslam.robot.recording import Recording
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.rgbd import CameraFrames
from moteslam.sim.simulate import Simulation, simulate


@dataclass(frozen=True)
class Drawn:
    """A simulated camera's images, drawn when they are asked for; ``asked`` notes the colour images."""

    frames: CameraFrames
    asked: list[int]

    def rgb(self, index: int) -> np.ndarray:
        self.asked.append(index)
        return self.frames.draw_rgb(np.array([index]))[0]

    def disparity(self, index: int) -> np.ndarray:
        return self.frames.draw_disparity(np.array([index]))[0]


def tiled_room(**changes: Any) -> tuple[Simulation, Recording]:
    """Eight seconds in a curve through a room of tiles, and the recording with images that are drawn when asked for."""
    scenario = {
        "duration": 8.0,
        "world": {
            "rooms": [{"corner": [0.0, 0.0], "size": [9.0, 7.0]}],
            "boxes": [{"centre": [6.0, 2.0], "size": [0.8, 0.6]}],
        },
        "commands": {"start": [2.0, 2.0, 0.3], "steps": [{"duration": 6.5, "speed": 0.6, "turn_rate": 0.3}]},
        "drive": {"rest_start": 0.5, "rest_end": 0.5},
        "floor": {"seed": 2},
        "camera": {},
        **changes,
    }
    simulation = simulate(parse_scenario(scenario), 1)
    return simulation, with_images(simulation)


def with_images(simulation: Simulation) -> Recording:
    """A simulation's recording with images that are drawn when they are asked for."""
    stream, frames = simulation.recording.rgbd, simulation.frames
    assert stream is not None
    assert frames is not None
    return simulation.recording.replace(rgbd=replace(stream, images=Drawn(frames, [])))
