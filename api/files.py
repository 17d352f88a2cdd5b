"""Files: read within bounds, written whole or not at all; the folders of results."""

import secrets
import stat
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Set
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, ExistsError, File, InputError, MoteslamError, OutputError

MARKER = ".moteslam"  # In every result folder: a title, then the names of the files and folders beside it

_TITLE = "made by moteslam"

MAX_ARRAYS = 2 << 30
"""No ``.npz`` may declare more for the arrays asked for: 2 GiB, over an hour of a 1081-beam lidar at 40 Hz."""

Shape = tuple[int | str, ...]
"""A shape asked for: numbers, and letters that stand for one size throughout the file. ``()`` is one number."""


def open_regular(path: File, expected: str, *, error: type[MoteslamError] = InputError) -> IO[bytes]:
    """Open a regular file for reading; a pipe or device, which may never end, is refused.

    ``expected`` is what should be there, for the message of the error: ``a TUM trajectory``.
    """
    try:
        mode = Path(path).stat().st_mode
        if stat.S_ISREG(mode):
            return Path(path).open("rb")
    except (OSError, ValueError) as problem:  # ValueError: a null byte in the name
        raise error(f"{getattr(problem, 'strerror', None) or problem}, expected {expected}", file=path) from problem
    kind = "a folder" if stat.S_ISDIR(mode) else "no regular file"
    raise error(f"is {kind}, expected {expected}", file=path)


def read_bytes(path: File, expected: str, *, limit: int, error: type[MoteslamError] = InputError) -> bytes:
    """The content of a regular file of at most ``limit`` bytes; the other arguments as of ``open_regular``."""
    try:
        with open_regular(path, expected, error=error) as file:
            content = file.read(limit + 1)
    except OSError as problem:
        raise error(f"{problem.strerror or problem}, expected {expected}", file=path) from problem
    if len(content) > limit:
        raise error(f"over {limit / 1e6:g} MB, expected {expected}", file=path)
    return content


def read_text(path: File, expected: str, *, limit: int, error: type[MoteslamError] = InputError) -> str:
    """The text of a regular UTF-8 file of at most ``limit`` bytes, without a byte order mark."""
    try:
        return read_bytes(path, expected, limit=limit, error=error).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error(f"not UTF-8 text, expected {expected}", file=path) from problem


def read_yaml(path: Path, expected: str, *, limit: int) -> Any:
    """What a YAML file of at most ``limit`` bytes holds: tables, lists, texts and numbers.

    Aliases are refused: ten lines of them stand for a list of a thousand million values.
    """
    import yaml

    class Loader(yaml.SafeLoader):
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("an alias; expected the value itself")
            return super().compose_node(parent, index)

    text = read_text(path, expected, limit=limit)
    try:
        return yaml.load(text, Loader)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        problem = " ".join(str(error).splitlines()[:1])
        raise InputError(f"not YAML: {problem[:200]}", file=path) from error


