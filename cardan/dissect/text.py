"""How the lines of several protocols write values."""

from __future__ import annotations

from collections.abc import Iterable


def number(value: float) -> str:
    """Eight significant digits, without noise of the last bits."""
    return f"{value:.8g}"


def numbers(values: Iterable[float]) -> str:
    """Each with eight significant digits."""
    return " ".join(map(number, values)) or "(none)"


def listed(texts: Iterable[str]) -> str:
    """With commas; "none" where there are none."""
    return ", ".join(texts) or "none"
