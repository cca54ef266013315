"""Makes the table of docs/devices.md from the marks of the tests.

Every ``@pytest.mark.judged(device=..., transport=..., by=...)`` is one thing that was shown; the
page says no more and no less. To write it anew: ``python -m tests.device_table``.
"""

from __future__ import annotations

import ast
from pathlib import Path

TESTS = Path(__file__).parent
PAGE = TESTS.parent / "docs" / "devices.md"
BEGIN, END = "<!-- made by tests/device_table.py -->\n", "<!-- end -->\n"


def judged() -> set[tuple[str, str, str]]:
    """(device, transport, by) of every mark, whether its test can run here or not."""
    found = set()
    for path in TESTS.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Attribute)
                and node.func.attr == "judged"
            ):
                words = {word.arg: ast.literal_eval(word.value) for word in node.keywords}
                assert set(words) == {"device", "transport", "by"}, f"{path}: {words}"
                found.add((words["device"], words["transport"], words["by"]))
    return found


def table() -> str:
    """The table in Markdown: a row for each device and transport."""
    judges: dict[tuple[str, str], list[str]] = {}
    for device, transport, by in sorted(judged()):
        judges.setdefault((device, transport), []).append(by)
    lines = ["| device | transport | judged by |", "|---|---|---|"]
    for (device, transport), by in judges.items():
        lines.append(f"| {device} | {transport} | {'; '.join(by)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the table into its page."""
    head, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    _, _, tail = rest.partition(END)
    PAGE.write_text(head + BEGIN + "\n" + table() + "\n" + END + tail, encoding="utf-8")


if __name__ == "__main__":
    main()
