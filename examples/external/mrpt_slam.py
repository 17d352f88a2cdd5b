"""The SLAM of MRPT, as Debian's package mrpt-apps installs it, over a CARMEN log.

    python3 mrpt_slam.py --method icp --recording log --platform robot.toml --out folder --seed 0

The methods are ``icp`` and ``rbpf``; ``odometry`` gives back the log's own poses, to compare with. It runs
``carmen2rawlog``, then ``icp-slam`` or ``rbpf-slam``, and leaves ``trajectory.tum``, ``map.yaml`` and ``map.png`` in
the folder. Where a program is missing or fails there is one line on stderr, and the exit code is 2. Python's standard
library is all it needs. Made for MRPT 2.5.8; what is peculiar to that version is in ``as_pairs``.
"""

import argparse
import gzip
import math
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path

Scan = tuple[float, tuple[float, float, float]]
"""What a log says beside the ranges: the stamp [s] and the pose of the odometry [m, rad]."""

METHODS = {"icp": ("icp-slam", 3), "rbpf": ("rbpf-slam", 4), "odometry": ("", 3)}
"""Program, and which word of a line of ``log_estimated_path.txt`` is the yaw: rbpf-slam writes a height before it."""

CELL = 0.05  # Of the map [m]
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.55, 0.45
"""A grey of MRPT's maps is a probability, and what nobody saw lies at 0.5."""

ODOMETRY, SCAN = b"\x9fmrpt::obs::CObservationOdometry", b"\xa2mrpt::obs::CObservation2DRangeScan"
"""How an object begins in a rawlog: the length of its class's name with the highest bit set, and the name."""
LABEL = b"\x0b\x00\x00\x00ROBOTLASER1"
EPOCH = 116_444_736_000_000_000  # 1970 on MRPT's clock, in 100 ns since 1601
MOTION_MODEL = (0.01, math.degrees(0.001), math.radians(1), 0.05, 0.01, math.radians(0.2))
"""a1 to a4, minStdXY and minStdPHI of MRPT's Gaussian motion model: its own default values."""
OTHER_MODEL = (300, 0.15, 0.25, 0.15, 0.1, 0.0, 0.0)
"""Particles and coefficients of its other motion model, which a rawlog holds though it is not used."""

NO_MAPS = {"gasGrid_count": 0, "landmarksMap_count": 0, "beaconMap_count": 0, "likelihoodMapSelection": -1}
QUIET = {"LOG_FREQUENCY": 0, "SAVE_3D_SCENE": 0, "SAVE_POSE_LOG": 0}
GRID = {
    "creationOpts": {"resolution": CELL},
    "insertOpts": {
        "maxDistanceInsertion": 30,
        "maxOccupancyUpdateCertainty": 0.8,
        "considerInvalidRangesAsFreeSpace": 0,
    },
}
"""Of the occupancy grid, for both programs."""


class SlamError(Exception):
    """What the user is to read, in one line."""


def read_log(text: str) -> list[Scan]:
    """The scans of a CARMEN log, its ROBOTLASER1 lines, in their order.

    Raises:
        SlamError: there are none.
    """
    scans = []
    for line in text.splitlines():
        if line.startswith("ROBOTLASER1 "):
            *_, x, y, theta, _, _, _, _, _, stamp, _, _ = line.rsplit(maxsplit=11)
            scans.append((float(stamp), (float(x), float(y), float(theta))))
    if not scans:
        raise SlamError("no ROBOTLASER1 line in the recording, expected a CARMEN log of moteslam")
    return scans


def as_pairs(rawlog: bytes, scans: list[Scan]) -> bytes:
    """A rawlog of odometry readings and scans as one of pairs: how the robot moved, and the scan after it.

    rbpf-slam reads pairs alone. And carmen2rawlog 2.5.8 gives every observation the time at which it was started:
    with equal stamps icp-slam matches a single scan, and follows the odometry from there on. Here each has its own.

    Args:
        rawlog: what carmen2rawlog wrote, unpacked.
        scans: of the log.

    Raises:
        SlamError: it does not hold these scans.
    """
    starts = [found.start() for found in re.finditer(re.escape(SCAN), rawlog)]
    if len(starts) != len(scans):
        raise SlamError(f"carmen2rawlog wrote {len(starts)} scans, expected the {len(scans)} of the recording")
    pairs = []
    before = scans[0][1]
    for start, (stamp, pose) in zip(starts, scans, strict=True):
        end = rawlog.find(ODOMETRY, start)
        scan = bytearray(rawlog[start : end if end >= 0 else len(rawlog)])
        ticks = struct.pack("<Q", round(stamp * 1e7) + EPOCH)
        label = scan.rfind(LABEL)
        if label < 12:
            raise SlamError("carmen2rawlog wrote a scan of another form, expected that of MRPT 2.5.8")
        scan[label - 12 : label - 4] = ticks  # the stamp, then 4 bytes of the beam's width, then the label
        moved = struct.pack("<3d", *_between(before, pose))
        models = struct.pack("<I6f", 0, *MOTION_MODEL) + struct.pack("<I6f", *OTHER_MODEL)
        unknown = bytes(9 + 9)  # velocities and ticks of encoders: none
        movement = struct.pack("<I", 0) + _object("mrpt::poses::CPose2D", 1, moved) + models + unknown + ticks
        action = _object("mrpt::obs::CActionRobotMovement2D", 6, movement)
        pairs.append(_object("mrpt::obs::CActionCollection", 0, struct.pack("<I", 1) + action))
        pairs.append(_object("mrpt::obs::CSensoryFrame", 2, struct.pack("<I", 1) + bytes(scan)))
        before = pose
    return b"".join(pairs)


