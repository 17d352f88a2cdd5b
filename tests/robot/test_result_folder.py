"""Result folders: complete or not there, replaced only where they are ours, one run at a time."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from moteslam.errors import ExistsError, OutputError
from moteslam.robot.files import write_atomically
from moteslam.robot.result_folder import MARKER, result_folder


def names(folder: Path) -> list[str]:
    """What is in a folder, but for the marker."""
    return sorted(path.name for path in folder.iterdir() if path.name != MARKER)


def made(folder: Path, *files: str) -> Path:
    """A result folder with these files."""
    with result_folder(folder) as work:
        for name in files:
            (work / name).touch()
    return folder


def test_a_result_folder_appears_at_the_end(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    with result_folder(target) as work:
        (work / "a").write_text("1")
        assert not target.exists()
    assert names(target) == ["a"]
    assert names(target.parent) == ["out"]
    assert (target / MARKER).read_text() == "made by moteslam\na\n"


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
            made(target, "old")
    assert names(target) == ["old"]


def test_an_existing_folder_is_replaced_whole_and_only_by_force(tmp_path: Path) -> None:
    target = made(tmp_path / "out", "old")
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
    made(tmp_path / "out", "mine")
    rename = Path.rename

    def stopped(self: Path, target: Path) -> Path:
        if target.name == "out" and self.name == "out":
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", stopped)
    with pytest.raises(KeyboardInterrupt), result_folder(tmp_path / "out", force=True) as folder:
        (folder / "new").touch()
    assert [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))] == [
        "out",
        "out/.moteslam",
        "out/mine",
    ]


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


def test_a_read_only_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object, **kwargs: object) -> str:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(OutputError, match="out: cannot be made: Permission denied"), result_folder(tmp_path / "out"):
        pytest.fail("the block must not run")


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


@pytest.mark.parametrize("marker", [None, "", "made by moteslam\nmap.png\n", "by hand\nnotes.txt\n"])
def test_what_moteslam_did_not_write_is_never_deleted(tmp_path: Path, marker: str | None) -> None:
    target = tmp_path / "thesis"
    target.mkdir()
    (target / "notes.txt").write_text("months of work")
    if marker is not None:
        (target / MARKER).write_text(marker)
    with pytest.raises(
        OutputError, match=r"thesis: holds (notes\.txt|\.moteslam), which moteslam did not write; expected"
    ):
        replace(target)
    assert (target / "notes.txt").read_text() == "months of work"


def replace(target: Path) -> None:
    """Replace a folder by one with the file ``new``."""
    with result_folder(target, force=True) as work:
        (work / "new").touch()


def test_an_empty_folder_and_one_of_ours_are_replaced(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    made(tmp_path / "ours", "a", "b")
    (tmp_path / "ours/a").unlink()
    for name in ("empty", "ours"):
        replace(tmp_path / name)
        assert names(tmp_path / name) == ["new"]


def appears(target: Path, *, force: bool = False) -> None:
    """Make a result while another folder appears under its name."""
    with result_folder(target, force=force) as work:
        (work / "new").touch()
        if target.exists():
            target.rename(target.with_name("moved"))
        target.mkdir()
        (target / "another's").touch()


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_that_appears_in_the_meantime_is_left_alone(tmp_path: Path, force: bool) -> None:
    target = tmp_path / "out"
    if force:
        made(target, "old")
    with pytest.raises(OutputError, match=r"out: appeared in the meantime .* the result is in .*out-2$"):
        appears(target, force=force)
    assert names(target) == ["another's"]
    assert names(tmp_path / "out-2") == ["new"]
    assert names(tmp_path) == [*(["moved"] if force else []), "out", "out-2"]


def test_something_put_into_the_folder_in_the_meantime_is_kept(tmp_path: Path) -> None:
    target = made(tmp_path / "out", "old")
    with pytest.raises(OutputError, match="appeared in the meantime"), result_folder(target, force=True):
        (target / "notes.txt").touch()
    assert names(target) == ["notes.txt", "old"]
    assert (tmp_path / "out-2").is_dir()
