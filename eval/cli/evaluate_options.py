"""Which options of ``moteslam evaluate`` mean something with what is given, and which are refused."""

from __future__ import annotations

from pathlib import Path

import typer

NEEDED = {
    **dict.fromkeys(("sequence", "platform"), "a recording"),
    **dict.fromkeys(("plot", "max_difference", "time_offset"), "a reference"),
    **dict.fromkeys(("no_align", "scale"), "a reference trajectory or positions"),
    **dict.fromkeys(("delta", "unit", "all_pairs", "loops"), "a reference trajectory"),
    "no_interpolate": "a .relations reference",
    "map_file": "a reference trajectory",
    "true_map": "a --map",
}
"""What an option is about: without it the option would change nothing, and is refused."""


def refuse_options(context: typer.Context, paths: list[Path], recording: Path | None, map_file: Path | None) -> None:
    """Refuse what does not go together.

    Raises:
        BadParameter: it is named, with what it needs.
    """
    if len(paths) < 2 and recording is None:
        raise typer.BadParameter(
            "one file, expected trajectories and, last, their reference, or a --recording", param_hint="'EST... [REF]'"
        )
    if map_file is not None and not (_is_given(context, "true_map") or _is_given(context, "metrics")):
        raise typer.BadParameter("given without --true-map, expected the map to compare it with", param_hint="'--map'")
    if map_file is not None and len(paths) > 2:
        raise typer.BadParameter("given with several EST, expected the one whose map it is", param_hint="'--map'")
    there = set() if recording is None else {"a recording"}
    there |= set() if map_file is None else {"a --map"}
    if len(paths) > 1:
        there |= {"a reference", *_kinds(paths[-1])}
    given = {name for name in NEEDED if _is_given(context, name)}
    for name, needed in NEEDED.items():
        if name in given and needed not in there:
            own = {"a recording": "a --recording", "a --map": "the map that it is compared with"}
            expected = own.get(needed, "one as the last file")
            raise typer.BadParameter(f"given without {needed}, expected {expected}", param_hint=_hint(name))
    if given.issuperset(("scale", "no_align")):
        raise typer.BadParameter("given with --no-align, expected one of the two", param_hint=_hint("scale"))


def _kinds(reference: Path) -> tuple[str, ...]:
    """What a reference is, in the words of ``NEEDED``."""
    from moteslam.eval.metrics.relations import is_relations
    from moteslam.robot.trajectories.rows import is_positions

    if is_relations(reference):
        return ("a .relations reference",)
    trajectory = () if is_positions(reference) else ("a reference trajectory",)
    return ("a reference trajectory or positions", *trajectory)


def _is_given(context: typer.Context, name: str) -> bool:
    """Whether an option stands on the command line, be it with the value that it has by default."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _hint(name: str) -> str:
    return f"'--{name.removesuffix('_file').replace('_', '-')}'"
