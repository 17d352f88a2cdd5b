"""The program ``moteslam``: its commands, and what becomes of errors, interrupts and closed pipes."""

import errno
import inspect
import os
import sys
import traceback
import warnings
from functools import partial
from typing import Annotated, Any

import typer

from moteslam.errors import ExistsError, MoteslamError, MoteslamWarning, OutputError
from moteslam.eval.cli import catalogue, compare, evaluate, recordings, replay, simulate, sweep
from moteslam.eval.cli.interrupt import MESSAGE, Interrupted, on_interrupt, was_asked
from moteslam.eval.cli.options import opt
from moteslam.eval.cli.text import STDOUT, note, say, stdout_named
from moteslam.plugins import blamed

BAD_INPUT, INTERNAL_ERROR, CLOSED_PIPE = 2, 1, 141

HELP = """Simulate a robot, run particle-filter SLAM over what its sensors saw, and score the estimate.

\b
  moteslam demo                                 a corridor, from nothing to a score
  moteslam replay robot.log.gz --out result     a map of a real building from a real log
  moteslam localize tomorrow.log.gz --map result --out found
  moteslam evaluate result/trajectory.tum truth.tum

Every command has its own --help, with examples.
"""

_LOOK: dict[str, Any] = {
    "add_completion": False,
    "rich_markup_mode": None,
    "pretty_exceptions_enable": False,
    "context_settings": {"help_option_names": ["-h", "--help"], "max_content_width": 100},
}
app = typer.Typer(name="moteslam", help=HELP, no_args_is_help=True, **_LOOK)


def _version(wanted: bool) -> None:
    if wanted:
        from moteslam import __version__

        say(f"moteslam {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, opt("Print the version and exit.", None, "--version", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """The options before the command."""


for command in (
    *(replay.demo, simulate.simulate, replay.replay, replay.localize, evaluate.evaluate),
    *(compare.compare, compare.report, recordings.inspect, recordings.convert, catalogue.platforms, catalogue.metrics),
):
    app.command()(command)
app.add_typer(catalogue.app, name="scenarios")
app.add_typer(sweep.app, name="sweep")


def script(function: Any) -> None:
    """Run a script: its arguments are the parameters of a function, its docstring is the help."""
    signature = inspect.signature(function)
    arguments = [
        each.replace(annotation=Annotated[each.annotation, typer.Argument(file_okay=each.name != "folder")])
        for each in signature.parameters.values()
    ]
    function.__signature__ = signature.replace(parameters=arguments)
    alone = typer.Typer(**_LOOK)
    about = (sys.modules["__main__"].__doc__ or "").split("\n\n")
    alone.command(help="\n\n".join(f"\b\n{part}" for part in about))(function)
    sys.exit(run(sys.argv[1:], alone, sys.argv[0]))


def run(arguments: list[str], program: typer.Typer = app, name: str = "moteslam") -> int:
    """Run one command line and return its exit code; an error is one line on stderr."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal that knows no such letter gets an escape, not an error
            stream.reconfigure(errors="backslashreplace")
    try:
        if program is app:  # a script has its own way with Ctrl-C, and may leave files
            on_interrupt()
        with warnings.catch_warnings():
            warnings.simplefilter("always", MoteslamWarning)
            warnings.showwarning = partial(_show, warnings.showwarning)
            code = program(args=arguments, prog_name=name, standalone_mode=False)
        with stdout_named():
            sys.stdout.flush()
    except (BrokenPipeError, SystemExit):  # Typer makes the one of the other
        _discard_stdout()  # the reader of our output has closed it (``| head``)
        return CLOSED_PIPE
    except (Interrupted, KeyboardInterrupt) as error:
        return _interrupted(error)
    except Exception as error:
        asked = was_asked()  # an extension that is interrupted in its import makes an error of it
        return _failed(error) if asked is None else _interrupted(asked)
    return code if isinstance(code, int) else 0


def _show(usual: Any, message: Warning | str, category: type[Warning], *details: Any, **more: Any) -> None:
    if issubclass(category, MoteslamWarning):
        note(f"warning: {message}")
    else:
        usual(message, category, *details, **more)


def _interrupted(error: BaseException) -> int:
    note(next(iter(getattr(error, "__notes__", ())), MESSAGE))
    return error.exit_code if isinstance(error, Interrupted) else 130


def _failed(error: Any) -> int:
    """Print an error in one line; the exit code that goes with it."""
    if type(error).__name__ == "NoArgsIsHelpError":
        say(error.format_message())
    elif hasattr(error, "format_message"):  # a usage error, of Click or of Typer's own copy of it
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context is not None else ""
        message = error.format_message().replace("Value error, ", "")
        if getattr(error, "option_name", "") == "--out" and context is not None:
            saves = any("--save" in parameter.opts for parameter in context.command.params)
            message = "No such option: --out: tables go to stdout, > FILE keeps them"
            message += ", --save FILE all as JSON" * saves
        near = ": X Y [m], THETA [rad], and SPREAD, the standard deviation of X and Y [m]" * ("'--near'" in message)
        note(f"{message.rstrip('.') if near else message}{near}{hint}")
    elif isinstance(error, MoteslamError):  # what is below the command line names none of its options
        force = ", or replace it with --force" * isinstance(error, ExistsError)
        note(f"{error}{force}{' (option --sequence)' * (error.field == 'sequence')}")
        if error.file == STDOUT:
            _discard_stdout()  # a full disk behind stdout would be reported again at exit
    elif isinstance(error, MemoryError):
        note(f"out of memory ({error}), expected fewer particles, larger cells or a shorter recording")
    elif isinstance(error, OSError) and error.filename is None and error.errno == errno.ENOSPC:
        return _failed(OutputError(f"cannot be written: {error.strerror}", file=STDOUT))  # what Typer printed itself
    elif isinstance(error, OSError):
        note(f"{'' if error.filename is None else f'{error.filename}: '}{error.strerror or error}")
    elif os.environ.get("MOTESLAM_TRACEBACK") == "1":
        raise error
    else:
        kind = f"{type(error).__module__}.{type(error).__qualname__}".removeprefix("builtins.")
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"in {last.filename}, line {last.lineno}"
        whose = blamed(error)
        more = f"MOTESLAM_TRACEBACK=1 shows more{', please report it' * (not whose)}"
        note(f"{f'{whose} failed' if whose else 'internal error'}: {kind}: {error} {place}; {more}")
        return INTERNAL_ERROR
    return BAD_INPUT


def _discard_stdout() -> None:
    """Send what is still buffered nowhere, so that Python does not complain of it at exit."""
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (OSError, ValueError):
        sys.stdout = open(os.devnull, "w")  # noqa: PTH123, SIM115
