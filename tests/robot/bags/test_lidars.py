"""Several lidars as one."""

import math
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from box_ranges import box_ranges
from made_bags import START, make_bag, odometry, placed, rolled, scan

from moteslam import open_recording
from moteslam.robot.formats.bags.write import Event, header
from moteslam.robot.recording import LidarStream

HALF = 3.0
"""Half the side of the square room around the robot [m]."""

BEAMS = 720


def lidar_of(path: Path, **options: Any) -> LidarStream:
    return open_recording(path, **options).lidar


room_ranges = partial(box_ranges, low=(-HALF, -HALF), high=(HALF, HALF))


def fan(first: float, beams: int) -> dict[str, float]:
    step = 2 * math.pi / BEAMS
    return {"angle_min": first, "angle_increment": step, "angle_max": first + (beams - 1) * step}


def two_lidars(upside_down: bool = False, late: float = 0.005, rate: float = 0.0) -> list[Event]:
    """A lidar in the front and a later one in the back, each seeing three quarters of a square room."""
    beams = BEAMS * 3 // 4
    angles = -3 * math.pi / 4 + 2 * math.pi / BEAMS * np.arange(beams)
    mounts = {"/front": (0.3, 0.1, 0.2), "/back": (-0.3, -0.1, math.pi)}
    events = []
    for topic, (x, y, yaw) in mounts.items():
        roll = math.pi if upside_down and topic == "/back" else 0.0
        seen = yaw - angles if roll else yaw + angles
        events.append(placed(0, "base_link", topic[1:], (x, y, 0.2), turn=rolled(roll, yaw)))
        for index in range(4):
            stamp = 0.1 * index + (late if topic == "/back" else 0)
            cos, sin = math.cos(rate * stamp), math.sin(rate * stamp)
            ranges = room_ranges(cos * x - sin * y, sin * x + cos * y, rate * stamp + seen)
            events.append(scan(stamp, ranges, topic=topic, frame=topic[1:], **fan(float(angles[0]), beams)))
    return events


@pytest.mark.parametrize(("upside_down", "late", "rate"), [(False, 0.005, 0), (True, 0.005, 0), (False, 0.05, 1.0)])
def test_two_lidars_are_merged_about_the_robot(tmp_path: Path, upside_down: bool, late: float, rate: float) -> None:
    moves = [odometry(0.05 * i, (0.0, 0.0, 0.05 * i * rate)) for i in range(8 if rate else 0)]
    path = make_bag(tmp_path, [*two_lidars(upside_down, late, rate), *moves])
    recording = open_recording(path, topics={"lidar": ("/front", "/back")})
    lidar = recording.lidar
    assert recording.warnings == ()
    assert recording.platform.lidar.pose == (0.0, 0.0, 0.0)
    assert lidar.ranges.shape == (4, BEAMS)
    np.testing.assert_allclose(lidar.stamps, 1.6e9 + 0.1 * np.arange(4), atol=1e-6)
    ranges = lidar.ranges[2]
    seen = np.isfinite(ranges)
    assert seen.mean() > 0.75
    expected = room_ranges(0.0, 0.0, 0.2 * rate + lidar.angles)
    step = 2 * math.pi / BEAMS
    # an endpoint lies up to half a step beside its beam: along a wall that is met at 45 degrees, as long as it is far
    np.testing.assert_allclose(ranges[seen], expected[seen], atol=HALF * math.sqrt(2) * step)


def test_two_lidars_that_take_turns_are_told_without_odometry(tmp_path: Path) -> None:
    recording = open_recording(make_bag(tmp_path, two_lidars(late=0.05)), topics={"lidar": ("/front", "/back")})
    assert [(issue.code, "/back" in issue.message) for issue in recording.warnings] == [("no-odometry", True)]


def test_beams_of_the_first_of_two_lidars_stay_where_they_are(tmp_path: Path) -> None:
    events = [placed(0, "base_link", frame, (x, 0, 0.2)) for frame, x in (("front", 0.0), ("back", -1e-6))]
    for topic in ("/front", "/back"):
        angles = fan(-math.pi / 2 + (math.pi if topic == "/back" else 0), BEAMS // 2)
        events += [scan(0.1 * i, np.full(BEAMS // 2, 1.0), topic=topic, frame=topic[1:], **angles) for i in range(4)]
    lidar = lidar_of(make_bag(tmp_path, events), topics={"lidar": ("/front", "/back")})
    off = (lidar.angles + math.pi / 2) / (2 * math.pi / BEAMS)
    np.testing.assert_allclose(off, np.rint(off), atol=1e-3)


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


@pytest.mark.parametrize(("moves", "noise"), [(0.1, 0.0), (0.1, 0.0005), (0.0, 0.0)])
@pytest.mark.parametrize("frozen", ["/front", "/back"])
def test_a_lidar_that_says_the_same_while_another_moves_is_left_out(
    tmp_path: Path, frozen: str, moves: float, noise: float
) -> None:
    beams, rng = BEAMS // 2, np.random.default_rng(0)
    angles, events = -math.pi / 2 + 2 * math.pi / BEAMS * np.arange(beams), list[Event]()
    for topic, (x, yaw) in {"/front": (0.3, 0.0), "/back": (-0.3, math.pi)}.items():
        events.append(placed(0, "base_link", topic[1:], (x, 0, 0.2), turn=rolled(0.0, yaw)))
        for index in range(40):
            driven = moves * min(index, 20 if topic == frozen else 40)
            ranges = room_ranges(x + driven - 2, 0.0, yaw + angles) + rng.uniform(-noise, noise, beams)
            events.append(scan(0.1 * index, ranges, topic=topic, frame=topic[1:], **fan(float(angles[0]), beams)))
    recording = open_recording(make_bag(tmp_path, events), topics={"lidar": ("/front", "/back")})
    told = [(issue.code, frozen in issue.message) for issue in recording.warnings]
    assert told == [("scans-repeat", True)] * (moves > 0)
    seen = np.isfinite(recording.lidar.ranges[:]).sum(axis=1)
    assert seen[:20].min() > 0.9 * BEAMS
    assert (seen[21:].max() < 0.6 * BEAMS) == (moves > 0)
