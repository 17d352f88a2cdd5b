"""Stamps: what is sorted, what is refused."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from issues import messages

from moteslam.errors import InputError
from moteslam.robot.formats.stamps import set_back, stamp_order

FILE = Path("folder/file.npz")


@given(st.lists(st.integers(0, 19).map(lambda tenths: tenths / 10), min_size=1, max_size=50))
def test_sorting_is_stable_and_told(stamps: list[float]) -> None:
    values = np.array(stamps)
    order, warnings = stamp_order(values, file=FILE, field="time_stamps")
    if order is None:
        assert (np.diff(values) >= 0).all()
        assert warnings == ()
    else:
        assert order.tolist() == sorted(range(len(stamps)), key=lambda k: (stamps[k], k))
        back = sum(b < a for a, b in pairwise(stamps))
        assert messages(warnings) == (
            f"file.npz: time_stamps: {back} stamps go back; the readings were sorted by stamp",
        )


@pytest.mark.parametrize(
    ("stamps", "message"),
    [
        ([0.0, np.nan], "nan at reading 1, expected finite seconds"),
        ([np.inf], "inf at reading 0"),
        ([-np.inf, 0], "-inf at reading 0"),
        ([1.3e15, 1.3e15 + 1], r"1\.3e\+15, expected seconds below 1e11"),
        ([0.0, 1.0, 86402.0], "jump of 86401 s after 1.0, expected steps of less than a day"),
        (np.arange(0, 4e8, 8e4), "span 3.9992e.08 s, expected less than 10 years"),
    ],
)
def test_absurd_stamps_are_refused_by_name(stamps: list[float], message: str) -> None:
    with pytest.raises(InputError, match=rf"^folder/file\.npz: time_stamps: {message}"):
        stamp_order(np.array(stamps, float), file=FILE, field="time_stamps")


def test_a_day_is_still_a_gap() -> None:
    assert stamp_order(np.array([0.0, 86400.0]), file=FILE, field="x") == (None, ())


RUN = np.arange(100) / 5 + 1.4e9
LATE = np.concatenate((RUN[:50], RUN[30:35], RUN[50:]))


@pytest.mark.parametrize(
    ("stamps", "first"),
    [
        (np.concatenate((RUN, RUN)), 100),
        (np.concatenate((RUN, RUN[:4])), 100),
        (np.concatenate((RUN[50:], RUN)), 50),
        (np.concatenate((RUN[60:], RUN[:40], RUN[60:] + 30)), 40),
        (RUN, None),
        (LATE, None),
        (np.concatenate((RUN, RUN[40:42])), None),
        (RUN + 0.4 * np.sin(np.arange(100)), None),
    ],
    ids=["looped", "looped just now", "catches up", "two runs and back", "rising", "late", "late in the end", "jitter"],
)
def test_a_clock_that_is_set_back_is_no_late_message(stamps: np.ndarray, first: int | None) -> None:
    assert set_back(stamps) == first
    if first is None:
        order, _ = stamp_order(stamps, file=FILE, field="x")
        assert (np.diff(stamps if order is None else stamps[order]) >= 0).all()
    else:
        with pytest.raises(InputError, match=rf"x: the clock goes back by .* at reading {first} and goes on"):
            stamp_order(stamps, file=FILE, field="x")


@pytest.mark.parametrize("zeros", [1, 3, 8])
def test_readings_from_before_the_clock_was_set_are_left_out_and_counted(zeros: int) -> None:
    stamps = np.concatenate((np.zeros(zeros), RUN))
    order, (issue,) = stamp_order(stamps, file=FILE, field="x")
    assert (issue.code, issue.count) == ("unset-stamps", zeros)
    assert order is not None
    assert order.tolist() == list(range(zeros, zeros + 100))


def test_many_readings_without_a_stamp_are_refused() -> None:
    with pytest.raises(InputError, match=r"jump of 1\.4e"):
        stamp_order(np.concatenate((np.zeros(30), RUN)), file=FILE, field="x")
