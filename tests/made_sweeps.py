"""Sweeps without runs: results that are made up, in files as a sweep writes them."""

from collections.abc import Callable
from pathlib import Path

from moteslam.eval.sweep.plan import PlannedRun, plan
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
Values = dict[str, tuple[float, str] | str]
"""Number and unit of each metric, or why it is absent."""


def recorded(
    file: Path, text: str, result: Callable[[PlannedRun], Values | str | None], *, digest: str = "ab", **more: object
) -> Path:
    """The file of a sweep in which each run has these values, failed with this error, or was not made yet."""
    spec = file.with_suffix(".toml")
    spec.write_text(text, encoding="utf-8")
    read = read_spec(spec)
    runs = plan(read)
    create(file, read.model_dump_json(exclude_defaults=True), runs, digest=digest, **more)  # type: ignore[arg-type]
    with opened(file, write=True) as store:
        for run in runs:
            found = result(run)
            if isinstance(found, str):
                store.record(Outcome(run, "failed", found))
            elif found is not None:
                values = {
                    name: {"absent": one} if isinstance(one, str) else {"value": one[0], "unit": one[1]}
                    for name, one in found.items()
                }
                store.record(Outcome(run, "ok", result={"values": values}))
    return file


def swept(folder: Path, *, whole: bool = True) -> Path:
    """Errors of 0.1 and 0.2 m; of the second configuration three of four runs at the second value failed."""
    made: list[PlannedRun] = []

    def result(run: PlannedRun) -> Values | str | None:
        made.append(run)
        if not whole and len(made) > 3:
            return None
        error = 0.1 * float(dict(run.varied)["slam.tracking.window"]) + 0.01 * run.seed
        return "stuck" if run.configuration == "a_b" and error > 0.2 else {"final.ate": (error, "m")}

    return recorded(folder / "a.sweep", SPEC, result)
