"""Makes the pictures of the console's page in docs/images anew, by its demo (make docs-pictures).

They are as a person sees the page, with fewer colours, so that each is small.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

FOLDER = Path(__file__).parents[1] / "docs/images"
COLOURS = 128
SECONDS = 40


def main() -> None:
    """Run the demo, and keep its pictures."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["demo", "console", "--seconds", str(SECONDS), "--pictures", folder]
        subprocess.run([sys.executable, "-m", "cardan", *words], check=True)
        for path in sorted(Path(folder).glob("console-*.png")):
            with Image.open(path) as picture:
                plain = picture.convert("RGB").quantize(
                    COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE
                )
            plain.save(FOLDER / path.name, optimize=True)
            print(f"{FOLDER.name}/{path.name}: {(FOLDER / path.name).stat().st_size} bytes")


if __name__ == "__main__":
    main()
