"""``moteslam report``: sweeps and result folders as one page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import answer, progress_bar
from moteslam.eval.tables import literal


def report(
    paths: Annotated[
        list[Path],
        typer.Argument(metavar="PATH...", help="Files of sweeps, result folders, and folders with either in them."),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE.html", help="The page; it must not exist.")] = Path("report.html"),
    title: Annotated[str | None, typer.Option(metavar="TEXT", help="Of the page [what is compared].")] = None,
    metrics: Annotated[
        list[str] | None,
        typer.Option("--metric", metavar="NAME", help="Which metrics [those of the sweeps, or the usual]; repeatable."),
    ] = None,
    by: options.By = None,
    baseline: options.Baseline = None,
    force: options.ForceFile = False,
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
    with options.new_file(out, ".html", ".htm", force=force):
        from moteslam.eval.page.document import gather, page
        from moteslam.files import write_atomically
        from moteslam.robot.values import counted

        material = gather(paths)
        with progress_bar("reading runs", len(material.runs), "runs") as update:
            text = page(material, title=title, metrics=metrics or (), by=by, baseline=baseline, progress=update)
        write_atomically(out, text)
    size = len(text.encode())
    line = f"{counted(len(material.runs), 'run')} in {literal(out)} ({size / 1e6:.1f} MB)"
    answer({"file": str(out), "bytes": size, "runs": len(material.runs)}, [line], as_json=as_json)
