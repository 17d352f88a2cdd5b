"""The picture of a coloured floor, and a whole run from a simulated camera to the result folder."""

from __future__ import annotations

import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from moteslam.eval.cli.main import run as main
from moteslam.eval.report.maps import with_opacity
from moteslam.eval.results import write_map_files
from moteslam.robot.raster import Raster, read_map_arrays
from moteslam.slam.texture.floor_map import TextureMap

SCENARIO = """
duration = 12.0
[world]
rooms = [{ corner = [0.0, 0.0], size = [9.0, 7.0] }]
[[world.boxes]]
centre = [6.0, 2.0]
size = [0.8, 0.6]
[commands]
start = [2.0, 2.0, 0.3]
steps = [{ duration = 6.5, speed = 0.6, turn_rate = 0.35 }]
[drive]
rest_start = 0.5
rest_end = 0.5
[camera]
rate = 5.0
gap = 0.0
"""


def test_the_picture_has_the_largest_y_on_top(tmp_path: Path) -> None:
    colours = np.zeros((3, 2, 3), np.uint8)
    colours[0, 0], colours[2, 1] = (255, 0, 0), (0, 0, 255)
    points = np.array([[5, 0], [0, 0], [0, 1]])
    texture = TextureMap(values=colours, cell_size=0.5, origin=(-1.0, 2.5, 0.0), points=points, frames=7)
    colours = with_opacity(texture)
    assert colours[0, 0].tolist() == [255, 0, 0, 255]
    assert colours[2, 1].tolist() == [0, 0, 255, 255]
    assert (colours[..., 3] > 0).sum() == 2
    write_map_files(tmp_path, Raster(np.ones((1, 1), np.float32), 0.5, (0.0, 0.0, 0.0)), texture)
    file = cv2.imread(str(tmp_path / "texture.png"), cv2.IMREAD_UNCHANGED)
    assert file[2, 0].tolist() == [0, 0, 255, 255]
    assert "origin: [-1.0, 2.5, 0.0]" in (tmp_path / "texture.yaml").read_text()


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
def test_from_a_simulated_camera_to_the_result_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "s.toml").write_text(SCENARIO)
    out, result = tmp_path / "recording", tmp_path / "result"
    assert main(["simulate", str(tmp_path / "s.toml"), "--out", str(out), "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["readings"]["rgb"] > 25
    assert re.search(r" images of about [1-9][0-9.]* MB are to be written", said.err)
    (out / "dataRGBD" / "RGB20" / "rgb20_7.png").write_bytes(b"broken")
    few = ["replay", str(out), "--set", "particles=5"]
    assert main([*few, "--out", str(result), "--set", "texture.largest_gap=0.11"]) == 0
    said = capsys.readouterr()
    assert "camera: 1 frame left out, unreadable; the first: " in said.err
    assert "Traceback" not in said.err
    picture = cv2.imread(str(result / "texture.png"), cv2.IMREAD_UNCHANGED)
    floor = {name: read_map_arrays(result / "texture.npz", name).values for name in ("points", "colours")}
    np.testing.assert_array_equal(picture[::-1, :, 3] > 0, floor["points"] > 0)
    known = floor["points"] > 0
    np.testing.assert_array_equal(picture[::-1, :, 2::-1][known], floor["colours"][known])
    assert (picture[..., 3] == 255).sum() > 3000
    assert cv2.imread(str(result / "texture_over_time.png")).shape[1] > 1000
    without = tmp_path / "without"
    assert main([*few, "--out", str(without), "--set", "texture.enabled=false", "--no-figures"]) == 0
    assert not (without / "texture.png").exists()
    capsys.readouterr()
    monkeypatch.setattr("moteslam.slam.texture.floor_map.MAX_CELLS", 10)
    assert main([*few, "--out", str(tmp_path / "large"), "--no-figures"]) == 0
    assert "warning: the floor is not coloured: texture.cell_size: " in capsys.readouterr().err
    assert (tmp_path / "large" / "map.png").exists()
