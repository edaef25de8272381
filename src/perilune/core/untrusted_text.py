"""Untrusted text: limits on its size and nesting before it is parsed, and printing in one line."""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from perilune.core.errors import PeriluneError

# Texts and comments, in which brackets are none. What is not closed goes to the end of its line, and nothing is given
# back, so that no character is looked at twice.
_TEXTS = re.compile(r""""(?:\\.|[^"\\\n]+)*+"?+|'[^'\n]*+'?+|#[^\n]*+""")


def bounded_bytes(path: Path, what: str, largest: int, *, expected: str, advice: str) -> bytes:
    """Read a file of at most `largest` bytes.

    Parameters
    ----------
    path
        The file. A pipe or a device, which would make reading wait or never end, is none.
    what
        What it should be, as refusals call it ("scenario file").
    largest
        Bytes.
    expected, advice
        For the refusal where there is no such file, and what to try.

    Raises
    ------
    PeriluneError
        If it is not there, is not a file, cannot be read or is too large.
    """
    if not path.is_file():
        said = f"there is no {what} here" if not path.exists() else f"this is not a file, and so cannot be a {what}"
        raise PeriluneError(said, got=str(path), expected=expected, advice=advice)
    try:
        with path.open("rb") as file:
            raw = file.read(largest + 1)
    except OSError as error:
        raise PeriluneError(
            f"the {what} cannot be read",
            got=f"{path}: {error.strerror}",
            expected="a file that you may read",
            advice="check its permissions",
        ) from error
    if len(raw) > largest:
        raise PeriluneError(
            f"the {what} is too large",
            got=f"{path}: more than {largest} bytes",
            expected=f"at most {largest}",
            advice=advice,
        )
    return raw


def bounded_text(path: Path, what: str, largest: int, *, expected: str, advice: str) -> str:
    """Read a file as text in UTF-8, or in UTF-16 with its mark, as PowerShell and spreadsheets write it.

    Arguments as of `bounded_bytes`.

    Parameters
    ----------
    path, what, largest, expected, advice
        As in `bounded_bytes`.

    Raises
    ------
    PeriluneError
        If it cannot be read, is too large, or is no text of these encodings.
    """
    raw = bounded_bytes(path, what, largest, expected=expected, advice=advice)
    try:
        return raw.decode("utf-16" if raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig")
    except UnicodeDecodeError as error:
        raise PeriluneError(
            f"the {what} is not text in UTF-8",
            got=f"{path}: byte {raw[error.start]:#04x} at {error.start}",
            expected=expected,
            advice=f"save it in this encoding, or {advice}",
        ) from None


def one_line(text: str, most: int = 120) -> str:
    """Return a text that is safe to print: one line of at most `most` characters, none of which moves a cursor.

    Parameters
    ----------
    text
        Text of a stranger.
    most
        Greatest number of characters.
    """
    line = "".join(c if c.isprintable() else "?" for c in " ".join(text[: 10 * most].split()))
    return line if len(line) <= most else f"{line[: most - 1]}…"


def refuse_nested(text: str, what: str, deepest: int, *, expected: str, advice: str) -> None:
    """Refuse a text of TOML or JSON with more than `deepest` nested brackets, before it is parsed.

    Parameters
    ----------
    text, what
        The text, and its kind for the message.
    deepest
        Largest depth of brackets.
    expected, advice
        For the message.
    """
    bare = _TEXTS.sub("", text)
    depth = reached = 0
    for character in re.findall(r"[\[\]{}]", bare):
        depth = depth + 1 if character in "[{" else max(depth - 1, 0)
        reached = max(reached, depth)
    if reached > deepest:
        got = f"{reached} brackets inside each other"
        raise PeriluneError(f"the {what} is nested too deeply", got=got, expected=expected, advice=advice)
