"""Damaged and hostile variants of a file: what disks, networks, editors and attackers make of it."""

import io
import zipfile
import zlib
from collections.abc import Callable, Sequence

import numpy as np

Generator = np.random.Generator
Mutation = Callable[[bytes, Generator], bytes]

WORDS = (
    *(b"nan", b"-nan", b"inf", b"-inf", b"1e999", b"-1", b"0", b"-0.0", b"1e308", b"1e-320", b"9" * 40, b"1" * 5000),
    *(b"9223372036854775808", b"-9223372036854775809", b"4294967296", b"65536", b"0x10", b"1_000", b"1e5", b".5."),
    *(b"", b" ", b"\0", b"\xff\xfe", "é漢".encode(), b"true", b"null", b"[]", b"{}", b"../../etc/passwd", b"/dev/zero"),
    *(b"!!python/object/apply:os.system", b"&a *a", b"'" * 7, b'"', b"#", b"\r", b"\t", b"a" * 300),
)
"""That stand in for a number or a word."""

INTEGERS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 2**40, 2**63 - 1, 2**64 - 1)
"""That stand in for a length or a count in a binary file."""


def mutated(data: bytes, rng: Generator) -> bytes:
    """A variant of a file after one to four mutations, mostly one.

    Args:
        data: of a file that can be read.
        rng: of the choice; the same one gives the same variant.
    """
    kinds: list[Mutation] = [_flip, _cut, _drop, _repeat, _insert, _integer]
    kinds += [_in_zip] * 4 if data.startswith(b"PK") else [_word, _word, _word, _line, _line] if _is_text(data) else []
    for _ in range(int(rng.choice((1, 1, 1, 2, 4)))):
        data = kinds[int(rng.integers(len(kinds)))](data, rng)
    return data


def _is_text(data: bytes) -> bool:
    return b"\0" not in data[:4096] and sum(byte > 126 for byte in data[:4096]) < 64


def _place(data: bytes, rng: Generator) -> int:
    """Somewhere in a file, more often near its ends, where headers and indexes are."""
    size = max(len(data), 1)
    near = min(size, 200)
    side = int(rng.integers(4))
    if side == 0:
        return int(rng.integers(near))
    return size - 1 - int(rng.integers(near)) if side == 1 else int(rng.integers(size))


def _flip(data: bytes, rng: Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if changed:
            changed[_place(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def _cut(data: bytes, rng: Generator) -> bytes:
    return data[: _place(data, rng)]


def _drop(data: bytes, rng: Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 65)) :]


def _repeat(data: bytes, rng: Generator) -> bytes:
    at = _place(data, rng)
    part = data[at : at + int(rng.integers(1, 257))]
    return data[:at] + part * int(rng.integers(2, 20)) + data[at:]


def _insert(data: bytes, rng: Generator) -> bytes:
    at = _place(data, rng)
    return data[:at] + rng.bytes(int(rng.integers(1, 33))) + data[at:]


def _integer(data: bytes, rng: Generator) -> bytes:
    at, width = _place(data, rng), int(rng.choice((1, 2, 4, 8)))
    value = INTEGERS[int(rng.integers(len(INTEGERS)))] & ((1 << (8 * width)) - 1)
    return data[:at] + value.to_bytes(width, "little" if rng.integers(4) else "big") + data[at + width :]


def _word(data: bytes, rng: Generator) -> bytes:
    lines = data.split(b"\n")
    row = int(rng.integers(len(lines)))
    separator = b"," if b"," in lines[row] and rng.integers(2) else b" "
    words = lines[row].split(separator)
    words[int(rng.integers(len(words)))] = WORDS[int(rng.integers(len(WORDS)))]
    lines[row] = separator.join(words)
    return b"\n".join(lines)


def _line(data: bytes, rng: Generator) -> bytes:
    """A line dropped, doubled, or moved."""
    lines = data.split(b"\n")
    row = lines.pop(int(rng.integers(len(lines))))
    for _ in range(int(rng.integers(3))):
        lines.insert(int(rng.integers(len(lines) + 1)), row)
    return b"\n".join(lines)


def _in_zip(data: bytes, rng: Generator) -> bytes:
    """A member of an archive mutated, with a checksum that is right again; or one left out, renamed or doubled."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except (zipfile.BadZipFile, zlib.error, ValueError, OSError, NotImplementedError, RuntimeError, EOFError):
        return _flip(data, rng)
    if not members:
        return data
    which = int(rng.integers(len(members)))
    name, content = members[which]
    kind = int(rng.integers(8))
    if kind == 0:
        del members[which]
    elif kind == 1:
        members[which] = (members[int(rng.integers(len(members)))][0], content)
    else:
        plain: Sequence[Mutation] = (_flip, _cut, _drop, _repeat, _insert, _integer, _word)
        members[which] = (name, plain[int(rng.integers(len(plain)))](content, rng))
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED if rng.integers(2) else zipfile.ZIP_STORED) as archive:
        for member, inside in dict(members).items():
            archive.writestr(zipfile.ZipInfo(member or "x"), inside)
    return packed.getvalue()
