"""The file of a sweep as the commands need it: begun, and what specification it holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from moteslam.errors import ConfigError, OutputError

if TYPE_CHECKING:
    from moteslam.eval.sweep.spec import SweepSpec
    from moteslam.eval.sweep.store import Store

WHOLE = "1/1"
"""The part that a sweep without ``--shard`` makes."""


def begin(target: Path, file: Path, spec: SweepSpec, part: str | None) -> None:
    """Make the file of a sweep, unless it is there already.

    Args:
        target: the file.
        file: of the specification.
        spec: that it holds.
        part: of the sweep, as ``2/8``; None for the whole one.

    Raises:
        ConfigError: the specification asks for what there is not, or the part is none.
        OutputError: the file is there, of another specification or part, or of other scenarios or robots.
    """
    from moteslam.eval.results import environment
    from moteslam.eval.sweep.bundled import digest
    from moteslam.eval.sweep.plan import plan
    from moteslam.eval.sweep.plan import shard as shard_of
    from moteslam.eval.sweep.store import create, opened

    text, part = spec.model_dump_json(exclude_defaults=True, exclude={"description"}), part or WHOLE
    number, of = _numbers(part)
    if target.exists():
        with opened(target) as store:
            if store.spec != text:
                raise OutputError("is of another specification, expected another --out", file=target)
            if store.part != part:
                raise OutputError(f"holds part {store.part}, not {part}, expected another --out", file=target)
            if store.digest and store.digest != digest(plan(spec, check=False)):
                problem = "has runs of other scenarios or robots of these names, expected another --out"
                raise OutputError(problem, file=target)
        return
    try:
        runs = plan(spec)
    except ConfigError as error:
        raise ConfigError(error.problem, file=error.file or file, field=error.field) from error
    create(target, text, shard_of(runs, number, of), part=part, digest=digest(runs), environment=environment())


def _numbers(text: str) -> tuple[int, int]:
    first, slash, second = text.partition("/")
    if slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise ConfigError(f"{text!r}, expected a part and how many there are, such as 2/8", field="--shard")


def spec_of(store: Store) -> SweepSpec:
    """The specification in the file of a sweep."""
    from moteslam.eval.sweep.spec import SweepSpec

    return SweepSpec.model_validate_json(store.spec)
