"""The console page in a real browser loads, shows the arm, and fits its screen."""

from __future__ import annotations

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from tests.console.page_input import RELOADED

pytestmark = pytest.mark.matrix


@pytest.mark.real
def test_the_page_loads_offline_without_a_complaint_and_shows_the_arm(bench, page):
    loaded = page.value("performance.getEntriesByType('resource').map(each => each.name)")
    assert loaded
    assert all(each.startswith(bench.address) for each in loaded)
    assert page.value("document.querySelectorAll('.joint-jog').length") == 6
    assert page.value("document.querySelector('.picture canvas').width") > 0
    assert page.until("document.querySelector('.readout').textContent.startsWith('X ')")
    bad = [each for each in page.complaints() if "GL Driver Message" not in each]
    assert not bad


@pytest.mark.parametrize("size", [(360, 740), (1280, 800)])
def test_nothing_is_wider_than_the_screen_and_stop_is_in_it(bench, browser, size):
    with browser.open(bench.address, *size) as page:
        page.until(RELOADED)
        width, height = size
        assert page.value("document.documentElement.scrollWidth") <= width
        for tab in ("move", "goal", "plots", "sensors", "device", "setup"):
            page.click(f"#tab-{tab}")
            assert not page.value(
                "(p => p.scrollWidth - p.clientWidth)(document.querySelector('.panels'))"
            ), tab
            left, top, right, bottom = page.value(
                "(b => [b.left, b.top, b.right, b.bottom])"
                "(document.querySelector('.stop').getBoundingClientRect())"
            )
            assert 0 <= left < right - 48 <= width - 48, tab
            assert height / 2 < top < bottom - 48 <= height - 48, tab
