"""Operator actions on the page: enable motion, hold, release."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import NamedTuple

from tests.console.browser import WAIT_S, Tab

STATE = "document.body.dataset.state"
RELOADED = "document.querySelectorAll('.joint-jog').length > 0"
WHY = "document.querySelector('.why').textContent"

Place = tuple[float, float]


def jog(axis: str, sign: int = 1) -> str:
    """Selector of a jog button."""
    return f'button[aria-label="{axis}{"+" if sign > 0 else "−"}"]'


def keeps(**settings: object) -> str:
    """Script that stores these settings before the page reads them."""
    return (
        "try { localStorage.setItem('cardan-console', "
        f"{json.dumps(json.dumps(settings))}); }} catch {{}}"
    )


def enable(page: Tab) -> None:
    """Re-arm; repeat it if a busy computer disarms the arm at once."""
    end_s = time.monotonic() + WAIT_S
    while page.value(STATE) == "watching":
        page.until("!document.querySelector('.enable').disabled")
        page.click(".enable")
        give_up_s = time.monotonic() + 2.0
        while page.value(STATE) == "watching" and time.monotonic() < give_up_s:
            time.sleep(0.02)
        assert time.monotonic() < end_s, page.value(WHY)


class PageInput(NamedTuple):
    """A way to hold a button, and to release it."""

    press: Callable[[Tab, str], Place]
    """Press, and return the place of the button."""
    let_go: Callable[[Tab, Place], None]


def _press_mouse(page: Tab, selector: str) -> Place:
    at = page.center(selector)
    page.mouse("mousePressed", at)
    return at


def _press_touch(page: Tab, selector: str) -> Place:
    at = page.center(selector)
    page.touch("touchStart", at)
    return at


def _press_key(page: Tab, selector: str) -> Place:
    page.value(f"document.querySelector({json.dumps(selector)}).focus()")
    page.key("keyDown", " ", "Space")
    return 0.0, 0.0


MOUSE = PageInput(_press_mouse, lambda page, at: page.mouse("mouseReleased", at))
FINGER = PageInput(_press_touch, lambda page, at: page.touch("touchEnd"))
KEY = PageInput(_press_key, lambda page, at: page.key("keyUp", " ", "Space"))


def hold(page: Tab, page_input: PageInput, selector: str, moves: Callable[[], bool]) -> Place:
    """Hold a button until the arm moves; return the place of the pointer. A browser on a busy
    computer sometimes pauses, which correctly ends the hold; the hold is then repeated."""
    end_s = time.monotonic() + WAIT_S
    while True:
        enable(page)
        at = page_input.press(page, selector)
        while page.value(STATE) == "held":
            if moves():
                return at
            time.sleep(0.01)
        page_input.let_go(page, at)
        assert time.monotonic() < end_s, page.value(WHY)
