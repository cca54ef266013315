"""Generator of the tables beside the arms' files: data that Pinocchio reads from them, for programs
without Pinocchio.

test_arm_tables compares them.
"""

from __future__ import annotations

from cardan.common.cache import content_key
from cardan.robots.arm_loader import FOLDER, arm_names, our_texts
from cardan.robots.arm_table import to_table


def main() -> None:
    """Write all tables."""
    for name in arm_names():
        texts = our_texts(name)
        table = to_table(texts.build(), content_key(texts.texts), texts.urdf)
        (FOLDER / f"{name}.json").write_text(table, encoding="utf-8")


if __name__ == "__main__":
    main()
