"""Copy a report into docs/evaluation.md: ``python -m studies.tests.docs_evaluation FOLDER``.

Its tables go between the page's markers, its pictures into docs/images/evaluation. Needs Pillow,
which comes with matplotlib.
"""

from __future__ import annotations

import sys
from pathlib import Path

from bench import pages
from studies import document
from studies.report import Report, read
from studies.result import Table

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "evaluation.md"
IMAGES = ROOT / "docs" / "images" / "evaluation"
PICTURES = (
    "thesis-line",
    "thesis-collision",
    "motoros-averages",
    "devices-devices",
    "cartesian-delays",
    "haptics-pair",
)
"""Pictures that the page shows, in reduced size."""


def parts(report: Report) -> dict[str, str]:
    """Return the text between the page's markers, by name."""
    return {"evaluation overview": _overview(report), "evaluation figures": _figures(report)}


def _overview(report: Report) -> str:
    rows = [
        (part.name, f"{part.seconds:.0f} s", f"{part.load:.1f}", "; ".join(part.shortened) or "–")
        for part in report.parts
    ]
    columns = ("study", "took", "load before", "shortened")
    words = (
        f"`cardan evaluate{' --quick' if report.quick else ''}` on {report.machine['processors']} "
        f"processors, Cardan {report.versions['cardan']}, Python {report.versions['python']}:"
    )
    return f"{words}\n\n{_table(columns, rows)}"


def _figures(report: Report) -> str:
    rows = []
    for part in report.parts:
        for figure in part.figures:
            if figure.published is None or figure.value is None:
                continue
            unit = f" {figure.unit}" if figure.unit else ""
            published, ours = (f"{x:.4g}{unit}" for x in (figure.published, figure.value))
            rows.append((part.name, figure.name, published, ours))
    return _table(("study", "figure", "published", "ours"), rows)


def _table(columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    text = document.markdown([Table("", columns, tuple(rows))])
    return text[text.index("|") :].strip()


def show(folder: Path) -> None:
    """Put the page's parts of the report into it."""
    from PIL import Image

    report = read(folder)
    IMAGES.mkdir(exist_ok=True)
    for name in PICTURES:
        with Image.open(folder / f"{name}.png") as picture:
            picture.convert("RGB").save(IMAGES / f"{name}.webp", quality=80, method=6)
    pages.rewrite(PAGE, parts(report))


if __name__ == "__main__":
    show(Path(sys.argv[1]))
