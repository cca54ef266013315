"""Generator of the console's pictures in docs/images (make docs-pictures).

They are the screenshots of the acceptance test, with fewer colors to keep files small.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from tests.acceptance.console import use_console
from tests.console.browser import find_chromium

FOLDER = Path(__file__).parents[1] / "docs/images"
COLORS = 128
SECONDS = 40.0


def main() -> None:
    """Run the acceptance test of the page, and store the screenshots that docs show."""
    browser = find_chromium()
    if browser is None:
        sys.exit("no Chromium is installed: tools/debian-packages judges")
    with tempfile.TemporaryDirectory() as folder:
        _, problems = use_console(browser, Path(folder), SECONDS)
        if problems:
            sys.exit("\n".join(problems))
        for path in sorted(Path(folder).glob("console-*.png")):
            if not (FOLDER / path.name).exists():
                continue
            with Image.open(path) as picture:
                plain = picture.convert("RGB").quantize(
                    COLORS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
                )
            plain.save(FOLDER / path.name, optimize=True)
            print(f"{FOLDER.name}/{path.name}: {(FOLDER / path.name).stat().st_size} bytes")


if __name__ == "__main__":
    main()