def _object(name: str, version: int, content: bytes) -> bytes:
    """An object as MRPT writes it: name, version, content, end."""
    return bytes([0x80 | len(name)]) + name.encode() + bytes([version]) + content + b"\x88"


def _between(first: tuple[float, float, float], second: tuple[float, float, float]) -> tuple[float, float, float]:
    """The second pose in the frame of the first."""
    dx, dy, (cos, sin) = second[0] - first[0], second[1] - first[1], (math.cos(first[2]), math.sin(first[2]))
    return cos * dx + sin * dy, cos * dy - sin * dx, math.remainder(second[2] - first[2], math.tau)


def settings(method: str, seed: int) -> dict[str, dict[str, object]]:
    """What goes into the .ini file, by section.

    Begun from the files that mrpt-common ships, icp-slam_demo_classic.ini and
    gridmapping_RBPF_grid_ICPbased_malaga.ini; what differs was chosen on recordings of other seeds than those of
    mrpt.toml: poses are corrected and scans inserted more often, and icp-slam keeps a grid beside its points.
    """
    grid: dict[str, dict[str, object]] = {f"MappingApplication_occupancyGrid_00_{key}": {**GRID[key]} for key in GRID}
    if method == "icp":
        matching: dict[str, object] = {
            "ICP_algorithm": "icpClassic",
            "maxIterations": 80,
            "minAbsStep_trans": 1e-6,
            "minAbsStep_rot": 1e-6,
            "thresholdDist": 0.3,
            "thresholdAng_DEG": 5,
            "ALFA": 0.8,
            "smallestThresholdDist": 0.05,
            "onlyClosestCorrespondences": "true",
            "onlyUniqueRobust": "true",
            "corresponding_points_decimation": 5,
        }
        mapping: dict[str, object] = {
            "logOutput_dir": "mrpt",
            "rawlog_offset": 0,
            "CAMERA_3DSCENE_FOLLOWS_ROBOT": 0,
            "SHOW_PROGRESS_3D_REAL_TIME": 0,
            "SHOW_PROGRESS_3D_REAL_TIME_DELAY_MS": 0,
            "SHOW_LASER_SCANS_3D": "false",
            "localizationLinDistance": 0.1,
            "localizationAngDistance": 3,
            "insertionLinDistance": 0.5,
            "insertionAngDistance": 20,
            "minICPgoodnessToAccept": 0.4,
            "matchAgainstTheGrid": 0,
            "pointsMap_count": 1,
            "occupancyGrid_count": 1,
        }
        points: dict[str, object] = {"minDistBetweenLaserPoints": 0.05, "fuseWithExisting": "false", "isPlanarMap": 1}
        return {
            "ICP": matching,
            "MappingApplication": mapping | QUIET | NO_MAPS,
            "MappingApplication_pointsMap_00_insertOpts": points,
            **grid,
        }
    particles: dict[str, object] = {
        "logOutput_dir": "mrpt",
        "rawlog_offset": 0,
        "RANDOM_SEED": seed % 2**31,
        "SHOW_PROGRESS_IN_WINDOW": 0,
        "SAVE_MAP_IMAGES": 0,
        "insertionLinDistance": 0.5,
        "insertionAngDistance_deg": 20,
        "localizeLinDistance": 0.2,
        "localizeAngDistance_deg": 5,
        "PF_algorithm": 2,
        "pfOptimalProposal_mapSelection": 0,
        "ICPGlobalAlign_MinQuality": 0.7,
        "adaptiveSampleSize": 0,
        "resamplingMethod": 3,
        "sampleSize": 30,
        "BETA": 0.5,
        "ICP_algorithm": 0,
        "maxIterations": 60,
        "thresholdDist": 0.3,
        "thresholdAng_DEG": 5,
        "ALFA": 0.5,
        "smallestThresholdDist": 0.05,
        "onlyClosestCorrespondences": 1,
        "pointsMap_count": 0,
        "occupancyGrid_count": 1,
    }
    likelihood: dict[str, object] = {
        "likelihoodMethod": 4,
        "LF_decimation": 5,
        "LF_stdHit": 0.5,
        "LF_maxCorrsDistance": 0.3,
        "LF_zHit": 0.999,
        "LF_zRandom": 0.001,
        "LF_maxRange": 30,
        "LF_alternateAverageMethod": 0,
        "enableLikelihoodCache": 1,
    }
    return {
        "MappingApplication": particles | QUIET | NO_MAPS,
        **grid,
        "MappingApplication_occupancyGrid_00_likelihoodOpts": likelihood,
    }


