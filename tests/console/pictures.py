"""Generate the pictures docs/images/console-*.webp of the page on a large and on a small screen.

To take them again, after looking at the page: ``make console-pictures``, or ``python -m
tests.console.pictures``.
"""

from __future__ import annotations

import base64
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.console.browser import Browser, Tab, chromium, find_chromium
from tests.console.page_input import RELOADED, keeps
from tests.console.robot_and_server import ServerProcess, console_server
from tests.serving import ARM_SESSION, session_on_the_network

FOLDER = Path(__file__).parents[2] / "docs" / "images"


class Screen(NamedTuple):
    """Screen and settings of a picture."""

    width: int
    height: int
    tab: str
    language: str = "en"
    theme: str = "light"


SCREENS = {
    "console-small-move": Screen(360, 740, "move"),
    "console-small-device": Screen(360, 740, "device", "es", "dark"),
    "console-large-move": Screen(1920, 1080, "move"),
}

MOVING = ".picture, .readout, .why, .link, .authority, output, .number, .mark, .stop, .enable"
"""Elements that differ each time or need a graphics card; comparisons leave them out."""

BLOCK_PX = 40
"""Pictures are compared by the mean colors of squares of this size: different fonts move parts by
less than that, a changed layout by more."""

_MEANS = """
(async (picture, masks, size) => {
  const blob = await (await fetch("data:image/webp;base64," + picture)).blob();
  const bitmap = await createImageBitmap(blob);
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0);
  context.fillStyle = "#808080";
  for (const [x, y, width, height] of masks) context.fillRect(x, y, width, height);
  const { data } = context.getImageData(0, 0, bitmap.width, bitmap.height);
  const means = [];
  for (let top = 0; top < bitmap.height; top += size) {
    for (let left = 0; left < bitmap.width; left += size) {
      const sum = [0, 0, 0];
      let count = 0;
      for (let y = top; y < Math.min(top + size, bitmap.height); y++) {
        for (let x = left; x < Math.min(left + size, bitmap.width); x++) {
          const at = 4 * (y * bitmap.width + x);
          for (let each = 0; each < 3; each++) sum[each] += data[at + each];
          count += 1;
        }
      }
      means.push(sum.map((each) => each / count));
    }
  }
  return means;
})
"""

Means = list[list[float]]


@contextmanager
def still_arm(folder: Path) -> Iterator[ServerProcess]:
    """The console server with an arm that stays at its initial pose."""
    text = ARM_SESSION.replace("period_s = 0.008", "period_s = 0.02")
    with (
        session_on_the_network(folder, text, seconds=3000) as endpoint,
        console_server(endpoint) as server,
    ):
        yield server


@contextmanager
def shown(browser: Browser, address: str, screen: Screen) -> Iterator[Tab]:
    """The page with the settings of this screen."""
    script = keeps(language=screen.language, theme=screen.theme)
    with browser.open(address, screen.width, screen.height, scripts=[script]) as page:
        page.until(RELOADED)
        page.click(f"#tab-{screen.tab}")
        page.value("document.activeElement.blur()")
        page.mouse("mouseMoved", (1.0, 1.0))
        page.value("document.fonts.ready.then(() => new Promise(requestAnimationFrame))")
        yield page


def masks(page: Tab) -> list[list[float]]:
    """Rectangles of the elements that comparisons leave out: x, y, width and height."""
    found: list[list[float]] = page.value(
        f"[...document.querySelectorAll({json.dumps(MOVING)})].map(each => {{"
        "const b = each.getBoundingClientRect();"
        "return [b.x - 1, b.y - 1, b.width + 2, b.height + 2];"
        "})"
    )
    return found


def means(page: Tab, picture: bytes, left_out: list[list[float]]) -> Means:
    """Mean colors of a picture's blocks, computed by the browser's own decoder. `page` is any page
    without a content security policy."""
    words = json.dumps(base64.b64encode(picture).decode()), json.dumps(left_out), str(BLOCK_PX)
    found: Means = page.value(f"{_MEANS}({', '.join(words)})")
    return found


def main() -> None:
    """Take all pictures."""
    program = find_chromium()
    if program is None:
        sys.exit("chromium is not installed: apt-get install chromium")
    with (
        tempfile.TemporaryDirectory(prefix="cardan-pictures-") as folder,
        chromium(program, Path(folder) / "chromium") as browser,
        still_arm(Path(folder)) as server,
    ):
        for name, screen in SCREENS.items():
            with shown(browser, server.address, screen) as page:
                (FOLDER / f"{name}.webp").write_bytes(page.picture())


if __name__ == "__main__":
    main()
