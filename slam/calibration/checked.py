"""A recording held against itself, as a whole and, where that does not fit, in parts."""

from moteslam.robot.formats import Cut, cut
from moteslam.robot.recording import Recording
from moteslam.robot.values import Issue
from moteslam.slam.calibration.calibrate import FEW_PAIRS, PAIRS, Calibration, estimate
from moteslam.slam.calibration.findings import Findings, findings
from moteslam.slam.calibration.unmeasured import UnmeasuredError

HALVINGS = 3
"""After the first, to find the time from which on something is not as stated: to a sixteenth of the drive."""


def checked(recording: Recording, pairs: int = PAIRS) -> tuple[Calibration | None, Findings | None]:
    """A recording held against itself, and what that says, also of one of which nothing can be measured.

    Both are None where too little is there, or the robot hardly turns; ``pairs`` as of ``calibrate``.
    """
    calibration, found = _checked(recording, pairs)
    c = calibration
    if c is None or found is None or (c.fits and c.gyro and not c.uneven):
        return calibration, found
    changes = _changes(recording, {issue.code for issue in found.issues})
    return (None, Findings((), changes, changes, frozenset())) if changes else (calibration, found)


def _checked(recording: Recording, pairs: int) -> tuple[Calibration | None, Findings | None]:
    try:
        calibration = estimate(recording, pairs)
    except UnmeasuredError as error:
        issue = Issue(*error.args)
        return None, Findings((), (issue,), (issue,), frozenset())
    return calibration, None if calibration is None else findings(calibration, recording)


def _changes(recording: Recording, known: set[str]) -> tuple[Issue, ...]:
    """What is not as stated in the first or the last part of a recording alone, if it is anything else than ``known``:
    codes of the whole.
    """
    stamps = [each for each in recording.stamps().values() if len(each)]
    duration = max(float(each[-1]) for each in stamps) - min(float(each[0]) for each in stamps)

    def issues(time: float, *, before: bool) -> tuple[Issue, ...] | None:
        found = _checked(cut(recording, Cut(end=time) if before else Cut(start=time)), FEW_PAIRS)[1]
        return None if found is None else found.issues

    for early in (True, False):  # which part is sound
        begin, bad = (0.0, duration) if early else (duration, 0.0)
        good = begin
        for halving in range(1 + HALVINGS):
            tried = (good + bad) / 2
            if issues(tried, before=early) == ():
                good = tried
            elif halving and good == begin:  # nor is a quarter
                break
            else:
                bad = tried
        others = issues(good, before=not early) if good != begin else None
        if not others or {issue.code for issue in others} <= known:
            continue
        time = f"about {good:.0f} s after its start"
        where = f"from {time} on, not before" if early else f"until {time}, not later"
        where += f" (replay them apart, --{'start' if early else 'end'} {good:.0f})"
        return tuple(Issue("odometry-unfit", f"{where}: {issue.message}") for issue in others)
    return ()
