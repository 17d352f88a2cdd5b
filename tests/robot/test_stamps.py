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
from moteslam.robot.formats.streams import SET_BACK, clock_cuts, stamp_order

FILE = Path("folder/file.npz")
RUN = np.arange(100) / 5 + 1.4e9


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
        stamp_order(np.array(stamps, float), file=FILE, field="time_stamps")


def test_a_day_is_still_a_gap() -> None:
    assert stamp_order(np.array([0.0, 86400.0]), file=FILE, field="x") == (None, ())


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
    assert clock_cuts(stamps, SET_BACK)[:1] == ([] if first is None else [first])
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
