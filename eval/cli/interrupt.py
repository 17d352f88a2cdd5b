"""Ctrl-C and SIGTERM as an exception that unwinds, so that no half result is left."""

from __future__ import annotations

import signal
import threading
from types import FrameType


class Interrupted(BaseException):
    """The user, or the system, asked the program to stop.

    Attributes:
        exit_code: 128 and the number of the signal: 130 for Ctrl-C.
    """

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


_asked: list[int] = []


def on_interrupt() -> None:
    """From here on SIGINT and SIGTERM raise ``Interrupted``, once; a second waits for the tidying up."""
    _asked.clear()
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _interrupt)


def check_interrupt() -> None:
    """Raise what was asked for once more, in case foreign code swallowed it (callbacks from C do)."""
    if _asked:
        raise Interrupted(_asked[0])


def _interrupt(number: int, _frame: FrameType | None) -> None:
    if not _asked:
        _asked.append(number)
        raise Interrupted(number)
