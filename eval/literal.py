"""Text from elsewhere, shown and not obeyed."""

from __future__ import annotations

import unicodedata


def literal(text: object) -> str:
    r"""Text in one line that a terminal shows and does not obey.

    Control characters, line breaks and reversals of the writing direction are written as escapes (``\x1b``), and so
    are the bytes of a file name that is no text (``\xe9``); everything else, brackets of markup too, stays as it is.
    """
    return "".join(map(_literal, str(text)))


def _literal(character: str) -> str:
    if "\udc80" <= character <= "\udcff":  # how Python writes a byte that is no text
        return f"\\x{ord(character) - 0xDC00:02x}"
    if unicodedata.category(character) in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"):
        return character.encode("unicode_escape").decode("ascii")
    return character
