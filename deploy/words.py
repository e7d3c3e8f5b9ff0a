"""Small words for people."""

from __future__ import annotations


def counted(number: int, noun: str, plural: str = "") -> str:
    """``1 parcel``, ``3,600 cells``."""
    return f"{number:,} {noun if number == 1 else plural or f'{noun}s'}"
