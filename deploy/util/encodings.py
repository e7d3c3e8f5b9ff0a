"""Text for standard streams that can't hold every character: a locale without UTF-8, a name that is no text."""

from __future__ import annotations

import codecs
import io
import sys
from collections.abc import Sequence

_PLAIN = {
    "–": "-",
    "−": "-",
    "×": "x",
    "·": "-",
    "…": "...",
    "°": " deg",
    "²": "^2",
    "³": "^3",
    "±": "+/-",
    "µ": "u",
}
"""Characters of tables and messages, and how they are spelled in ASCII."""

_SPELLED = "mdms.spelled"


def spell_unencodable() -> None:
    """Let stdout and stderr spell characters that their encoding lacks, where Python would raise at the first.

    The bytes of file names that aren't UTF-8 (``os.fsdecode`` holds them as surrogates) are written as they are.
    """
    codecs.register_error(_SPELLED, _spelled)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # else another program's object: its own affair
            stream.reconfigure(errors=_SPELLED)


def print_utf8(text: str) -> None:
    """Print text of a format that is UTF-8, whatever the locale; on a terminal in the terminal's encoding."""
    stream: object = sys.stdout
    if isinstance(stream, io.TextIOWrapper) and not stream.isatty():
        stream.reconfigure(encoding="utf-8")
    sys.stdout.write(text)


def refusal_of(arguments: Sequence[str]) -> str | None:
    """Return why a command with these arguments is refused: one of them is no text; None if all are.

    Scene names and folders are written into recordings and summaries, which are UTF-8.
    """
    for argument in arguments:
        try:
            argument.encode()
        except UnicodeEncodeError:
            encoding = sys.getfilesystemencoding()
            return f"argument {argument}: is no text in {encoding}: rename the file, or set a locale: LC_ALL=C.UTF-8"
    return None


def _spelled(error: UnicodeError) -> tuple[str | bytes, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    character, end = error.object[error.start], error.start + 1
    if "\udc80" <= character <= "\udcff":
        return bytes([ord(character) - 0xDC00]), end
    return _PLAIN.get(character) or character.encode("ascii", "backslashreplace").decode("ascii"), end