def as_ini(sections: dict[str, dict[str, object]]) -> str:
    """Sections and their keys as the text of an .ini file."""
    return "\n".join(
        "".join([f"[{name}]\n", *(f"{key} = {value}\n" for key, value in keys.items())])
        for name, keys in sections.items()
    )


def as_tum(path: str, stamps: list[float], yaw: int) -> str:
    """A ``log_estimated_path.txt``, a line a scan, as TUM lines.

    Args:
        path: its text: the number of the scan, x and y [m], and more words.
        stamps: of the scans [s].
        yaw: which word of a line is the yaw [rad].

    Raises:
        SlamError: another number of poses than of scans.
    """
    rows = [line.split() for line in path.splitlines() if line.strip() and not line.startswith("%")]
    if len(rows) != len(stamps):
        raise SlamError(f"{len(rows)} poses in log_estimated_path.txt, expected {len(stamps)}, one a scan")
    lines = []
    for stamp, row in zip(stamps, rows, strict=True):
        half = float(row[yaw]) / 2
        lines.append(f"{stamp!r} {row[1]} {row[2]} 0 0 0 {math.sin(half)!r} {math.cos(half)!r}\n")
    return "".join(lines)


def as_yaml(limits: str, image: str) -> str:
    """The map_server YAML of a grid's image.

    Args:
        limits: text of its ``_limits.txt``: x_min, x_max, y_min, y_max [m]; the image has its largest y at the top.
        image: name of its file.

    Raises:
        SlamError: the limits are not four numbers.
    """
    words = [word for line in limits.splitlines() if not line.startswith("%") for word in line.split()]
    try:
        left, _, bottom, _ = map(float, words)
    except ValueError:
        raise SlamError(f"{len(words)} words in the limits of the map, expected four numbers") from None
    return (
        f"image: {image}\nresolution: {CELL}\norigin: [{left}, {bottom}, 0.0]\nnegate: 0\n"
        f"occupied_thresh: {OCCUPIED_THRESHOLD}\nfree_thresh: {FREE_THRESHOLD}\n"
    )


def run(*words: str, folder: Path) -> str:
    """Run a program in a folder; what it printed.

    Raises:
        SlamError: it is not there, or fails.
    """
    try:
        done = subprocess.run(words, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    except OSError as error:
        problem = error.strerror or str(error)
        raise SlamError(f"{words[0]}: {problem}, expected Debian's package mrpt-apps installed") from error
    if done.returncode:
        printed = (done.stderr + done.stdout).decode("utf-8", "replace").splitlines()
        said = next((line for line in printed if line.startswith("Message:")), printed[-1] if printed else "")
        raise SlamError(f"{words[0]} ended with exit code {done.returncode}: {said.strip()}")
    return done.stdout.decode("utf-8", "replace")


def slam(method: str, recording: Path, out: Path, seed: int) -> None:
    """Run a method over a log; its trajectory is in ``out`` after it, and its map if it has one.

    Raises:
        SlamError: no such log, a program that is missing or fails, or other output than that of MRPT 2.5.8.
    """
    try:
        scans = read_log(recording.read_text(encoding="utf-8"))
    except OSError as error:
        raise SlamError(f"{recording}: {error.strerror}, expected a CARMEN log") from error
    stamps, trajectory, (program, yaw) = [stamp for stamp, _ in scans], out / "trajectory.tum", METHODS[method]
    if not program:
        rows = "".join(f"{number} {x!r} {y!r} {theta!r}\n" for number, (_, (x, y, theta)) in enumerate(scans))
        trajectory.write_text(as_tum(rows, stamps, yaw), encoding="utf-8")
        return
    rawlog = "recording.rawlog"
    run("carmen2rawlog", "-q", "-w", "-z", "1", "-i", str(recording.absolute()), "-o", rawlog, folder=out)
    file = out / rawlog
    file.write_bytes(as_pairs(gzip.decompress(file.read_bytes()), scans))
    (out / "slam.ini").write_text(as_ini(settings(method, seed)), encoding="utf-8")
    run(program, "slam.ini", rawlog, folder=out)
    written = out / "mrpt"
    path = (written / "log_estimated_path.txt").read_text(encoding="utf-8")
    trajectory.write_text(as_tum(path, stamps, yaw), encoding="utf-8")
    for limits in written.glob("*COccupancyGridMap2D_00_limits.txt"):
        shutil.copyfile(limits.with_name(limits.name.replace("_limits.txt", ".png")), out / "map.png")
        (out / "map.yaml").write_text(as_yaml(limits.read_text(encoding="utf-8"), "map.png"), encoding="utf-8")


def main() -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(description="The SLAM of MRPT over a CARMEN log.")
    parser.add_argument("--method", choices=METHODS, required=True)
    parser.add_argument("--recording", type=Path, required=True)
    parser.add_argument("--platform", type=Path, help="the robot; the log has all that MRPT needs of it")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    try:
        slam(given.method, given.recording, given.out, given.seed)
    except (SlamError, OSError) as problem:
        sys.stderr.write(f"mrpt_slam: {problem}\n")
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
