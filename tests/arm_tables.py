"""Writes the table beside each of our arms: what Pinocchio reads of its files, for programs that
have no Pinocchio. test_arm_tables holds them current."""

from __future__ import annotations

from pathlib import Path

from cardan.robots.arm_loader import FOLDER, arm_names, our_texts
from cardan.robots.arm_table import content_key, to_table


def table_of(name: str) -> tuple[Path, str]:
    """Where the table of an arm is, and what belongs there."""
    texts = our_texts(name)
    return FOLDER / f"{name}.json", to_table(texts.build(), content_key(texts.all))


def main() -> None:
    """Write all of them."""
    for name in arm_names():
        path, text = table_of(name)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
