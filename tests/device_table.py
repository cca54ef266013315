"""Makes the tables of docs/devices.md from the tests.

Every ``@pytest.mark.judged(device=..., transport=..., by=...)`` is one thing that was shown; the
page says no more and no less. The times to neutral are what test_device_faults measures. To write
both anew: ``make device-table``.
"""

from __future__ import annotations

import ast
from pathlib import Path

from tests import docs_tables, test_device_faults

TESTS = Path(__file__).parent
PLUGINS = TESTS.parent / "plugins"
PAGE = TESTS.parent / "docs" / "devices.md"
JUDGED = "<!-- made by tests/device_table.py -->\n"
FAULTS = "<!-- made by tests/test_device_faults.py -->\n"


def judged() -> set[tuple[str, str, str]]:
    """(device, transport, by) of every mark, whether its test can run here or not."""
    found = set()
    for path in (*TESTS.rglob("*.py"), *PLUGINS.glob("*/tests/**/*.py")):
        text = path.read_text(encoding="utf-8")
        if ".judged" not in text:  # Most: reading them all takes seconds.
            continue
        for node in ast.walk(ast.parse(text)):
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
    """Write the tables into their page."""
    page = PAGE.read_text(encoding="utf-8")
    for begin, made in ((JUDGED, table()), (FAULTS, test_device_faults.table())):
        page = docs_tables.replaced(page, begin, made)
    PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
