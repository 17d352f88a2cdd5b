"""Stamps and ranges as files have them: sorted, cut, and what stands for no return."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from issues import counted
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.streams import Fan, Sensors, clock_cuts, sort_by_stamp
from moteslam.robot.platform import Platform
from moteslam.robot.recording import SICK_REACH, no_return_limit
from moteslam.robot.values import Issue

FILE = Path("folder/file.npz")
RUN = np.arange(100) / 5 + 1.4e9


@given(st.lists(st.integers(0, 19).map(lambda tenths: tenths / 10), min_size=1, max_size=50))
def test_sorting_is_stable_and_told(stamps: list[float]) -> None:
    values = np.array(stamps)
    assume(not clock_cuts(values))
    issues = list[Issue]()
    rising, order = sort_by_stamp(FILE, "time_stamps", values, issues)
    assert order.tolist() == sorted(range(len(stamps)), key=lambda k: (stamps[k], k))
    assert rising.tolist() == values[order].tolist()
    back = sum(b < a for a, b in pairwise(stamps))
    assert counted(issues) == ([("stamps-go-back", back)] if back else [])


@pytest.mark.parametrize(
    "stamps",
    [
        [0.0, np.nan],
        [-np.inf, 0],
        [1.3e15, 1.3e15 + 1],
        [0.0, 1.0, 86402.0],
        np.arange(0, 4e8, 8e4),
        [*[0.0] * 30, *RUN],
    ],
)
def test_absurd_stamps_are_refused_by_name(stamps: list[float]) -> None:
    with pytest.raises(InputError, match=r"^folder/file\.npz: time_stamps: .*expected"):
        sort_by_stamp(FILE, "time_stamps", np.array(stamps, float), [])


LATE = np.concatenate((RUN[:50], RUN[30:35], RUN[50:]))


@pytest.mark.parametrize(
    ("stamps", "first"),
    [
        (np.concatenate((RUN, RUN)), 100),
        (np.concatenate((RUN, RUN[:4])), 100),
        (np.concatenate((RUN[50:], RUN)), 50),
        (np.concatenate((RUN[:50], RUN[50:] - 0.8)), 50),
        (np.concatenate((RUN[:50], RUN[50:] - 0.41)), 50),
        (np.concatenate((RUN[:95], RUN[95:] - 0.25)), 95),
        (RUN, None),
        (LATE, None),
        (np.concatenate((RUN[:40], RUN[45:50], RUN[40:45], RUN[50:])), None),
        (np.concatenate((RUN[:50], RUN[50:] - 0.15)), None),
        (RUN + 0.4 * np.sin(np.arange(100)), None),
    ],
    ids=[
        "looped",
        "just now",
        "catches up",
        "a little",
        "two steps",
        "one step",
        "rising",
        "late",
        "a burst",
        "less than a step",
        "jitter",
    ],
)
def test_a_clock_that_is_set_back_is_no_late_message(stamps: np.ndarray, first: int | None) -> None:
    assert clock_cuts(stamps)[:1] == ([] if first is None else [first])
    if first is None:
        assert (np.diff(sort_by_stamp(FILE, "x", stamps, [])[0]) >= 0).all()
    else:
        with pytest.raises(InputError, match=rf"x: the clock goes back by .* at reading {first} and goes on"):
            sort_by_stamp(FILE, "x", stamps, [])


EVENLY = np.arange(600) / 5.476 + 1.3e9 + 0.12
TENTHS = np.arange(600) / 10 + np.random.default_rng(2).uniform(1e-3, 3e-3, 600)
UNEVENLY = 1.3e9 + np.cumsum(np.random.default_rng(3).uniform(0.2, 1.5, 600))


@pytest.mark.parametrize(
    ("stamps", "scale"),
    [(EVENLY, 1), (UNEVENLY, 1), (EVENLY[:150], 1), (np.arange(9000) / 100 + 0.005, 1), (TENTHS, 1), (EVENLY, 1000)],
    ids=["evenly", "key scans", "few", "fast", "at whole tenths", "microseconds"],
)
def test_stamps_without_leading_zeros_are_told(stamps: NDArray[np.float64], scale: int) -> None:
    words = [f"{int(one)}.{round(one % 1 * 1e9 / scale)}" for one in stamps.tolist()]
    wrong = np.array([float(word) for word in words])
    for written in (wrong, np.sort(wrong)):
        issues = list[Issue]()
        sort_by_stamp(FILE, "x", written, issues)
        (message,) = [issue.message for issue in issues if issue.code == "stamps-jitter"]
        assert message.startswith("file.npz: x: no stamp has a fraction below 0.1 s: nano- or")


@pytest.mark.parametrize(
    "stamps",
    [
        *(np.arange(1000) / rate + begin for rate in (0.5, 1, 2, 3, 9, 10, 100) for begin in (0.0, 0.1, 1.3e9 + 0.1)),
        np.arange(150) / 0.9911 + 100.1,
        np.arange(1000) / 5.0005 + 0.1,
        np.arange(1000) / 10 + np.random.default_rng(0).uniform(0, 5e-4, 1000),
        np.sort(np.ceil(EVENLY) + 0.002 * (np.arange(600) % 6)),
        np.round(EVENLY, 1),
        np.round(EVENLY, 6),
        TENTHS,
        UNEVENLY,
        np.rint(UNEVENLY),
    ],
)
def test_sound_stamps_are_not_taken_for_such(stamps: NDArray[np.float64]) -> None:
    for count in (40, 100, len(stamps)):
        issues = list[Issue]()
        sort_by_stamp(FILE, "x", stamps[:count], issues)
        assert issues == []


@pytest.mark.parametrize("zeros", [1, 3, 8])
def test_readings_from_before_the_clock_was_set_are_left_out_and_counted(zeros: int) -> None:
    stamps = np.concatenate((np.zeros(zeros), RUN))
    issues = list[Issue]()
    _, order = sort_by_stamp(FILE, "x", stamps, issues)
    (issue,) = issues
    assert (issue.code, issue.count) == ("unset-stamps", zeros)
    assert order.tolist() == list(range(zeros, zeros + 100))


def readings(n: int = 20_000, longest: float = 7.0, seed: int = 0) -> NDArray[np.float32]:
    """Centimetre readings of a room, long ones rare."""
    ranges = np.random.default_rng(seed).beta(1.5, 3.0, n) * longest
    return ranges.round(2).astype(np.float32)


@pytest.mark.parametrize(
    ("code", "count"), [*((code, 1) for code in (81.83, 81.91, 81.87, 100.0, 1000.0)), (8.0, 30), (8.0, 0)]
)
def test_without_a_spike_a_sick_reaches_80_metres(code: float, count: int) -> None:
    ranges = readings()
    ranges[:count] = code  # 30 are 0.15 %: some wall
    assert no_return_limit(ranges, None) == SICK_REACH


@pytest.mark.parametrize("limit", [8.0, 29.99, 32.0, 50.0])
@pytest.mark.parametrize("share", [0.01, 0.1, 0.9])
def test_a_spike_at_the_longest_range_is_the_limit(limit: float, share: float) -> None:
    ranges = readings()
    ranges[: int(share * len(ranges))] = limit
    assert no_return_limit(ranges, None) == np.float32(limit)


def test_of_several_codes_the_most_frequent_is_the_limit() -> None:
    ranges = readings()
    ranges[:1500], ranges[1500:1540], ranges[1540:1545] = 8.183, 8.187, 8.191
    assert no_return_limit(ranges, None) == np.float32(8.183)
    ranges[:200] = np.nextafter(np.float32(8.183), np.float32(9))  # as some logs are rounded
    assert no_return_limit(ranges, None) == np.float32(8.183)
    ranges[:700] = 8.187  # as a wall, at two values
    assert no_return_limit(ranges, None) == SICK_REACH
    ranges[:1500] = 8.12  # a wall, too far below the longest
    assert no_return_limit(ranges, None) == SICK_REACH


@pytest.mark.parametrize(
    "ranges",
    [
        np.full(1000, 5.0),
        np.tile([1.0, 2.0, 3.0], 500),
        np.append(np.full(500, 5.0), np.zeros(100)),
        np.arange(1.0, 20.0),
        np.array([]),
        np.array([np.nan, np.inf]),
    ],
)
def test_a_robot_that_sees_the_same_wall_has_no_limit(ranges: NDArray[np.float64]) -> None:
    assert no_return_limit(ranges.astype(np.float32), None) == SICK_REACH


@pytest.mark.parametrize(("stated", "limit"), [(30.0, 30.0), (80.0, 80.0), (81.9, 80.0), (81.92, 80.0), (120.0, 120.0)])
def test_what_the_log_states_goes_first(stated: float, limit: float) -> None:
    ranges = readings()
    ranges[:1000] = 81.83
    assert no_return_limit(ranges, stated) == limit


CODES = {"near": 0.25, "far": 9.0, "beyond it": 7.0}
"""What stands for no return [m], the last with a few endpoints beyond it."""


def scans_of(change: str) -> NDArray[np.float32]:
    """80 scans of 60 beams of a robot that drives, with ranges to the millimetre of 0.5 to 8 m, and one fault."""
    rng = np.random.default_rng(0)
    base = 2 + 3 * np.abs(np.sin(np.linspace(0.3, 4, 60))) + np.linspace(0, 1, 60)
    ranges = np.round(base + 0.02 * np.arange(80)[:, None] + rng.normal(0, 0.01, (80, 60)), 3)
    hidden = rng.random(ranges.shape) < 0.2
    if change in CODES:
        ranges[hidden] = CODES[change]
    elif change == "rare":
        ranges[10:30][hidden[10:30] & (rng.random((20, 60)) < 0.3)] = 9.0
    elif change == "mast":
        ranges[:, 20:26] = 0.25
    elif change == "codes":
        ranges[hidden] = rng.choice([65.533, 81.9, 20.0], hidden.sum())
    return ranges.astype(np.float32)


@pytest.mark.parametrize(
    ("change", "range_max", "codes", "words", "endpoints"),
    [
        ("sound", 10.0, [], "", 1.0),
        ("given", 4.0, [], "", 0.13),
        ("sound", 4.0, ["range-max"], "beyond range_max (4 m)", 0.13),
        ("near", 10.0, ["range-max"], "0.25 m away, the shortest", 0.8),
        ("far", 10.0, ["range-max"], "9 m away, the longest", 0.8),
        ("rare", 10.0, ["range-max"], "9 m away, the longest", 0.985),
        ("beyond it", 10.0, ["range-max"], "7 m away, the longest usual", 0.79),
        ("mast", 10.0, [], "", 1.0),
        ("codes", 10.0, [], "", 0.8),
    ],
)
def test_what_scans_show_of_their_limits(
    change: str, range_max: float, codes: list[str], words: str, endpoints: float
) -> None:
    issues: list[Issue] = []
    fan = Fan(-1.0, 0.03, 0.1, range_max)
    given = {"range_max": range_max} if change == "given" else {}
    lidar = Sensors(Platform(), given, issues).lidar(FILE, "ranges", np.arange(80) / 5, scans_of(change), fan)
    assert [issue.code for issue in issues] == codes
    assert all(words in issue.message for issue in issues)
    assert np.isfinite(lidar.ranges).mean() == pytest.approx(endpoints, abs=0.03)
