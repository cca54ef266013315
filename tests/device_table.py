"""Generator of the table of judges in docs/devices.md, from the marks of the tests.

Each ``@pytest.mark.judged(device=..., transport=..., by=...)`` is one row entry, and the page has
no others. The table is part of the site only (site_tables). The page's times to neutral are
committed; test_device_faults measures them. To update these: ``make device-table``.
"""

from __future__ import annotations

import ast
from pathlib import Path

TESTS = Path(__file__).parent
PAGE = TESTS.parent / "docs" / "devices.md"
FAULTS = "<!-- made by tests/test_device_faults.py -->\n"
PLUGINS = TESTS.parent / "plugins"


def judged() -> set[tuple[str, str, str]]:
    """Return (device, transport, by) of each mark, including tests that cannot run here."""
    found = set()
    for path in (*TESTS.rglob("*.py"), *PLUGINS.glob("*/tests/**/*.py")):
        text = path.read_text(encoding="utf-8")
        if ".judged" not in text:  # Quick test: parsing all files takes seconds.
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
    """Return the table in Markdown: a row for each device and transport."""
    judges: dict[tuple[str, str], list[str]] = {}
    for device, transport, by in sorted(judged()):
        judges.setdefault((device, transport), []).append(by)
    lines = ["| device | transport | judged by |", "|---|---|---|"]
    for (device, transport), by in judges.items():
        lines.append(f"| {device} | {transport} | {'; '.join(by)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    """Write the times to neutral into their page."""
    # Imported here: it needs pytest, which a build of the site alone lacks.
    from tests import docs_tables, test_device_faults

    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(
        docs_tables.replaced(page, FAULTS, test_device_faults.table()), encoding="utf-8"
    )


if __name__ == "__main__":
    main()
