"""The images of the UCSD layout: ``dataRGBD/RGB20/rgb20_K.png`` and ``dataRGBD/Disparity20/disparity20_K.png``.

K counts from 1 and belongs to the K-th stamp in ``Kinect20.npz``. An image that is missing leaves its stamp without
one; that is one issue with a count, and so are images beyond the last stamp.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.files import read_bytes
from moteslam.robot.pictures import PNG, decode_picture, picture_size
from moteslam.robot.rgbd import HEIGHT, WIDTH
from moteslam.robot.values import Issue, counted

RGB, DISPARITY = "RGB", "Disparity"
"""The two kinds of images, as the folders name them."""

MAX_BYTES = 16 << 20
"""A PNG file larger than this is no image of 640 x 480 pixels."""


def image_path(folder: Path, kind: str, sequence: str, index: int) -> Path:
    """Where an image of a kind lies, by its index from 0."""
    return folder / "dataRGBD" / f"{kind}{sequence}" / f"{kind.lower()}{sequence.lower()}_{index + 1}.png"


def find_images(folder: Path, kind: str, sequence: str, count: int, issues: list[Issue]) -> tuple[Path | None, ...]:
    """The image of each of ``count`` stamps, None where it is missing; empty where there are none at all.

    What is missing or left over is an issue.
    """
    place = image_path(folder, kind, sequence, 0).parent
    if not place.is_dir():
        if place.parent.is_dir():  # no fault where there are no images at all: they are a download of their own
            text = f"{place.name}: no such folder, {counted(count, 'image')} missing"
            issues.append(Issue("images-missing", text, count))
        return ()
    pattern = re.compile(rf"{re.escape(place.name.lower())}_(\d{{1,9}})\.png")
    try:
        names = [path.name for path in place.iterdir()]
    except OSError as error:
        raise InputError(f"{error.strerror}, expected a folder of images", file=place) from error
    found = {int(match[1]): place / name for name in sorted(names) if (match := pattern.fullmatch(name))}
    files = tuple(found.get(index) for index in range(1, count + 1))
    missing, beyond = files.count(None), sum(1 for index in found if not 1 <= index <= count)
    if missing == count:
        text = f"{place.name}: {len(found)} images, none of them for one of the {count} stamps"
        issues.append(Issue("images-missing", text, count))
        return ()
    if missing:
        name = f"{place.name.lower()}_{files.index(None) + 1}.png"
        text = f"{place.name}: {missing} of {counted(count, 'image')} missing, the first {name}"
        issues.append(Issue("images-missing", text, missing))
    if beyond:
        text = f"{place.name}: {counted(beyond, 'image')} beyond the {counted(count, 'stamp')} left out"
        issues.append(Issue("images-beyond-stamps", text, beyond))
    return files


def read_rgb(path: Path) -> NDArray[np.uint8]:
    """A colour image [480, 640, 3], red, green, blue."""
    return np.ascontiguousarray(_decoded(path, np.uint8, (3, 4))[..., 2::-1])


def read_disparity(path: Path) -> NDArray[np.uint16]:
    """A raw disparity image [480, 640]."""
    return np.ascontiguousarray(_decoded(path, np.uint16, (1,))[..., 0])


def _decoded(path: Path, dtype: type, channels: tuple[int, ...]) -> NDArray[Any]:
    """An image [480, 640, channels]."""
    import cv2

    data = read_bytes(path, "a PNG image", limit=MAX_BYTES)
    size = picture_size(data) if data.startswith(PNG) else None
    if size != (WIDTH, HEIGHT):  # before any memory is taken for it
        found = "is empty" if not data else "not a PNG file" if size is None else f"{size[1]} x {size[0]} pixels"
        raise InputError(f"{found}, expected {HEIGHT} x {WIDTH} as PNG", file=path)
    image = decode_picture(data, cv2.IMREAD_UNCHANGED)
    if image is None:
        raise InputError("cut short or damaged, expected a whole PNG file", file=path)
    image = image.reshape(HEIGHT, WIDTH, -1)
    if image.dtype != dtype or image.shape[2] not in channels:
        found = f"{' x '.join(map(str, image.squeeze().shape))} of {8 * image.dtype.itemsize} bits"
        expected = f"expected {HEIGHT} x {WIDTH} x {channels[0]} of {8 * np.dtype(dtype).itemsize}"
        raise InputError(f"{found}, {expected}", file=path)
    return image
