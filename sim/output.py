"""A simulation on disk: the recording in the UCSD layout, with the truth beside it."""

import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from moteslam.errors import OutputError
from moteslam.files import make_folder, read_bytes, write_atomically
from moteslam.robot.formats.map_server import write_map, write_picture
from moteslam.robot.formats.ucsd import DISPARITY, RGB, image_path, write_ucsd
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.platforms import write_platform
from moteslam.robot.raster import encode_png
from moteslam.robot.trajectories.text import write_tum
from moteslam.robot.values import expect_type, processor_count
from moteslam.sim.scenario import Scenario, scenario_table
from moteslam.sim.sensors.rgbd import CameraFrames
from moteslam.sim.simulate import Progress, Simulation
from moteslam.sim.world.floor import MAX_PICTURE_BYTES
from moteslam.sim.world.layout import read_cells

SAMPLE = 6  # Images of each kind that are drawn to estimate the space that all will take
BATCH = 8  # Images that are drawn at a time

Draw = Callable[[NDArray[np.intp]], NDArray[Any]]  # Draws the images [k, ...] of these frames [k]


def write_simulation(
    folder: str | PathLike[str],
    simulation: Simulation,
    *,
    sequence: str = "20",
    file_format: str = "ucsd",
    map_resolution: float | None = None,
    progress: Progress | None = None,
    announce: Callable[[str], None] | None = None,
) -> None:
    """Write a simulation as a folder, in the UCSD layout or with a CARMEN log in it, which reads back equal.

    Beside it go ``platform.toml``, ``truth.tum`` and ``scenario.toml``, with its floor plan and picture.

    Args:
        folder: made if need be.
        sequence: the number in the file names of the UCSD layout.
        file_format: ``ucsd``, or ``carmen`` for a recording with odometry.
        map_resolution: of the true map [m], and of the true floor where a camera records; None for no such map.
        progress: called with ``images`` and the share of them that is written.
        announce: called, before the first image is written, with a line on how large all will be.
    """
    expect_type(simulation, Simulation, "simulation", "simulate(scenario) makes one")
    make_folder(folder := Path(folder))
    if file_format == "carmen":
        write_carmen(folder / log_name(simulation.scenario.name), simulation.recording)
        write_platform(folder / "platform.toml", simulation.recording.platform)
    else:
        write_ucsd(folder, simulation.recording, sequence=sequence)
    if simulation.frames is not None:
        report = progress or (lambda _what, _share: None)
        write_frames(folder, simulation.frames, sequence, announce=announce, progress=lambda s: report("images", s))
    write_tum(folder / "truth.tum", simulation.truth)
    scenario = _with_its_files(folder, simulation.scenario)
    write_atomically(folder / "scenario.toml", tomli_w.dumps(scenario_table(scenario)))
    if map_resolution is not None:
        write_map(folder / "truth_map.pgm", simulation.true_map(map_resolution))
        if simulation.frames is not None:
            write_picture(folder / "truth_floor.png", simulation.true_floor(map_resolution))


def _with_its_files(folder: Path, scenario: Scenario) -> Scenario:
    """The scenario with its floor plan and floor picture in a folder, so that it can be simulated again from there."""
    plan, floor = scenario.world.plan, scenario.floor
    if plan is not None:
        write_map(folder / "plan.pgm", read_cells(plan))
        plan = plan.model_copy(update={"file": "plan.yaml"})
        scenario = scenario.model_copy(update={"world": scenario.world.model_copy(update={"plan": plan})})
    if floor is not None and floor.image is not None:
        image = f"floor{Path(floor.image).suffix}"
        write_atomically(folder / image, read_bytes(floor.image, "a picture", limit=MAX_PICTURE_BYTES))
        scenario = scenario.model_copy(update={"floor": floor.model_copy(update={"image": image})})
    return scenario


def log_name(scenario: str) -> str:
    """The name of a scenario's CARMEN log."""
    return f"{file_name(scenario)}.log.gz"


def file_name(name: str) -> str:
    """A scenario's name as part of a file's or folder's name."""
    return "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in name).lstrip(".") or "scenario"


def write_frames(
    folder: Path,
    frames: CameraFrames,
    sequence: str,
    *,
    announce: Callable[[str], None] | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Draw all frames and write them as ``dataRGBD/`` of the UCSD layout; few are held at a time.

    ``announce`` is called, before the first is written, with a line on how many and how large they will be.
    """
    kinds: tuple[tuple[str, Draw, int], ...] = (
        (RGB, frames.draw_rgb, len(frames.rgb.stamps)),
        (DISPARITY, frames.draw_disparity, len(frames.disparity.stamps)),
    )
    done, total = 0, sum(count for _, _, count in kinds)
    wanted, free = sum(estimate_bytes(draw, count) for _, draw, count in kinds), shutil.disk_usage(folder).free
    if announce is not None:
        announce(f"{total} images of about {_in_words(wanted)} are to be written")
    if wanted > free:
        raise OutputError(f"{_in_words(free)} free, expected {_in_words(wanted)} for the images", file=folder)

    def write(kind: str, index: int, image: NDArray[Any]) -> None:
        write_atomically(image_path(folder, kind, sequence, index), encode_png(image, fast=True))

    with ThreadPoolExecutor(processor_count()) as pool:
        written: Iterator[None] = iter(())
        for kind, draw, count in kinds:
            make_folder(image_path(folder, kind, sequence, 0).parent)
            for start in range(0, count, BATCH):
                indices = np.arange(start, min(start + BATCH, count))
                images = draw(indices)  # while those before are encoded
                list(written)
                progress(done / total)
                written = pool.map(partial(write, kind), indices.tolist(), images)
                done += len(indices)
        list(written)
    progress(1.0)


def estimate_bytes(draw: Draw, count: int) -> int:
    """About what ``count`` images will take as PNG files [bytes], from a few of them, with a tenth to spare."""
    if not count:
        return 0
    chosen = np.unique(np.linspace(0, count - 1, min(count, SAMPLE)).astype(np.intp))
    sizes = [len(encode_png(image, fast=True)) for image in draw(chosen)]
    return int(1.1 * count * (sum(sizes) / len(sizes) + 2048))  # and half a block of the disk each


def _in_words(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
