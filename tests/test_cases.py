"""Small inputs made after public bug reports, each with what is right of it: a value, or the field of its refusal."""

import json
from pathlib import Path
from typing import Any

import pytest
from command_lines import Capsys, printed, refused

from moteslam.eval.cli import main

FINAL, ONLINE, SCANS = ("metrics", "final.ate"), ("metrics", "online.ate"), ("scans",)
ATE, HEADING = ("ate", "translation_m", "rmse"), ("ate", "rotation_deg")
HOKUYO = "18_flaser_of_a_hokuyo"


@pytest.fixture
def cases(data_folder: Path) -> Path:
    """The folder of the cases, beside the real recordings; skips with a reason where there is none."""
    folder = data_folder.parent / "cases"
    if not folder.is_dir():
        pytest.skip(f"no cases at {folder}")
    return folder


def found(capsys: Capsys, cases: Path, command: str, *words: str | Path) -> tuple[Any, set[str]]:
    """What a command line over cases answers, and the codes of its warnings, of the recording and of the run."""
    arguments = [cases / word if "/" in str(word) and (cases / word).exists() else word for word in words]
    answer = json.loads(printed(capsys, command, *arguments, "--json"))
    return answer, {one["code"] for one in answer.get("warnings", answer.get("problems", []))}


def value(answer: Any, path: tuple[str, ...]) -> Any:
    for key in path:
        answer = answer[key]
    return answer["value"] if isinstance(answer, dict) and "value" in answer else answer


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize(
    ("words", "path", "most", "codes"),
    [
        (("00_control/drive.bag",), ONLINE, 0.01, set()),
        (("01_beams_differ_from_scan_to_scan/ld19.bag",), FINAL, 0.02, {"other-scans"}),
        (("02_clock_set_back_once/reset.bag",), SCANS, 45, {"sessions"}),
        (("02_clock_set_back_once/reset.bag", "--sequence", "2"), SCANS, 44, {"sessions", "not-calibrated"}),
        (("03_first_scans_stamped_zero/zero.bag",), SCANS, 53, {"unset-stamps", "not-calibrated"}),
        (("05_ground_truth_taken_for_odometry/gazebo.bag",), FINAL, 0.01, {"truth-left", "few-matched"}),
        (("08_bag_active_without_index/drive.bag.active",), SCANS, 83, {"damaged-bag"}),
        (("15_static_transform_corrected_later/again.bag",), FINAL, 0.02, {"mount-corrected"}),
        (("17_negative_time_increment/reversed.bag",), ONLINE, 0.01, set()),
        ((f"{HOKUYO}/hokuyo.log",), SCANS, 75, {"assumed-angles", "lidar-angles", "scans-unfit", "unlike"}),
        ((f"{HOKUYO}/hokuyo.log", "--platform", f"{HOKUYO}/fan.toml"), FINAL, 0.03, {"time-increment"}),
        (("23_odometry_without_usable_heading/w_missing.bag",), FINAL, 0.02, {"no-headings"}),
        (("25_odometry_with_zero_quaternions/arduino.bag",), SCANS, 67, {"no-headings"}),
        (("25_odometry_with_zero_quaternions/arduino.bag", "--streams", "lidar"), SCANS, 67, {"no-odometry"}),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, tuple) else None,
)
def test_a_case_is_replayed_to_what_is_right(
    cases: Path,
    tmp_path: Path,
    capsys: Capsys,
    words: tuple[str, ...],
    path: tuple[str, ...],
    most: float,
    codes: set[str],
) -> None:
    answer, told = found(capsys, cases, "replay", *words, "--out", tmp_path / "result", "--no-figures")
    assert told == codes
    assert value(answer, path) == most if path == SCANS else value(answer, path) < most


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
def test_a_floor_of_ones_own_is_driven(cases: Path, tmp_path: Path, capsys: Capsys) -> None:
    floor = cases / "31_floor_whose_corridor_is_shortened" / "flat.toml"
    printed(capsys, "simulate", floor, "--seed", 0, "--out", tmp_path / "drive")
    answer, _ = found(capsys, cases, "replay", tmp_path / "drive", "--out", tmp_path / "result", "--no-figures")
    assert value(answer, FINAL) < 0.01


