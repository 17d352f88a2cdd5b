"""The images of the UCSD layout: ``dataRGBD/RGB20/rgb20_K.png`` and ``dataRGBD/Disparity20/disparity20_K.png``.

K counts from 1 and belongs to the K-th stamp in ``Kinect20.npz``. An image that is missing leaves its stamp without
one; that is one issue with a count, and so are images beyond the last stamp.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError, OutputError
from moteslam.robot.files import read_bytes
from moteslam.robot.pictures import PNG, decode_picture, encode_png, picture_size
from moteslam.robot.rgbd import HEIGHT, WIDTH
from moteslam.robot.values import Issue, counted, processor_count

RGB, DISPARITY = "RGB", "Disparity"
"""The two kinds of images, as the folders name them."""

MAX_BYTES = 16 << 20
"""A PNG file larger than this is no image of 640 x 480 pixels."""

SAMPLE = 6
"""Images of each kind that are drawn to estimate the space that all will take."""


def image_folder(folder: Path, kind: str, sequence: str) -> Path:
    """Where the images of a kind lie."""
    return folder / "dataRGBD" / f"{kind}{sequence}"


def find_images(
    folder: Path, kind: str, sequence: str, count: int
) -> tuple[tuple[Path | None, ...], tuple[Issue, ...]]:
    """The image of each of ``count`` stamps, None where it is missing; empty where there are none at all.

    Returns:
        the paths, and what is missing or left over.

    Raises:
        InputError: the folder cannot be listed.
    """
    place = image_folder(folder, kind, sequence)
    if not place.is_dir():
        # no fault where there are no images at all: they are a download of their own
        if not place.parent.is_dir():
            return (), ()
        return (), (Issue("images-missing", f"{place.name}: no such folder, {counted(count, 'image')} missing", count),)
    pattern = re.compile(rf"{re.escape(place.name.lower())}_(\d{{1,9}})\.png")
    try:
        names = [path.name for path in place.iterdir()]
    except OSError as error:
        raise InputError(f"{error.strerror}, expected a folder of images", file=place) from error
    found = {int(match[1]): place / name for name in sorted(names) if (match := pattern.fullmatch(name))}
    files = tuple(found.get(index) for index in range(1, count + 1))
    missing = files.count(None)
    beyond = sum(1 for index in found if not 1 <= index <= count)
    if missing == count:
        text = f"{place.name}: {len(found)} images, none of them for one of the {count} stamps"
        return (), (Issue("images-missing", text, count),)
    issues = []
    if missing:
        name = f"{place.name.lower()}_{files.index(None) + 1}.png"
        text = f"{place.name}: {missing} of {counted(count, 'image')} missing, the first {name}"
        issues.append(Issue("images-missing", text, missing))
    if beyond:
        text = f"{place.name}: {counted(beyond, 'image')} beyond the {counted(count, 'stamp')} left out"
        issues.append(Issue("images-beyond-stamps", text, beyond))
    return files, tuple(issues)


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """A colour image [480, 640, 3], red, green, blue.

    Raises:
        InputError: it cannot be read, or is no colour image of that size.
    """
    import cv2

    image = _decode(path, cv2.IMREAD_UNCHANGED)
    if image.dtype != np.uint8 or image.shape not in ((HEIGHT, WIDTH, 3), (HEIGHT, WIDTH, 4)):
        raise InputError(f"{_found(image)}, expected {HEIGHT} x {WIDTH} x 3 of 8 bits", file=path)
    return np.ascontiguousarray(image[..., 2::-1])


def read_disparity(path: Path) -> NDArray[np.uint16]:
    """A raw disparity image [480, 640].

    Raises:
        InputError: it cannot be read, or is no grey image of 16 bits of that size.
    """
    import cv2

    image = _decode(path, cv2.IMREAD_UNCHANGED)
    if image.dtype != np.uint16 or image.shape != (HEIGHT, WIDTH):
        raise InputError(f"{_found(image)}, expected {HEIGHT} x {WIDTH} of 16 bits", file=path)
    return np.ascontiguousarray(image)


def _decode(path: Path, how: int) -> NDArray[Any]:
    data = read_bytes(path, "a PNG image", limit=MAX_BYTES)
    size = picture_size(data) if data.startswith(PNG) else None
    if size is None:
        raise InputError("is empty" if not data else "not a PNG file, expected one", file=path)
    width, height = size
    if (width, height) != (WIDTH, HEIGHT):  # before any memory is taken for it
        raise InputError(f"{height} x {width} pixels, expected {HEIGHT} x {WIDTH}", file=path)
    image = decode_picture(data, how)
    if image is None:
        raise InputError("cut short or damaged, expected a whole PNG file", file=path)
    return image


def _found(image: NDArray[Any]) -> str:
    return f"{' x '.join(map(str, image.shape))} of {8 * image.dtype.itemsize} bits"


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
    progress: Callable[[int], None] | None = None,
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
    place = image_folder(folder, kind, sequence)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made: {error.strerror or error}", file=place) from error

    def write(index: int, image: NDArray[Any]) -> int:
        path = place / f"{place.name.lower()}_{index + 1}.png"
        data = encode_png(image, fast=True)
        try:
            path.write_bytes(data)
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
        return len(data)

    written, done = 0, 0
    with ThreadPoolExecutor(processor_count()) as pool:
        waiting: list[Future[int]] = []
        try:
            for batch_of in _batches(count, batch):
                images = draw(batch_of)
                written += sum(future.result() for future in waiting)
                done += len(waiting)
                if progress is not None:
                    progress(done)
                waiting = [pool.submit(write, int(i), image) for i, image in zip(batch_of, images, strict=True)]
            written += sum(future.result() for future in waiting)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    if progress is not None:
        progress(count)
    return written


def _batches(count: int, size: int) -> Iterator[NDArray[np.intp]]:
    for start in range(0, count, size):
        yield np.arange(start, min(start + size, count))
