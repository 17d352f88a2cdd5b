"""``moteslam report``: sweeps and result folders as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from moteslam.errors import OutputError
from moteslam.eval.cli import options
from moteslam.eval.cli.text import say, say_json
from moteslam.eval.literal import literal


def report(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH...",
            help="Files of sweeps, result folders, and folders with either in them.",
            show_default=False,
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="The page; it must not exist.")] = Path("report.html"),
    title: Annotated[str | None, typer.Option(metavar="TEXT", help="Of the page [the first path's name].")] = None,
    metrics: Annotated[
        list[str] | None,
        typer.Option("--metric", metavar="NAME", help="Which metrics [those of the sweeps, or the usual]; repeatable."),
    ] = None,
    baseline: Annotated[
        str | None, typer.Option(metavar="NAME", help="Compare with this configuration [the first].")
    ] = None,
    no_player: Annotated[bool, typer.Option("--no-player", help="Leave the player of runs out.")] = False,
    force: options.ForceOut = False,
    as_json: options.Json = False,
) -> None:
    """Make one HTML page of sweeps and result folders: tables, charts, and a player of the runs.

    It holds all that it shows and needs no network: open it in a browser, send it, print it. Runs of result folders can
    be played; a sweep keeps the figures of its runs alone.

    \b
    Examples:
      moteslam report particles.sweep --out particles.html
      moteslam report result
      moteslam report before after --metric final.ate --metric map_f1 --title "before and after"
    """  # noqa: D301
    if out.suffix.lower() not in (".html", ".htm"):
        raise OutputError("expected a name that ends in .html", file=out)
    options.refuse_existing(out, force=force)
    from moteslam.eval.cli.progress import progress_bar
    from moteslam.eval.page.document import Wishes, page
    from moteslam.eval.page.material import gather
    from moteslam.robot.files import folder_for, write_atomically

    material = gather(paths)
    more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
    name = title if title is not None else f"{paths[0].absolute().name}{more}"
    wishes = Wishes(name, tuple(metrics or ()), baseline, players=not no_player)
    with progress_bar("reading runs", len(material.runs), "runs") as bar:
        text = page(material, wishes, progress=bar.update)
    with folder_for(out):
        write_atomically(out, text)
    size = len(text.encode())
    if as_json:
        say_json({"file": str(out), "bytes": size, "runs": len(material.runs)})
    else:
        say(f"{len(material.runs)} runs in {literal(out)} ({size / 1e6:.1f} MB)")
