"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import IO, Any

import pytest

from moteslam.errors import ExistsError, OutputError
from moteslam.robot import files
from moteslam.robot.files import folder_for, result_folder, write_atomically


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("content", ["ä\n", "ä\n".encode(), lambda file: file.write("ä\n".encode())])
def test_text_bytes_and_writers(tmp_path: Path, content: Any) -> None:
    write_atomically(tmp_path / "x", content)
    assert (tmp_path / "x").read_bytes() == "ä\n".encode()
    assert names(tmp_path) == ["x"]


def test_the_umask_is_heeded(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_atomically(tmp_path / "x", "")
    finally:
        os.umask(before)
    assert (tmp_path / "x").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize(
    ("number", "message"),
    [(errno.ENOSPC, "No space left on device"), (errno.EROFS, "Read-only file system"), (errno.EIO, "error")],
)
def test_a_write_that_fails_leaves_the_old_file(tmp_path: Path, number: int, message: str) -> None:
    (tmp_path / "x").write_text("old")

    def fails(file: IO[bytes]) -> None:
        file.write(b"half")
        raise OSError(number, os.strerror(number))

    with pytest.raises(OutputError, match=rf"x: cannot be written: .*{message}"):
        write_atomically(tmp_path / "x", fails)
    assert names(tmp_path) == ["x"]
    assert (tmp_path / "x").read_text() == "old"


def test_an_interrupt_leaves_nothing(tmp_path: Path) -> None:
    def interrupted(file: IO[bytes]) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_atomically(tmp_path / "x", interrupted)
    assert names(tmp_path) == []


def test_no_folder_and_a_folder_in_the_way(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    for path in (tmp_path / "no" / "x", tmp_path / "folder", tmp_path / "file" / "x"):
        with pytest.raises(OutputError, match="cannot be written"):
            write_atomically(path, "x")
    assert names(tmp_path) == ["file", "folder"]


def test_a_result_folder_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    with result_folder(target) as work:
        (work / "a").write_text("1")
        assert not target.exists()
    assert names(target) == ["a"]
    assert names(target.parent) == ["out"]


def fail_after_a_file(work: Path, error: type[BaseException]) -> None:
    (work / "a").touch()
    raise error


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_a_result_that_fails_leaves_what_there_was(tmp_path: Path, error: type[BaseException]) -> None:
    target = tmp_path / "out"
    for force in (False, True):
        with pytest.raises(error), result_folder(target, force=force) as work:
            fail_after_a_file(work, error)
        assert names(tmp_path) == (["out"] if force else [])
        if not force:
            target.mkdir()
            (target / "old").touch()
    assert names(target) == ["old"]


def test_an_existing_folder_is_replaced_whole_and_only_by_force(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "old").touch()
    with pytest.raises(ExistsError, match=r"exists already; name a new folder$"), result_folder(target):
        pytest.fail("the block must not run")
    with result_folder(target, force=True) as work:
        (work / "new").touch()
        assert names(target) == ["old"]
    assert names(target) == ["new"]
    assert names(tmp_path) == ["out"]


def test_a_stop_in_the_midst_of_replacing_puts_the_old_folder_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine").write_text("precious")
    rename = Path.rename

    def stopped(self: Path, target: Path) -> Path:
        if self.suffix == ".partial":
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", stopped)
    with pytest.raises(KeyboardInterrupt), result_folder(tmp_path / "out", force=True) as folder:
        (folder / "new").touch()
    assert [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))] == ["out", "out/mine"]


def test_files_and_links_are_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    for name in ("file", "link"):
        with (
            pytest.raises(OutputError, match="is not a folder"),
            result_folder(tmp_path / name, force=True),
        ):
            pytest.fail("the block must not run")
    for name in ("file/out", "file/more/out"):
        with (
            pytest.raises(OutputError, match=rf"out: cannot be made: {tmp_path}/file is a file, expected a folder$"),
            result_folder(tmp_path / name),
        ):
            pytest.fail("the block must not run")


def test_a_read_only_place_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> str:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(files.tempfile, "mkdtemp", refuse)
    monkeypatch.setattr(files.tempfile, "mkstemp", refuse)
    with pytest.raises(OutputError, match="out: cannot be made: Permission denied"), result_folder(tmp_path / "out"):
        pytest.fail("the block must not run")
    with pytest.raises(OutputError, match="x: cannot be written: Permission denied"):
        write_atomically(tmp_path / "x", "x")


def test_a_disk_that_fills_while_the_result_is_made(tmp_path: Path) -> None:
    with (
        pytest.raises(OutputError, match="out: cannot be written: No space left on device"),
        result_folder(tmp_path / "out"),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert names(tmp_path) == []


def test_forcing_never_deletes_the_input_or_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = tmp_path / "recording"
    folder.mkdir()
    (folder / "robot.log").write_text("data")
    for keep in (folder, folder / "robot.log"):
        with pytest.raises(OutputError, match="holds the input"), result_folder(folder, force=True, keep=keep):
            pass
    monkeypatch.chdir(folder)
    for target in (folder, tmp_path, Path()):
        with pytest.raises(OutputError, match="holds the current folder"), result_folder(target, force=True):
            pass
    assert (folder / "robot.log").read_text() == "data"


def test_a_file_that_cannot_be_written_is_named_where_it_was_asked_for(tmp_path: Path):
    out = tmp_path / "out"
    with pytest.raises(OutputError) as caught, result_folder(out) as work:
        write_atomically(work / "missing" / "map.pgm", b"")
    assert caught.value.file == str(out / "missing" / "map.pgm")
    assert not out.exists()


def interrupted(path: Path, *, beside: str | None = None) -> None:
    """Be interrupted before a file is written, perhaps after somebody else has put one beside it."""
    with folder_for(path):
        assert path.parent.is_dir()
        if beside is not None:
            (path.parent / beside).touch()
        raise KeyboardInterrupt


def test_folders_above_a_file_stay_where_it_was_written_alone(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path / "old" / "new" / "newer" / "x")
    assert names(tmp_path / "old") == []
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path / "old" / "new" / "x", beside="another's")
    assert names(tmp_path / "old" / "new") == ["another's"]
    with folder_for(tmp_path / "one" / "two" / "x"):
        (tmp_path / "one" / "two" / "x").touch()
    assert names(tmp_path / "one" / "two") == ["x"]
