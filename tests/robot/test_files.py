"""Files appear whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import IO, Any

import pytest

from moteslam.errors import OutputError
from moteslam.robot import files
from moteslam.robot.files import folder_for, write_atomically


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


def test_a_read_only_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> str:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(files.tempfile, "mkstemp", refuse)
    with pytest.raises(OutputError, match="x: cannot be written: Permission denied"):
        write_atomically(tmp_path / "x", "x")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_what_is_no_regular_file_stays_what_it_is(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with pytest.raises(OutputError, match=r"pipe: cannot be written: it is no regular file"):
        write_atomically(pipe, "x")
    assert pipe.is_fifo()
    assert names(tmp_path) == ["pipe"]