def read_arrays(path: Path, shapes: Mapping[str, Shape], *, max_bytes: int = MAX_ARRAYS) -> dict[str, NDArray[Any]]:
    """Read the named arrays of real numbers of an ``.npz``, each of the shape asked for; no pickles.

    Args:
        path: the file; other arrays in it are left alone.
        shapes: the arrays and their shapes, such as ``{"time_stamps": ("n",), "counts": (4, "n")}``; an array of
            shape ``()`` may also come with one element in any number of dimensions. Every size is at least 1, but one
            whose name ends in ``*`` may be 0.
        max_bytes: what the arrays may take together, uncompressed; looked at before one is read.
    """
    arrays: dict[str, NDArray[Any]] = {}
    name = None
    with open_regular(path, "a .npz file") as file:
        try:
            stored = {one.filename.removesuffix(".npy"): one.file_size for one in zipfile.ZipFile(file).infolist()}
            if missing := [wanted for wanted in shapes if wanted not in stored]:
                there = ", ".join(ascii(other[:40]) for other in sorted(stored)[:8])
                raise InputError(f"missing, expected among {there or 'its arrays'}", file=path, field=missing[0])
            if (total := sum(stored[wanted] for wanted in shapes)) > max_bytes:
                raise InputError(f"{total} bytes of arrays, expected at most {max_bytes}", file=path)
            file.seek(0)
            with np.load(file, allow_pickle=False) as content:
                for name in shapes:
                    arrays[name] = content[name]
        except MoteslamError:
            raise
        except Exception as error:  # zipfile, its packers and NumPy raise a dozen kinds
            problem = f"damaged or no .npz of numbers: {' '.join(str(error).split())[:100]}"
            raise InputError(problem, file=path, field=name) from error
    sizes: dict[int | str, int] = {}
    for name, wanted in shapes.items():
        array = arrays[name]
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
            raise InputError(f"{getattr(array, 'dtype', 'no array')}, expected real numbers", file=path, field=name)
        if not wanted and array.size == 1:
            continue
        for size, have in zip(wanted, array.shape, strict=False):
            sizes.setdefault(size, size if isinstance(size, int) else have)
        empty = any(have == 0 and not str(size).endswith("*") for size, have in zip(wanted, array.shape, strict=False))
        if array.shape != tuple(sizes.get(size) for size in wanted) or empty or not wanted:
            what = f"[{', '.join(map(str, wanted))}], none of them 0" if wanted else "one number"
            raise InputError(f"shape {list(array.shape)}, expected {what}", file=path, field=name)
    return arrays


def file_within(folder: Path, name: str, *, file: Path, field: str) -> Path:
    """The path of a file in a folder that ``field`` of ``file`` names; refused if none is there, or links lead out."""
    try:
        inside, there = (folder / name).resolve().is_relative_to(folder.resolve()), (folder / name).exists()
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise ConfigError(f"{name[:40]!r}, expected the name of a file", file=file, field=field) from error
    if not inside:
        raise ConfigError(f"{name[:40]!r} lies elsewhere, expected a file in {folder}", file=file, field=field)
    if not there:
        raise ConfigError(f"{name[:40]!r} is not there, expected a file in {folder}", file=file, field=field)
    return folder / name


def write_atomically(path: File, content: str | bytes | Callable[[IO[bytes]], None]) -> None:
    """Write a complete file, or none: a text (UTF-8), bytes, or what a function writes into the open binary file."""
    path = Path(path)
    temporary = path.parent / f".moteslam-{secrets.token_hex(8)}"
    try:
        expect_file(path)
        with temporary.open("xb") as file:
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
        temporary.replace(path)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def expect_file(path: Path) -> None:
    """Refuse to write over a folder, a device or a pipe."""
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "no regular file"
        raise OutputError(f"cannot be written: it is {kind}, expected the name of a file", file=path)


def make_folder(folder: File) -> None:
    """Make a folder and those above it, unless it is there."""
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made: {error.strerror or error}", file=folder) from error


@contextmanager
def folder_for(path: File) -> Iterator[None]:
    """Make the folders above a file that the block will write; where it fails, those that were made go again."""
    made = [folder for folder in Path(path).absolute().parents if not folder.exists()]
    make_folder(Path(path).absolute().parent)
    try:
        yield
    except BaseException:
        for folder in made:
            with suppress(OSError):  # no longer ours alone
                folder.rmdir()
        raise


@contextmanager
def staged_file(path: File, *, force: bool = False, keep: File | None = None) -> Iterator[Path]:
    """A file, with what its format puts beside it, that appears complete when the block ends; nothing where it fails.

    The block writes a file of the same name in a temporary folder, and others beside it. With ``force`` the file is
    replaced, and then those beside it, but never the input ``keep``.
    """
    path = Path(path)
    replaces = _is_replaced(path, "file", force=force, keep=keep)
    with _folder_beside(path) as folder:
        yield folder / path.name
        made = sorted(folder.iterdir(), key=lambda file: file.name == path.name)  # where the file is, the others are
        for file in made[:-1]:
            _is_replaced(path.with_name(file.name), "file", force=replaces, keep=keep)
        for file in made:
            file.replace(path.with_name(file.name))


