"""The images of a Kinect as PNG files of the UCSD layout, drawn and encoded a few at a time."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import OutputError
from moteslam.robot.formats.ucsd import image_path
from moteslam.robot.pictures import encode_png
from moteslam.robot.values import processor_count

SAMPLE = 6
"""Images of each kind that are drawn to estimate the space that all will take."""

Draw = Callable[[NDArray[np.intp]], NDArray[Any]]
"""Draws the images [k, ...] of these frames [k]."""


def estimate_bytes(draw: Draw, count: int) -> int:
    """About what ``count`` images will take as PNG files [bytes], from a few of them, with a tenth to spare."""
    if not count:
        return 0
    chosen = np.unique(np.linspace(0, count - 1, min(count, SAMPLE)).astype(np.intp))
    sizes = [len(encode_png(image, fast=True)) for image in draw(chosen)]
    return int(1.1 * count * (sum(sizes) / len(sizes) + 2048))  # and half a block of the disk each


def size_in_words(size: float) -> str:
    """Bytes as megabytes, or gigabytes where they are one or more."""
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"


def check_space(folder: Path, wanted: int) -> None:
    """Refuse to begin what the disk cannot hold.

    Raises:
        OutputError: fewer than ``wanted`` bytes are free where the folder is.
    """
    try:
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror or error}", file=folder) from error
    if wanted > free:
        raise OutputError(f"{size_in_words(free)} free, expected {size_in_words(wanted)} for the images", file=folder)


def write_images(
    folder: Path,
    kind: str,
    sequence: str,
    draw: Draw,
    count: int,
    *,
    batch: int = 8,
    progress: Callable[[int], None] = lambda _: None,
) -> int:
    """Draw images and write them, encoding on all cores while the next are drawn; few are held at a time.

    Args:
        folder: of the recording; it exists.
        kind: ``RGB`` or ``DISPARITY``.
        sequence: the number in the file names.
        draw: makes the images of some frames.
        count: of frames.
        batch: frames drawn at a time.
        progress: called with the number already written.

    Returns:
        the bytes written.

    Raises:
        OutputError: the folder cannot be made, or the disk is full.
    """
    place = image_path(folder, kind, sequence, 0).parent
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made: {error.strerror or error}", file=place) from error

    def write(index: int, image: NDArray[Any]) -> int:
        path, data = image_path(folder, kind, sequence, index), encode_png(image, fast=True)
        try:
            path.write_bytes(data)
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
        return len(data)

    written, done = 0, 0
    with ThreadPoolExecutor(processor_count()) as pool:
        waiting: list[Future[int]] = []
        try:
            for start in range(0, count, batch):
                frames = np.arange(start, min(start + batch, count))
                images = draw(frames)
                written += sum(future.result() for future in waiting)
                done += len(waiting)
                progress(done)
                waiting = [pool.submit(write, int(i), image) for i, image in zip(frames, images, strict=True)]
            written += sum(future.result() for future in waiting)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    progress(count)
    return written
