"""The map of a real log without the back end and with it, side by side at one scale.

python benchmarks/picture.py docs/images/back_end_aces.png
"""

from __future__ import annotations

import argparse

from parts.harness import result_file
from parts.runs import FILTER_ALONE, LOGS, load_log

from moteslam.errors import MoteslamError
from moteslam.eval.report import style
from moteslam.eval.report.maps import draw_map, map_corners
from moteslam.slam.run import run_slam
from moteslam.slam.settings import resolve_config


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=result_file, metavar="FILE.png")
    parser.add_argument("--log", choices=LOGS, default="aces")
    options = parser.parse_args()
    try:
        recording = load_log(options.log).recording
    except MoteslamError as error:
        parser.error(str(error))
    estimates = {
        "without back end": run_slam(recording, resolve_config("default", FILTER_ALONE)),
        "with back end": run_slam(recording, resolve_config("default")),
    }
    title = f"{recording.name}: map and final path"
    with style.saved_figure(options.out, size=(12.0, 6.0), title=title) as figure:
        panels = figure.subplots(1, 2, sharex=True, sharey=True)
        for axes, (title, estimate) in zip(panels, estimates.items(), strict=True):
            poses = estimate.trajectory_final.poses
            draw_map(axes, estimate.map)
            axes.plot(*poses[:, :2].T, color=style.SLAM, lw=0.7, label=style.FINAL)
            style.mark_start(axes, poses)
            style.mark_ends(axes, (poses, style.SLAM))
            style.plan(axes)
            axes.set_title(title, fontsize="medium")
        style.show_everything(panels[0], *(map_corners(estimate.map) for estimate in estimates.values()), margin=0.5)


if __name__ == "__main__":
    main()