def _is_replaced(path: Path, kind: str, *, force: bool, keep: File | None) -> bool:
    """Whether a ``file`` or ``folder`` is there, which may be replaced."""
    if not (path.is_symlink() or path.exists()):
        return False
    if not force:
        raise ExistsError(f"exists already; name a new {kind}", file=path)
    if path.is_dir() != (kind == "folder") or (path.is_symlink() and kind == "folder"):
        raise OutputError(f"is no {kind}, expected a {kind} to replace", file=path)
    for what, inside in (("the current folder", Path.cwd()), ("the input", keep)):
        if inside is not None and Path(inside).resolve().is_relative_to(path.resolve()):
            raise OutputError(f"is or holds {what}, which would be lost; expected another {kind}", file=path)
    return True


@contextmanager
def result_folder(path: File, *, force: bool = False, keep: File | None = None) -> Iterator[Path]:
    """A new folder that appears under its name, complete, when the block ends, and not at all when it fails.

    The block writes into a temporary folder. An existing one is replaced at the end with ``force``, if it holds nothing
    but what moteslam wrote, and not the input ``keep``.
    """
    path = Path(path)
    _expect_ours(path, force=force, keep=keep)
    target = path.absolute()
    with _folder_beside(path) as folder:
        work = folder / target.name
        work.mkdir()
        yield work
        mark(work)
        _expect_ours(path, force=force, keep=keep)
        old = folder / ".replaced"
        try:
            if target.exists():
                target.rename(old)
            work.rename(target)
        finally:
            if old.exists() and not target.exists():
                old.rename(target)


def _expect_ours(path: Path, *, force: bool, keep: File | None) -> None:
    """Refuse a folder that must not be replaced."""
    if not _is_replaced(path, "folder", force=force, keep=keep):
        return
    names, ours = _content(path)
    if foreign := sorted(names - ours):
        raise OutputError(f"holds {foreign[0]}, which moteslam did not write; expected another folder", file=path)


def _content(folder: Path) -> tuple[set[str], set[str]]:
    """The names of all that is in a folder, and of what moteslam wrote there."""
    try:
        names = {entry.name for entry in folder.iterdir()}
        title, *known = ((folder / MARKER).read_text("utf-8") if MARKER in names else "").splitlines() or [""]
    except (OSError, ValueError) as error:
        raise OutputError(f"cannot be read: {error}", file=folder) from error
    return names, {MARKER, *known} if title == _TITLE else set()


def cleared(folder: Path, kind: str) -> set[str]:
    """Make a folder, or take from it what moteslam wrote there along with a file ``kind``; the names that stay."""
    make_folder(folder)
    names, ours = _content(folder)
    old = names & ours if kind in ours else set()
    try:
        for name in old:
            (folder / name).unlink()
    except OSError as error:
        raise OutputError(f"cannot be replaced: {error.strerror or error}", file=folder) from error
    return names - old


def mark(folder: Path, others: Set[str] = frozenset()) -> None:
    """Note in ``MARKER`` what moteslam wrote into a folder: all but others."""
    names = sorted({entry.name for entry in folder.iterdir()} - others - {MARKER})
    write_atomically(folder / MARKER, "\n".join([_TITLE, *names, ""]))


@contextmanager
def _folder_beside(path: Path) -> Iterator[Path]:
    """A temporary folder beside a target; errors about files in it name those that they are meant for."""
    with folder_for(path):
        place = Path()
        try:
            with tempfile.TemporaryDirectory(
                prefix=".moteslam-", suffix=".partial", dir=path.absolute().parent
            ) as name:
                place = Path(name)
                yield place
        except MoteslamError as error:
            if error.file is None or not Path(error.file).is_relative_to(place.absolute()):
                raise
            file = path.parent / Path(error.file).relative_to(place)
            raise type(error)(error.problem, file=file, field=error.field, line=error.line) from error
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
