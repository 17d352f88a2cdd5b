"""A sweep without runs: results that are made up, in a file as a sweep writes it."""

from __future__ import annotations

from pathlib import Path

from moteslam.eval.sweep.plan import plan
from moteslam.eval.sweep.spec import read_spec
from moteslam.eval.sweep.store import create, opened
from moteslam.eval.sweep.workers import Outcome

SPEC = """
scenarios = ["corridor"]
seeds = "0-3"
[configurations.plain]
[configurations.a_b]
set = { slam.particles = 50 }
[vary]
slam.tracking.window = [1.0, 2.0]
"""


def swept(folder: Path, *, whole: bool = True) -> Path:
    """Errors of 0.1 and 0.2 m; of the second configuration three of four runs at the second value failed."""
    (folder / "a.toml").write_text(SPEC, encoding="utf-8")
    spec = read_spec(folder / "a.toml")
    runs = plan(spec)
    create(folder / "a.sweep", spec.model_dump_json(exclude_defaults=True), runs, digest="ab")
    with opened(folder / "a.sweep", write=True) as store:
        for run in runs if whole else runs[:3]:
            error = 0.1 * float(dict(run.varied)["slam.tracking.window"]) + 0.01 * run.seed
            if run.configuration == "a_b" and error > 0.2:
                store.record(Outcome(run, "failed", "stuck"))
            else:
                store.record(Outcome(run, "ok", result={"values": {"final.ate": {"value": error, "unit": "m"}}}))
    return folder / "a.sweep"
