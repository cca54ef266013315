"""Appearance of the page on small and large screens, compared with stored pictures; and its
accessibility."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from tests.console.page_input import RELOADED, keeps
from tests.console.pictures import FOLDER, SCREENS, masks, means, shown, still_arm
from tests.npm import installed

pytestmark = pytest.mark.matrix

OTHER = 24.0
"""Difference of color, of 255, from which two blocks count as different."""
MOST_OTHER = 0.04
"""Share of blocks that may differ, because of fonts and rounding of another system."""

TABS = ("move", "goal", "plots", "device", "setup")


@pytest.fixture(scope="module")
def address(built, tmp_path_factory):
    with still_arm(tmp_path_factory.mktemp("still")) as server:
        yield server.address


@pytest.mark.parametrize("name", SCREENS)
def test_the_page_looks_as_its_picture_does(address, browser, name):
    """If the change of the page is intended, run `make console-pictures`."""
    stored = (FOLDER / f"{name}.webp").read_bytes()
    with shown(browser, address, SCREENS[name]) as page:
        left_out, picture = masks(page), page.picture()
    with browser.open("about:blank") as blank:
        then, now = (means(blank, each, left_out) for each in (stored, picture))
    assert len(then) == len(now)
    pairs = zip(then, now, strict=True)
    other = [max(abs(a - b) for a, b in zip(*pair, strict=True)) > OTHER for pair in pairs]
    assert sum(other) <= MOST_OTHER * len(other), f"{sum(other)} of {len(other)} blocks differ"


AXE = "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'best-practice']})"


@pytest.mark.parametrize(
    ("language", "theme", "size"), [("en", "light", (360, 740)), ("es", "dark", (1280, 800))]
)
def test_nobody_is_kept_from_using_it(address, browser, language, theme, size):
    """axe-core finds no serious violation on any panel."""
    axe = (installed("axe-core", "4.14.1") / "node_modules/axe-core/axe.min.js").read_text()
    settings = keeps(language=language, theme=theme)
    with browser.open(address, *size, scripts=[settings]) as page:
        page.until(RELOADED)
        assert page.value("document.documentElement.lang") == language
        page.value(f"{axe}; 1")
        found = []
        for tab in TABS:
            page.click(f"#tab-{tab}")
            page.value("new Promise(requestAnimationFrame).then(() => 1)")
            violations = page.value(f"{AXE}.then(found => found.violations)")
            found += [
                (tab, each["id"], each["impact"], each["nodes"][0]["html"][:150])
                for each in violations
                if each["impact"] in ("serious", "critical")
            ]
    assert not found, json.dumps(found, indent=1)
