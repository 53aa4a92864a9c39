"""Names as people gave them, made fit to be written anywhere."""

from __future__ import annotations


def printable(text: str) -> str:
    """``text`` without what UTF-8, XML or a terminal cannot take.

    Bytes of a file's name that are no UTF-8, which Python keeps as lone surrogates, are read as Latin-1, as older
    systems wrote them; control characters become blanks.
    """
    text = "".join(chr(ord(c) - 0xDC00) if 0xDC80 <= ord(c) <= 0xDCFF else c for c in text)
    return "".join(" " if _control(c) else "\N{REPLACEMENT CHARACTER}" if _unwritable(c) else c for c in text)


def _control(character: str) -> bool:
    return ord(character) < 0x20 or 0x7F <= ord(character) < 0xA0


def _unwritable(character: str) -> bool:
    return 0xD800 <= ord(character) <= 0xDFFF or ord(character) in (0xFFFE, 0xFFFF)
