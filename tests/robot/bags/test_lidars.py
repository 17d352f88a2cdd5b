"""Lidars that give clouds, and several lidars as one."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_bags import START, make_bag, placed, rolled, scan

from moteslam import open_recording
from moteslam.errors import InputError
from moteslam.robot.formats.bags.messages import Event, header
from moteslam.robot.recording import LidarStream

HALF = 3.0
"""Half the side of the square room around the robot [m]."""

BEAMS = 720


def lidar_of(path: Path, **options: Any) -> LidarStream:
    lidar = open_recording(path, **options).lidar
    assert lidar is not None
    return lidar


def room_ranges(x: float, y: float, angles: np.ndarray) -> np.ndarray:
    """The ranges from a place to the walls of the room, in the directions of these angles."""
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        return np.minimum(
            np.where(cos > 0, (HALF - x) / cos, (-HALF - x) / cos),
            np.where(sin > 0, (HALF - y) / sin, (-HALF - y) / sin),
        )


def fan(first: float, beams: int) -> dict[str, float]:
    step = 2 * math.pi / BEAMS
    return {"angle_min": first, "angle_increment": step, "angle_max": first + (beams - 1) * step}


def two_lidars(upside_down: bool = False) -> list[Event]:
    """A lidar in the front and one in the back, each seeing three quarters of a square room."""
    beams = BEAMS * 3 // 4
    angles = -3 * math.pi / 4 + 2 * math.pi / BEAMS * np.arange(beams)
    mounts = {"/front": (0.3, 0.1, 0.2), "/back": (-0.3, -0.1, math.pi)}
    events = []
    for topic, (x, y, yaw) in mounts.items():
        roll = math.pi if upside_down and topic == "/back" else 0.0
        seen = yaw - angles if roll else yaw + angles
        events.append(placed(0, "base_link", topic[1:], (x, y, 0.2), turn=rolled(roll, yaw)))
        for index in range(4):
            ranges = room_ranges(x, y, seen)
            late = 0.1 * index + (0.03 if topic == "/back" else 0)
            events.append(scan(late, ranges, topic=topic, frame=topic[1:], **fan(float(angles[0]), beams)))
    return events


@pytest.mark.parametrize("upside_down", [False, True])
def test_two_lidars_are_merged_about_the_robot(tmp_path: Path, upside_down: bool) -> None:
    path = make_bag(tmp_path, two_lidars(upside_down))
    recording = open_recording(path, topics={"lidar": ("/front", "/back")})
    lidar = recording.lidar
    assert lidar is not None
    assert recording.warnings == ()
    assert recording.platform.lidar.pose == (0.0, 0.0, 0.0)
    assert lidar.ranges.shape == (4, BEAMS)
    np.testing.assert_allclose(lidar.stamps, 1.6e9 + 0.1 * np.arange(4), atol=1e-6)
    ranges = lidar.ranges[0]
    seen = np.isfinite(ranges)
    assert seen.mean() > 0.75
    expected = room_ranges(0.0, 0.0, lidar.angles)
    step = 2 * math.pi / BEAMS
    # an endpoint lies up to half a step beside its beam: along a wall that is met at 45 degrees, as long as it is far
    np.testing.assert_allclose(ranges[seen], expected[seen], atol=HALF * math.sqrt(2) * step)


def test_a_silent_lidar_is_left_out_of_the_fan(tmp_path: Path) -> None:
    events = [event for event in two_lidars() if event.topic != "/back" or event.time < START + 250_000_000]
    late = [
        Event(
            event.time + 60 * 10**9,
            event.topic,
            event.kind,
            {**event.values, "header": header(event.time + 60 * 10**9, "front")},
        )
        for event in events
        if event.topic == "/front"
    ]
    lidar = lidar_of(make_bag(tmp_path, [*events, *late]), topics={"lidar": ("/front", "/back")})
    both, alone = np.isfinite(lidar.ranges[0]).sum(), np.isfinite(lidar.ranges[7]).sum()
    assert alone < 0.8 * both
    assert alone > 0


def test_no_return_of_any_lidar_is_no_return_of_all(tmp_path: Path) -> None:
    beams = BEAMS * 3 // 4
    events = []
    for topic, yaw in (("/front", 0.0), ("/back", math.pi)):
        events.append(placed(0, "base_link", topic[1:], (0.3 * math.cos(yaw), 0.0, 0.0), turn=rolled(0, yaw)))
        ranges = np.full(beams, np.inf if topic == "/front" else 2.0)
        events.append(scan(0, ranges, topic=topic, frame=topic[1:], **fan(-3 * math.pi / 4, beams)))
    lidar = lidar_of(make_bag(tmp_path, events), topics={"lidar": ("/front", "/back")})
    ahead = np.abs(lidar.angles) < 0.5
    assert np.isposinf(lidar.ranges[0, ahead]).mean() > 0.9
    behind = np.abs(lidar.angles) > 2.6
    assert np.isfinite(lidar.ranges[0, behind]).mean() > 0.9
    assert lidar.range_max == pytest.approx(10.3)


def test_lidars_without_transforms_are_not_merged(tmp_path: Path) -> None:
    events = [scan(0, [1.0, 2.0], topic=topic) for topic in ("/front", "/back")]
    with pytest.raises(InputError, match="/front, /back: two lidars at one place, expected a transform to each"):
        open_recording(make_bag(tmp_path, events), topics={"lidar": ("/front", "/back")})


def cloud(time: float, points: np.ndarray, *, names: str = "xyz", kind: int = 7, big: bool = False) -> Event:
    """A cloud of points [n, 3]."""
    stamp = START + round(time * 1e9)
    dtype = np.dtype(f"{'>' if big else '<'}{ {7: 'f4', 8: 'f8', 5: 'i4'}[kind] }")
    data = np.frombuffer(np.ascontiguousarray(points, dtype).tobytes(), np.uint8)
    fields = [
        {"name": name, "offset": index * dtype.itemsize, "datatype": kind, "count": 1}
        for index, name in enumerate(names)
    ]
    values = {
        "header": header(stamp, "laser"),
        "height": 1,
        "width": len(points),
        "fields": fields,
        "is_bigendian": big,
        "point_step": 3 * dtype.itemsize,
        "row_step": 3 * dtype.itemsize * len(points),
        "data": data,
        "is_dense": True,
    }
    return Event(stamp, "/cloud", "sensor_msgs/PointCloud2", values)


def fan_points(ranges: np.ndarray, first: float, step: float, height: float = 0.0) -> np.ndarray:
    angles = first + step * np.arange(len(ranges))
    return np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles), np.full(len(ranges), height)))


@pytest.mark.parametrize(
    ("beams", "first", "step"), [(1081, -2.35619449, 0.00436332), (360, -math.pi, 2 * math.pi / 360)]
)
@pytest.mark.parametrize(("kind", "big"), [(7, False), (8, True)])
def test_a_planar_cloud_is_a_scan(tmp_path: Path, beams: int, first: float, step: float, kind: int, big: bool) -> None:
    random = np.random.default_rng(4)
    ranges = random.uniform(0.3, 20.0, (30, beams))
    seen = random.uniform(size=ranges.shape) < 0.8
    seen[:, 0] = True
    events = [
        cloud(0.1 * i, fan_points(r, first, step, 0.02)[s], kind=kind, big=big)
        for i, (r, s) in enumerate(zip(ranges, seen, strict=True))
    ]
    lidar = lidar_of(make_bag(tmp_path, events))
    assert lidar.ranges.shape == (30, beams)
    np.testing.assert_allclose(lidar.angles, first + step * np.arange(beams), atol=0.02 * step)
    np.testing.assert_array_equal(np.isfinite(lidar.ranges[:]), seen)
    np.testing.assert_allclose(lidar.ranges[:][seen], ranges[seen], rtol=1e-6)


@pytest.mark.parametrize(
    ("event", "changes"),
    [
        (cloud(0, np.random.default_rng(0).uniform(-1, 1, (500, 3))), {}),
        (cloud(0, np.random.default_rng(0).uniform(-1, 1, (500, 3)) * (1, 1, 0)), {}),
        (cloud(0, np.full((5, 3), np.nan)), {}),
        (cloud(0, np.tile((1.0, 2.0, 0.0), (5, 1))), {}),
        (cloud(0, np.ones((5, 3)), names="abc"), {}),
        (cloud(0, np.ones((5, 3)), kind=5), {}),
        (cloud(0, np.ones((5, 3))), {"point_step": 8, "row_step": 40}),
        (cloud(0, np.ones((5, 3))), {"width": 1000, "row_step": 12000}),
        (cloud(0, np.ones((5, 3))), {"height": 2**31, "width": 2**31}),
    ],
)
def test_clouds_of_other_sensors_are_refused(tmp_path: Path, event: Event, changes: dict[str, int]) -> None:
    event.values.update(changes)
    with pytest.raises(InputError) as caught:
        open_recording(make_bag(tmp_path, [event]))
    assert caught.value.field == "/cloud"