@pytest.mark.parametrize(
    ("case", "scans", "codes"),
    [
        ("00_control/drive.bag", 83, set()),
        ("06_sqlite_wal/killed_0.db3", 50, {"damaged-bag"}),
        ("07_split_folder_without_metadata/drive", 78, {"no-metadata"}),
        ("09_index_length_of_old_rosbag/cturtle.bag", 83, set()),
        ("29_file_level_zstd/metadata.yaml", 83, set()),
    ],
)
def test_all_scans_of_a_case_are_read(cases: Path, capsys: Capsys, case: str, scans: int, codes: set[str]) -> None:
    whole = case.removesuffix("/metadata.yaml")
    answer, told = found(capsys, cases, "inspect", cases / whole)
    assert answer["streams"][0]["readings"] == scans
    assert told == codes


@pytest.mark.parametrize(
    ("words", "path", "right", "codes"),
    [
        (("10_tum_in_camera_axes/cam_est.tum", "10_tum_in_camera_axes/cam_ref.tum"), ATE, 0.632, {"in-space"}),
        (("11_csv_with_a_running_number/est.csv", "11_csv_with_a_running_number/ref.csv"), ATE, 0.3464, set()),
        *(
            ((f"{folder}/est.tum", f"{folder}/{name}.tum"), path, right, {"no-orientation"})
            for folder in ("13_reference_without_orientation",)
            for name in ("rtk", "rtk_identity")
            for path, right in ((ATE, 0.0285), (HEADING, None))
        ),
        *(
            ((*files, *offset), ATE, right, codes)
            for files in [[f"27_clock_offset_between_trajectories/{name}.tum" for name in ("est_2.5s_late", "ref")]]
            for offset, right, codes in (((), 1.884, {"clocks-differ"}), (("--time-offset", "-2.5"), 0.0, set()))
        ),
    ],
    ids=lambda words: " ".join(words) if isinstance(words, tuple) else None,
)
def test_a_case_is_scored_by_what_is_right(
    cases: Path,
    capsys: Capsys,
    words: tuple[str, ...],
    path: tuple[str, ...],
    right: float | None,
    codes: set[str],
) -> None:
    answer, told = found(capsys, cases, "evaluate", *words)
    assert codes <= told
    assert value(answer, path) == (None if right is None else pytest.approx(right, abs=1e-3))


@pytest.mark.parametrize(("name", "known", "told"), [("humble", 1.0, True), ("noetic", 0.9459, False)])
def test_a_map_whose_unknown_cells_count_as_free_is_told(
    cases: Path, capsys: Capsys, name: str, known: float, told: bool
) -> None:
    folder = cases / "19_map_saver_free_thresh_025"
    path, maps = folder / "path.tum", ("--map", folder / f"{name}.yaml", "--true-map", folder / "true.yaml")
    assert main.run([*map(str, ("evaluate", path, path, *maps, "--json"))]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["metrics"][str(path)]["map_known"]["value"] == pytest.approx(known, abs=1e-4)
    assert ("humble.yaml: grey 205" in err) == told


def test_lidars_without_a_place_are_refused_with_what_to_do(cases: Path, tmp_path: Path, capsys: Capsys) -> None:
    bag = cases / "26_two_lidars_without_tf" / "two_lidars.bag"
    line = refused(capsys, "replay", bag, "--topics", "lidar=/front_scan,/rear_scan", "--out", tmp_path / "result")
    assert "two_lidars.bag: /front_scan, /rear_scan" in line
    assert '[lidars."/front_scan"]' in line
