"""Import of matplotlib, an optional extra, for the pictures of all studies."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from cardan.common import arm_libraries as arm_libraries  # matplotlib needs numpy.
from cardan.common.extras import missing_extra
from studies.result import Drawn

try:
    import matplotlib as mpl
    import matplotlib.colors as colors
    import matplotlib.patches as patches
    import matplotlib.pyplot as plt
except ImportError as error:
    raise missing_extra("a report's pictures", "matplotlib", "evaluate", error) from error

__all__ = ["colors", "patches", "plt", "save"]

mpl.use("Agg")

STYLE: Any = {
    "svg.fonttype": "none",
    "svg.hashsalt": "cardan",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.frameon": False,
    "path.simplify": True,
}
DPI = 110
"""Resolution of pixel formats."""


def save(
    directory: Path,
    pictures: Iterable[Drawn],
    endings: tuple[str, ...] = ("svg",),
    prefix: str = "",
) -> list[Drawn]:
    """Draw all pictures into `directory`, as files PREFIX NAME . ENDING; return their names and
    titles."""
    directory.mkdir(parents=True, exist_ok=True)
    found = []
    with plt.rc_context(STYLE):
        for drawn in pictures:
            for ending in endings:
                about = {"Title": drawn.title}
                if ending == "svg":
                    about |= {"Date": None, "Creator": None}  # type: ignore[dict-item]
                path = directory / f"{prefix}{drawn.name}.{ending}"
                drawn.figure.savefig(path, metadata=about, dpi=DPI)
            plt.close(drawn.figure)
            found.append(drawn._replace(figure=None))
    return found
