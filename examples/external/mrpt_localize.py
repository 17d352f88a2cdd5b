"""MRPT's ``pf-localization`` over a CARMEN log, in a map_server map: what ``moteslam localize`` is compared with.

    python3 mrpt_localize.py --recording log --map map.yaml --out folder --start X Y THETA

It leaves ``trajectory.tum``, the mean of the particles at every scan, and ``spread.txt``, the square root of the trace
of their covariance, a line a scan. Without ``--start`` the particles begin in all free cells. The settings are those
of localization_demo.ini, but for ``--set``; the generator of random numbers takes no seed. Made for MRPT 2.5.8.
"""

import argparse
import gzip
import math
import re
import sys
from pathlib import Path

from mrpt_slam import SlamError, as_ini, as_pairs, as_tum, read_log, run

SPREAD, TURN = 0.5, 20.0  # Around a start, to each side [m], [degrees]
SETTINGS: dict[str, dict[str, object]] = {
    "KLD_options": {
        "KLD_binSize_PHI_deg": 10,
        "KLD_binSize_XY": 0.1,
        "KLD_delta": 0.01,
        "KLD_epsilon": 0.01,
        "KLD_maxSampleSize": 40000,
        "KLD_minSampleSize": 150,
        "KLD_minSamplesPerBin": 0,
    },
    "PF_options": {"PF_algorithm": 0, "resamplingMethod": 0, "adaptiveSampleSize": 1, "BETA": 0.5, "sampleSize": 1},
    "LocalizationExperiment": {
        "map_file": "map.gridmap.gz",
        "rawlog_file": "recording.rawlog",
        "logOutput_dir": "mrpt",
        "3DSceneFrequency": -1,
        "particles_count": 40000,
        "init_PDF_mode": 0,
        "SHOW_PROGRESS_3D_REAL_TIME": "false",
    },
    "MetricMap": {"occupancyGrid_count": 1, "likelihoodMapSelection": -1},
    "MetricMap_occupancyGrid_00_creationOpts": {"resolution": 0.05},
    "MetricMap_occupancyGrid_00_likelihoodOpts": {
        "likelihoodMethod": 4,
        "LF_decimation": 10,
        "LF_stdHit": 0.4,
        "LF_maxCorrsDistance": 0.3,
        "LF_zHit": 0.95,
        "LF_zRandom": 0.05,
        "LF_maxRange": 80,
        "LF_alternateAverageMethod": 0,
    },
}
ESTIMATE = re.compile(r"PDF estimation: \((\S+),(\S+),(\S+)deg\).*tr\(cov\): (\S+)")


def limits(start: list[float] | None) -> dict[str, object]:
    """Where the particles begin: around a start, or wherever the map is free."""
    if start is None:
        middle, half = (0.0, 0.0, 0.0), (1e4, 1e4, 180.0)
    else:
        middle, half = (start[0], start[1], math.degrees(start[2])), (SPREAD, SPREAD, TURN)
    ends = zip(("x", "y", "yaw_deg"), middle, half, strict=True)
    return {f"init_PDF_{end}_{name}": m + s * h for name, m, h in ends for end, s in (("min", -1), ("max", 1))}


def localize(recording: Path, occupancy: Path, out: Path, start: list[float] | None, changes: list[str]) -> None:
    """Run it; the files are in ``out`` after it.

    Args:
        changes: ``section.key=value``.
    """
    out.mkdir(parents=True, exist_ok=True)
    scans = read_log(recording.read_text(encoding="utf-8"))
    run("ros-map-yaml2mrpt", "-q", "-w", "-d", ".", "-i", str(occupancy.absolute()), folder=out)
    (out / f"{occupancy.stem}.gridmap.gz").replace(out / "map.gridmap.gz")
    rawlog = "recording.rawlog"
    run("carmen2rawlog", "-q", "-w", "-z", "1", "-i", str(recording.absolute()), "-o", rawlog, folder=out)
    (out / rawlog).write_bytes(as_pairs(gzip.decompress((out / rawlog).read_bytes()), scans))
    sections = {name: {**keys} for name, keys in SETTINGS.items()}
    sections["LocalizationExperiment"] |= limits(start)
    for change in changes:
        name, _, value = change.partition("=")
        section, _, key = name.rpartition(".")
        sections.setdefault(section, {})[key] = value
    (out / "localize.ini").write_text(as_ini(sections), encoding="utf-8")
    found = ESTIMATE.findall(run("pf-localization", "localize.ini", folder=out))
    rows = (f"{k} {x} {y} {math.radians(float(yaw))!r}\n" for k, (x, y, yaw, _) in enumerate(found))
    (out / "trajectory.tum").write_text(as_tum("".join(rows), [stamp for stamp, _ in scans], 3), encoding="utf-8")
    (out / "spread.txt").write_text("".join(f"{one[3]}\n" for one in found), encoding="utf-8")


def main() -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(description="MRPT's pf-localization over a CARMEN log.")
    parser.add_argument("--recording", type=Path, required=True)
    parser.add_argument("--map", type=Path, required=True, help="the YAML of a map_server map")
    parser.add_argument("--out", type=Path, required=True, help="a folder for what it leaves")
    parser.add_argument("--start", nargs=3, type=float, metavar=("X", "Y", "THETA"), help="of the robot [m], [rad]")
    parser.add_argument("--set", action="append", default=[], metavar="SECTION.KEY=VALUE", help="another setting")
    given = parser.parse_args()
    try:
        localize(given.recording, given.map, given.out, given.start, given.set)
    except (SlamError, OSError) as problem:
        sys.stderr.write(f"mrpt_localize: {problem}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
