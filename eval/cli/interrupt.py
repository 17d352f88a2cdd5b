"""Ctrl-C, SIGTERM and SIGHUP: at the start and at the end the program just goes, in between it unwinds and tidies up.

This module imports next to nothing: it is there before the rest of the program is read.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""What asks a program to stop: Ctrl-C, the system, a terminal that is closed (which Windows has not)."""
MESSAGE = "interrupted, nothing was left behind"


class Interrupted(BaseException):
    """Asked to stop by a signal; the exit code is 128 and its number: 130 for Ctrl-C."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.exit_code = 128 + number


_asked: list[int] = []
_ended: list[int] = []


def leave_at_once() -> None:
    """From here on a signal ends the program on the spot, in one line: while it is read, there is nothing to tidy."""

    def leave(number: int, _frame: FrameType | None) -> None:
        os.write(2, f"moteslam: {MESSAGE}\n".encode())
        os._exit(128 + number)

    _handle(leave)


def on_interrupt() -> None:
    """From here on a signal raises ``Interrupted``, once; a second waits for the tidying up."""
    _asked.clear()
    _ended.clear()
    _handle(_interrupt)


def until_interrupt(read: Callable[[], bytes]) -> Iterator[bytes]:
    """What is read until it is empty, or until Ctrl-C, which ends this input alone; a second is an interrupt."""
    waiting = False

    def end(number: int, frame: FrameType | None) -> None:
        if _ended:
            _interrupt(number, frame)
            return
        _ended.append(number)
        if waiting:  # the work on what was read before is not broken off
            raise Interrupted(number)

    _handle(end, SIGNALS[:1])
    try:
        while not _ended:
            waiting = True
            found = read()
            waiting = False
            check_interrupt()
            if not found:
                return
            yield found
    except Interrupted:
        check_interrupt()


def input_ended() -> bool:
    """Whether a Ctrl-C ended the input."""
    return bool(_ended)


def leave_with(code: int) -> None:
    """From here on a signal ends the program with this code: all is done and printed."""
    _handle(lambda _number, _frame: os._exit(code))


def check_interrupt() -> None:
    """Raise what was asked for, in case foreign code swallowed it or it could not be raised there."""
    if (asked := was_asked()) is not None:
        raise asked


def was_asked() -> Interrupted | None:
    """What the program was asked for since ``on_interrupt``, if anything."""
    return Interrupted(_asked[0]) if _asked else None


def _handle(handler: object, signals: tuple[signal.Signals, ...] = SIGNALS) -> None:
    if threading.current_thread() is threading.main_thread():
        for number in signals:
            # what was ignored from the start stays so: nohup, and jobs in the background of a script
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handler)  # type: ignore[arg-type]


def _interrupt(number: int, frame: FrameType | None) -> None:
    if _asked:
        return
    _asked.append(number)
    while frame is not None:  # an exception cannot pass through C that calls Python: it would be printed and forgotten
        module = str(frame.f_globals.get("__name__"))
        if module == "pymunk._callbacks" or (module.startswith("pymunk.") and "free" in frame.f_code.co_name):
            return
        frame = frame.f_back
    raise Interrupted(number)
