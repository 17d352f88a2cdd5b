"""Sweeps as if they had been made, and names that nobody means well with, for tests of the report."""

from __future__ import annotations

from pathlib import Path

from moteslam.eval.page.material import ReportRun
from moteslam.eval.sweep.plan import plan
from moteslam.eval.sweep.spec import read_spec
from moteslam.eval.sweep.store import create, opened
from moteslam.eval.sweep.workers import Outcome

HOSTILE = "</script><script>document.title='x'</script><img src=x onerror=alert(1)> \"'& \u202egpj \x1b[31m"
SPEC = """
scenarios = ["corridor", "office"]
seeds = "0-4"
metrics = ["final.ate", "map_f1"]
[configurations.default]
[configurations.paper]
preset = "paper"
[vary]
slam.particles = [1, 10, 100]
"""


def run_of(configuration: str = "a", seed: int = 0, status: str = "ok", **more) -> ReportRun:
    fields = {
        **{"place": "corridor", "platform": "", "noise": "", "seed": seed, "duration": None},
        **{"configuration": configuration, "varied": (), "base": configuration, "status": status, "error": ""},
        **{"values": {"final.ate": 0.1 + seed}, "absent": {}, "succeeded": status == "ok"},
    }
    return ReportRun(**(fields | more))


def sweep(path: Path, *, fail: int = 0) -> Path:
    """A file of a sweep as if it had been made: the error falls with the particles."""
    spec = path.with_suffix(".toml")
    spec.write_text(SPEC)
    read = read_spec(spec)
    runs = plan(read)
    create(path, read.model_dump_json(exclude_defaults=True), runs, environment={"versions": {"numpy": HOSTILE}})
    with opened(path, write=True) as store:
        for number, run in enumerate(runs[:-2]):
            ate = 0.2 / dict(run.varied)["slam.particles"] + 0.001 * run.seed
            values = {"final.ate": {"value": ate, "unit": "m"}, "map_f1": {"absent": HOSTILE}}
            bad = number < fail
            outcome = Outcome(run, "failed", HOSTILE, {}) if bad else Outcome(run, "ok", "", {"values": values})
            store.record(outcome)
    return path
