"""Text formatting for people, and lines on stderr."""

from __future__ import annotations

import sys
from collections.abc import Iterable


def plural(number: int, noun: str, plural: str = "") -> str:
    """``1 parcel``, ``3,600 cells``."""
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"


def short_number(value: float) -> str:
    """Format a number with four digits; magnitudes below 1e-12 count as rounding errors and become 0."""
    return "0" if abs(value) < 1e-12 else f"{value:.4g}"


def format_point(values: Iterable[float]) -> str:
    """``(0.1, -2)``."""
    return f"({', '.join(short_number(value) for value in values)})"


def say(line: str) -> None:
    """Write a line of this program to stderr, at once."""
    sys.stderr.write(f"mdms: {line}\n")
    sys.stderr.flush()


def silent(line: str) -> None:
    """Take a line in the place of `say`, and write nothing."""
    del line
