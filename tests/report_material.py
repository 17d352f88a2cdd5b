"""Sweeps as if they had been made, and names that nobody means well with, for tests of the report."""

from pathlib import Path

from made_sweeps import Values, recorded

from moteslam.eval.sweep.plan import PlannedRun

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


def sweep(path: Path, *, fail: int = 0) -> Path:
    """A file of a sweep as if it had been made, but for the last two runs: the error falls with the particles."""
    made: list[PlannedRun] = []

    def result(run: PlannedRun) -> Values | str | None:
        made.append(run)
        ate = 0.2 / float(dict(run.varied)["slam.particles"]) + 0.001 * run.seed
        values: Values = {"final.ate": (ate, "m"), "map_f1": HOSTILE}
        return None if len(made) > 58 else HOSTILE if len(made) <= fail else values

    return recorded(path, SPEC, result, digest="", environment={"versions": {"numpy": HOSTILE}})
