"""Files of trajectories: the format is known by the content when read, by the ending when written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from trajectory_cases import made

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot.trajectories import TRAJECTORY_FORMATS, read_trajectory, write_trajectory


@pytest.mark.parametrize("ending", ["tum", "kitti", "csv", "g2o"])
@pytest.mark.parametrize("n", [1, 20])
def test_it_is_known_by_its_content(tmp_path: Path, ending: str, n: int) -> None:
    trajectory = made(n)
    write_trajectory(tmp_path / f"t.{ending}", trajectory)
    (tmp_path / f"t.{ending}").rename(tmp_path / "t.txt")
    found = read_trajectory(tmp_path / "t.txt")
    np.testing.assert_array_equal(found.stamps, trajectory.stamps)
    np.testing.assert_allclose(found.poses, trajectory.poses, atol=1e-15)


@pytest.mark.parametrize("name", sorted(TRAJECTORY_FORMATS))
def test_each_format_recognises_its_own_alone(tmp_path: Path, name: str) -> None:
    write_trajectory(tmp_path / "t", made(3), name)
    lines = (tmp_path / "t").read_text().splitlines(keepends=True)
    comments = "".join(line for line in lines if line.startswith("#"))
    first = next(line for line in lines if not line.startswith("#"))
    assert next(key for key, known in TRAJECTORY_FORMATS.items() if known.recognise(comments, first)) == name


@pytest.mark.parametrize(
    ("text", "stamps", "heading"),
    [
        ("1,0,0,0,0,0,0,1\n2,0,0,0,0,0,0,1\n", [1, 2], 0.0),  # TUM with commas: the last is qw
        ("#timestamp [ns],x\n1,0,0,0,0,0,0,1\n", [1e-9], np.pi),  # EuRoC by its header: the last is qz
        ("1403636580838555648,0,0,0,0,0,0,1,0,0,0\n", [1403636580.838555648], np.pi),  # and by its columns
        ("1403636580838555648,0,0,0,0.6,0,0,0.8\n", [1403636580.838555648], 2 * np.arctan2(0.8, 0.6)),  # or stamps
        ("1403636580838555648,0,0,0,0,0,0.6,0.8\n", [1403636580.838555648], 2 * np.arctan2(0.6, 0.8)),  # upright so
    ],
)
def test_commas_alone_do_not_make_it_euroc(tmp_path: Path, text: str, stamps: list[float], heading: float) -> None:
    (tmp_path / "t").write_text(text)
    found = read_trajectory(tmp_path / "t")
    assert found.stamps.tolist() == stamps
    assert found.poses[0, 2] == pytest.approx(heading)


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"# only\n\n", None),
        (b"# one\n\n1 2 3\n", 3),
        (b"\xff\xfe\x00", 1),
        (b"1 0 0 0 0 0 0 1\n2 \xff\n", None),
        (None, None),
    ],
)
def test_what_is_none_is_refused(tmp_path: Path, content: bytes | None, line: int | None) -> None:
    if content is not None:
        (tmp_path / "t").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_trajectory(tmp_path / "t")
    assert (caught.value.file, caught.value.line) == (str(tmp_path / "t"), line)


def test_names_and_formats_that_are_none_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        write_trajectory(tmp_path / "t.txt", made())
    with pytest.raises(ConfigError) as caught:
        write_trajectory(tmp_path / "t.txt", made(), "bag")
    assert caught.value.field == "file_format"
