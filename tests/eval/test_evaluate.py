"""``moteslam evaluate``: one trajectory or several, short ones, relations between poses, results kept and drawn."""

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_lines import Capsys, printed, refused, shown, told
from matplotlib.figure import Figure

from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN, write_map
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import compose, inverse
from moteslam.robot.trajectories.text import read_tum, write_tum
from moteslam.robot.trajectory import Trajectory


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three estimates of a drive of 10 m, and one of the first half metre; the working folder."""
    stamps = np.arange(0.0, 10.0, 0.1)
    truth = np.stack((stamps, np.sin(stamps), np.arctan(np.cos(stamps))), axis=-1)
    for name, noise in (("good", 0.01), ("poor", 0.1), ("$worst_$", 0.3)):
        poses = truth + np.random.default_rng(1).normal(0, noise, truth.shape) * (1, 1, 0.1)
        write_tum(tmp_path / f"{name}.tum", Trajectory(stamps, poses))
    write_tum(tmp_path / "truth.tum", Trajectory(stamps, truth))
    write_tum(tmp_path / "short.tum", Trajectory(stamps[:6], truth[:6] + np.array((0.0, 0.0, 0.01))))
    (tmp_path / "some.relations").write_text(
        "1 2 1 0 0 0 0 0\n1.05 2.05 1 0 0 0 0 0\n5 90 1 0 0 0 0 0\n", encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(capsys: Capsys, *arguments: str) -> str:
    return printed(capsys, "evaluate", *arguments)


def test_several_are_printed_side_by_side(folder: Path, capsys: Capsys) -> None:
    lines = said(capsys, "good.tum", "poor.tum", "$worst_$.tum", "truth.tum").splitlines()
    assert [line.split()[0] for line in lines[2:]] == ["good.tum", "poor.tum", "$worst_$.tum"]
    errors = [float(line.split()[2]) for line in lines[2:]]
    assert errors == sorted(errors)
    assert "ATE RMSE [cm]  median [cm]  max [cm]" in lines[1]  # of the second, though the worst is metres off
    assert 1 < errors[0] < 2
    rows = shown(capsys, "evaluate", "good.tum", "poor.tum", "truth.tum")
    assert [row["estimate"] for row in rows["results"]] == ["good.tum", "poor.tum"]
    assert rows["results"][0]["ate"]["translation_m"]["rmse"] == pytest.approx(0.01 * errors[0], abs=1e-4)


@pytest.mark.parametrize("reference", ["truth.tum", "some.relations"])
def test_metrics_and_relations_of_several_are_side_by_side_too(folder: Path, capsys: Capsys, reference: str) -> None:
    both = "good.tum", "poor.tum", reference, "--metric", "rpe_2m", "--metric", "relations"
    head, *lines = said(capsys, *both, "--format", "csv").splitlines()
    if reference == "truth.tum":
        assert head.endswith("final RPE over 2 m [cm],final error of relations")
        assert [line.split(",")[0] for line in lines] == ["good.tum", "poor.tum"]
        assert [line.split(",")[-1] for line in lines] == ["-", "-"]
        assert "poor.tum: final error of relations: no relations" in said(capsys, *both)
    else:
        assert head == "relations,estimate,count,translation [cm],rotation [deg]"
        names = [line.split(",")[:2] for line in lines[:6]]
        assert names == [[kind, name] for kind in ("clear", "at stamps", "all used") for name in both[:2]]
        assert [line.split(",")[0] for line in lines[6:]] == ["estimate", *both[:2]]


def test_relations_say_how_many_were_used(folder: Path, capsys: Capsys) -> None:
    line = "2 of 3 relations used, 1 of them between poses"
    assert said(capsys, "good.tum", "some.relations").splitlines()[-1] == line
    found = shown(capsys, "evaluate", "good.tum", "some.relations")
    assert (found["used"], found["interpolated"], found["total"]) == (2, 1, 3)
    table = said(capsys, "good.tum", "some.relations", "--format", "latex")
    assert table.startswith("% good.tum against some.relations")
    assert r" $\pm$ " in table
    assert "\n\n| relations |" in said(capsys, "good.tum", "some.relations", "--format", "markdown")


@pytest.mark.parametrize(
    ("line", "codes"),
    [("1 2 {0} {1}", []), ("2 1 {0} {1}", ["relations-inverted"]), ("1 2 {1} {0}", ["relations-inverted"])],
)
def test_relations_the_other_way_round_are_told(folder: Path, capsys: Capsys, line: str, codes: list[str]) -> None:
    truth = read_tum("truth.tum").poses
    x, y, yaw = se2.between(truth[10], truth[20])
    Path("one.relations").write_text(f"{line.format(x, y)} 0 0 0 {yaw}\n", encoding="utf-8")
    found = shown(capsys, "evaluate", "good.tum", "one.relations")
    assert [issue["code"] for issue in found["warnings"]] == codes


AHEAD, PLACE, ANGLE = np.array(((0.5, 0, 0), (1, 1, 0), (0, 0, 1)))


@pytest.mark.parametrize(
    ("change", "late", "codes"),
    [
        (lambda poses, begins: poses, 0.0, []),
        (lambda poses, begins: poses, 0.3, ["clocks-differ"]),
        (lambda poses, begins: poses * (100, 100, 1), 0.0, ["sizes-differ"]),
        (lambda poses, begins: poses * (1, -1, 1), 0.0, ["relations-inverted"]),
        (lambda poses, begins: poses * (1, 1, -1), 0.0, ["relations-inverted"]),
        (lambda poses, begins: se2.between(AHEAD, se2.compose(poses, AHEAD)), 0.0, ["lever-arm"]),
        (lambda poses, begins: se2.compose(begins * ANGLE, poses) - begins * ANGLE, 0.0, ["relations-inverted"]),
        (lambda poses, begins: se2.compose(begins, poses), 0.0, ["relations-inverted"]),
        (lambda poses, begins: se2.between(poses * ANGLE, poses * PLACE) + poses * ANGLE, 0.0, ["relations-inverted"]),
        (lambda poses, begins: se2.between((0, 0, 1.5), poses * PLACE) + poses * ANGLE, 0.0, ["body-axes"]),
        (lambda poses, begins: np.random.default_rng(1).normal(size=poses.shape), 0.0, ["unlike"]),
        (lambda poses, begins: poses, (0.0, 0.3), ["clocks-differ"]),
    ],
    ids=["sound", "late", "cm", "y", "angle", "arm", "world", "map", "end", "axes", "others", "t2 late"],
)
def test_relations_in_another_form_are_told(
    folder: Path, capsys: Capsys, change, late: float | tuple[float, float], codes: list[str]
) -> None:
    truth = read_tum("truth.tum")
    first, last = (
        np.column_stack((truth.stamps, truth.poses))[some] for some in (slice(0, -10, 4), slice(10, None, 4))
    )
    poses = change(se2.between(first[:, 1:], last[:, 1:]), first[:, 1:])
    stamps = np.column_stack((first[:, 0], last[:, 0])) + late
    rows = np.column_stack((stamps, poses[:, :2], np.zeros((len(poses), 3)), poses[:, 2]))[:-2]
    np.savetxt("some.relations", rows, fmt="%.6f")
    write_tum(
        "fine.tum", Trajectory(truth.stamps, truth.poses + 0.001 * np.random.default_rng(0).normal(size=(100, 3)))
    )
    found = shown(capsys, "evaluate", "fine.tum", "some.relations")
    assert [issue["code"] for issue in found["warnings"]] == codes
    if codes == ["sizes-differ"]:
        mend = "multiply the reference's positions by 0.01 (cm as m): relations are missed by "
        assert re.fullmatch(rf"{re.escape(mend)}\S+ mm in place of \S+ m", found["warnings"][0]["message"])


@pytest.mark.parametrize(
    ("factor", "apart", "words"),
    [(1.0, 10, ""), (180 / np.pi, 1, "relations with angles in degrees are missed"), (0.0, 10, "where places agree")],
)
def test_angles_of_relations_that_places_contradict(
    folder: Path, capsys: Capsys, factor: float, apart: int, words: str
) -> None:
    """Of the first second, also in degrees below 6.3, or of the whole drive."""
    truth = read_tum("truth.tum").poses
    moved = se2.between(truth[:-apart], truth[apart:]) * (1, 1, factor)
    rows = [
        f"{k / 10} {(k + apart) / 10} {x} {y} 0 0 0 {turn}\n" for k, (x, y, turn) in enumerate(moved) if abs(turn) < 6.3
    ]
    Path("some.relations").write_text("".join(rows))
    write_tum(
        "fine.tum", Trajectory(np.arange(100) / 10, truth + 1e-4 * np.random.default_rng(0).normal(size=(100, 3)))
    )
    found = [issue["message"] for issue in shown(capsys, "evaluate", "fine.tum", "some.relations")["warnings"]]
    assert len(found) == bool(words)
    assert all(words in message for message in found)


@pytest.mark.parametrize("angles", ["0 3 0 0.1", "0 0 0.1 0"])
def test_relations_whose_yaw_is_not_last_are_refused(folder: Path, capsys: Capsys, angles: str) -> None:
    Path("some.relations").write_text(f"1 2 1 0 {angles}\n")
    assert "x y z roll pitch yaw" in refused(capsys, "evaluate", "good.tum", "some.relations")


@pytest.mark.parametrize("reference", ["truth.tum", "some.relations"])
def test_results_are_kept_and_drawn(folder: Path, capsys: Capsys, reference: str) -> None:
    files = ("--save", "new/result.json", "--plot", "new/errors.png")
    said(capsys, "good.tum", "$worst_$.tum", reference, *files)
    rows = json.loads((folder / "new/result.json").read_text(encoding="utf-8"))["results"]
    assert [row["estimate"] for row in rows] == ["good.tum", "$worst_$.tum"]
    for row in rows:
        errors = np.array(row["errors"]["translation_m"])
        assert len(errors) == len(row["errors"]["stamps"]) == (100 if reference == "truth.tum" else 2)
        mean = row["ate" if reference == "truth.tum" else "all"]["translation_m"]["mean"]
        assert errors.mean() == pytest.approx(mean)
    picture = cv2.imread(str(folder / "new/errors.png"))
    assert picture.shape[1] > 1000
    assert "new/result.json: exists already" in refused(capsys, "evaluate", "good.tum", reference, *files)
    said(capsys, "good.tum", reference, *files, "--force")
    assert len(json.loads((folder / "new/result.json").read_text(encoding="utf-8"))["results"]) == 1


def test_the_scale_is_fitted_where_it_is_asked_for(folder: Path, capsys: Capsys, drawn: list[Figure]) -> None:
    truth = read_tum("truth.tum")
    write_tum("large.tum", Trajectory(truth.stamps, truth.poses * (1.1, 1.1, 1.0)))
    assert "scaled by 0.9091" in said(capsys, "large.tum", "truth.tum", "--scale")
    found = shown(capsys, "evaluate", "large.tum", "truth.tum", "--scale", "--plot", "scaled.png")
    assert (found["scaled"], found["ate"]["scale"]) == (True, pytest.approx(1 / 1.1))
    assert found["ate"]["translation_m"]["rmse"] < 1e-6
    assert shown(capsys, "evaluate", "large.tum", "truth.tum", "--plot", "rigid.png")["scaled"] is False
    scaled, rigid = ([text.get_text() for text in figure.legends[0].texts] for figure in drawn)
    assert "large, scale fitted, ATE RMSE 0 mm" in scaled
    assert not any("scale" in label for label in rigid)


def test_the_nearest_stamps_and_another_point_of_the_robot(folder: Path, capsys: Capsys) -> None:
    truth = read_tum("truth.tum")
    on_lidar = Trajectory(truth.stamps, compose(truth.poses, np.array((0.3, -0.1, 0.5))))
    write_tum("lidar.tum", on_lidar)
    back = inverse(np.array((0.3, -0.1, 0.5)))
    assert re.search(r"\(--est-offset -0\.2\d+ 0\.2\d+ 0\)", told(capsys, "evaluate", "lidar.tum", "truth.tum"))
    millimetres = (str(round(1000 * each)) for each in back)
    assert "--est-offset: " in refused(capsys, "evaluate", "lidar.tum", "truth.tum", "--est-offset", *millimetres)
    found = shown(capsys, "evaluate", "lidar.tum", "truth.tum", "--est-offset", *map(str, back))
    assert found["ate"]["translation_m"]["rmse"] < 1e-8
    assert found["ate"]["rotation_deg"]["max"] < 1e-5
    half = Trajectory(truth.stamps[::2] + 0.004, truth.poses[::2])
    write_tum("late.tum", half)
    between, nearest = (
        shown(capsys, "evaluate", "late.tum", "truth.tum", "--no-align", *more) for more in ([], ["--nearest"])
    )
    assert nearest["ate"]["translation_m"]["max"] < 1e-9 < between["ate"]["translation_m"]["max"]
    assert "nearest stamps" in said(capsys, "late.tum", "truth.tum", "--nearest")
    assert said(capsys, "lidar.tum", "truth.tum", "--format", "latex").splitlines()[3] == r"\toprule"


def a_room(shift: float = 0.0) -> Raster:
    """Walls round a free floor, unknown beyond, over the drive."""
    values = np.full((120, 320), UNKNOWN, np.int8)
    values[10:110, 10:310] = FREE
    for edge in (values[10:12, 10:310], values[108:110, 10:310], values[10:110, 10:12], values[10:110, 308:310]):
        edge[:] = OCCUPIED
    return Raster(values, 0.05, (-3.0 + shift, -3.0, 0.0))


def test_the_map_of_any_slam_is_scored_by_the_true_one(folder: Path, capsys: Capsys) -> None:
    write_map("true.pgm", a_room())
    write_map("mine.pgm", a_room())
    write_map("off.pgm", a_room(0.3))
    maps = ("--true-map", "true.yaml", "--map")
    right, off = (
        shown(capsys, "evaluate", "truth.tum", "truth.tum", *maps, name)["metrics"]["truth.tum"]
        for name in ("mine.yaml", "off.yaml")
    )
    assert right["map_f1"]["value"] > 0.99  # a motion of 1e-17 moves a point on a cell's edge into the next cell
    assert right["map_distance"] == {"value": pytest.approx(0.0, abs=0.025), "unit": "m"}
    assert off["map_f1"]["value"] < 0.9
    lines = said(capsys, "truth.tum", "truth.tum", *maps, "mine.yaml", "--metric", "rpe_2m", "--metric", "nees")
    assert "IoU of free space" in lines
    assert "recall, F1 and distance count walls, too, that the robot never saw" in lines
    assert re.search("NEES +- no covariances", lines)
    assert "final RPE over 2 m" in lines


@pytest.mark.parametrize(
    ("change", "by", "said"),
    [
        ("negate: 0", "negate: 1", "wrong.yaml: of the path 100 % in its walls"),
        ("resolution: 0.05", "resolution: 0.025", "wrong.yaml: of the path "),
        (
            "origin: [-3.0, -3.0, 0.0]",
            "origin: [0.0, -9.0, 0.0]",
            "wrong.yaml: of the path 0 % in its walls, 0 % where",
        ),
        ("mode: trinary", "mode: raw", "100 % where it is unknown"),
        ("origin: [-3.0, -3.0, 0.0]", "origin: [-3.5, -3.5, 0.0]", "% of the walls of wrong.yaml are at its walls"),
        ("", "", ""),
    ],
)
@pytest.mark.parametrize("which", ["map", "true-map"])
def test_a_map_that_is_not_where_the_path_is(
    folder: Path, capsys: Capsys, which: str, change: str, by: str, said: str
) -> None:
    write_map("true.pgm", a_room())
    Path("wrong.yaml").write_text(Path("true.yaml").read_text().replace(change, by))
    maps = ("--map", "wrong.yaml", "--true-map", "true.yaml")
    if which == "true-map":
        maps, said = ("--map", "true.yaml", "--true-map", "wrong.yaml"), said.replace("wrong.yaml are", "true.yaml are")
    err = told(capsys, "evaluate", "good.tum", "truth.tum", *maps)
    assert said in err
    assert (err == "") == (said == "")


@pytest.mark.parametrize("unseen", [slice(0), slice(100, None)])
def test_solid_blocks_and_a_map_of_more_than_was_seen_are_no_other_building(
    folder: Path, capsys: Capsys, unseen: slice
) -> None:
    """The true map scored by itself, and by what is known of it in a part."""
    true = a_room()
    for left in range(20, 300, 40):
        true.values[80:105, left : left + 30] = true.values[14:40, left : left + 30] = OCCUPIED
    write_map("all.pgm", true)
    true.values[80:, unseen] = true.values[:40, unseen] = UNKNOWN
    write_map("true.pgm", true)
    assert told(capsys, "evaluate", "good.tum", "truth.tum", "--map", "all.yaml", "--true-map", "true.yaml") == ""
