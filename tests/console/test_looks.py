"""Appearance of the console page: legibility, names, colors and reach of its parts, on each
screen."""

from __future__ import annotations

import re
import time

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from tests.console.page_input import RELOADED, enable, keeps
from tests.console.pictures import still_arm

pytestmark = pytest.mark.matrix

SCREENS = [(390, 844), (700, 900), (820, 1180), (1440, 900)]
PHONE = SCREENS[0]
TABS = ("move", "goal", "plots", "sensors", "device", "setup")

SEEN = "(e => e.checkVisibility() && e.getBoundingClientRect().width > 0)"

NAMES = f"""
[...document.querySelectorAll('button, input, select, summary, [role=radiogroup], section, h2')]
  .filter(e => {SEEN}(e))
  .map(e => [
    e.getAttribute('role') ?? e.type ?? e.tagName,
    e.ariaLabel ?? e.labels?.[0]?.textContent ?? e.textContent,
  ])
"""

CUT = f"""
[...document.querySelectorAll(
  'button, h2, label span, .slider-label, .unit, .parameter b, .chip .caption, .joint-name span')]
  .filter(e => {SEEN}(e) && !e.closest('.authority .who'))
  .filter(e => e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display !== 'inline')
  .map(e => e.className + ': ' + e.textContent)
"""

SMALL = f"""
[...document.querySelectorAll('button, select, summary, input[type=number], input[type=text]')]
  .filter(e => {SEEN}(e) && !e.closest('.slider-number') && e.getBoundingClientRect().height < 44)
  .map(e => e.textContent + ' ' + e.getBoundingClientRect().height)
"""

OVERLAPS = f"""
(all => all.flatMap((a, at) => all.slice(at + 1)
  .filter(b => {{
    const [p, q] = [a.getBoundingClientRect(), b.getBoundingClientRect()];
    return p.left < q.right - 1 && q.left < p.right - 1 && p.top < q.bottom - 1
      && q.top < p.bottom - 1;
  }})
  .map(b => a.textContent + ' and ' + b.textContent)))
([...document.querySelectorAll('.view button, .view label, .readout')].filter({SEEN}))
"""

ENGLISH = keeps(language="en")
"""Fixed language, because pages of one browser share their stored settings."""

LONG_REASON = "the controller does not answer and is asked again every second, " * 8


@pytest.fixture(scope="module")
def address(built, tmp_path_factory):
    with still_arm(tmp_path_factory.mktemp("still")) as server:
        yield server.address


@pytest.fixture
def phone(address, browser):
    """The page on a phone, which shows the arm."""
    with browser.open(address, *PHONE, scripts=[ENGLISH]) as page:
        page.until(RELOADED)
        yield page


def show(page, tab):
    page.value(f"document.querySelector('#tab-{tab}').click()")
    page.value("new Promise(requestAnimationFrame).then(() => 1)")


def test_a_long_reason_ends_between_two_lines_and_is_whole_where_it_is_pressed(phone):
    # The test measures a copy, because the page writes its own line ten times a second.
    phone.value(
        "window.copy = document.querySelector('.why').cloneNode(true);"
        "document.querySelector('.why').after(copy); 1"
    )
    phone.value(f"(copy.querySelector('*') ?? copy).textContent = {LONG_REASON!r}; 1")
    rows = phone.value(
        "(() => { const range = document.createRange(); range.selectNodeContents(copy);"
        "const clips = [...copy.querySelectorAll('*'), copy]"
        ".filter(e => getComputedStyle(e).overflowY === 'hidden')"
        ".map(e => e.getBoundingClientRect());"
        "const bottom = Math.min(...clips.map(e => e.bottom));"
        "return [...range.getClientRects()].map(e => [e.top - bottom, e.bottom - bottom]); })()"
    )
    assert len(rows) > 2
    assert not [row for row in rows if row[0] < -1 and row[1] > 1], "a row of letters is cut"
    phone.value("document.querySelector('.why').click()")
    assert phone.value("document.querySelector('.why').matches('[data-whole]')")


def test_the_reason_moves_no_control_on_a_phone(phone):
    """A long reason must not move a control away from the finger on it."""
    tops = phone.value(
        "(e => { const found = []; const inner = e.querySelector('*') ?? e;"
        f"for (const text of ['Ready', {LONG_REASON!r}]) {{ inner.textContent = text;"
        "found.push(document.querySelector('.controls').getBoundingClientRect().top); }"
        "return found; })(document.querySelector('.why'))"
    )
    assert len(set(tops)) == 1


@pytest.mark.parametrize("size", SCREENS)
def test_the_view_is_chosen_on_every_screen_and_nothing_covers_it(address, browser, size):
    with browser.open(address, *size, scripts=[keeps(language="es")]) as page:
        page.until(RELOADED)
        page.until("document.querySelector('.readout').textContent.startsWith('X ')")
        for tab in ("move", "goal"):
            show(page, tab)
            shown = f"[...document.querySelectorAll('.view-bar button')].filter({SEEN}).length"
            assert page.value(shown) == 5
            assert page.value(OVERLAPS) == []


@pytest.mark.parametrize("tab", TABS)
def test_each_control_has_a_name_of_its_own(phone, tab):
    show(phone, tab)
    named = [name for role, name in phone.value(NAMES) if role not in ("H2", "number")]
    for word in ("Move", "Goal"):
        assert named.count(word) <= 1, named


def test_the_arrows_of_the_goal_are_there_on_its_tab_only(phone):
    gizmo = f"{SEEN}(document.querySelector('.gizmo-bar'))"
    shown = "document.querySelector('.picture').dataset.gizmo"
    for tab in TABS:
        show(phone, tab)
        assert phone.value(gizmo) == (tab == "goal"), tab
        assert phone.value(shown) == str(tab == "goal").lower(), tab


def test_the_readout_has_position_and_orientation_with_units_and_no_minus_zero(phone):
    readout = "document.querySelector('.readout').textContent"
    phone.until(f"{readout}.startsWith('X ')")
    text = phone.value(readout)
    for axis, unit in [*zip("XYZ", ["mm"] * 3, strict=True)]:
        assert re.search(rf"\b{axis} -?\d+\.\d {unit}", text), text
    for axis in ("Roll", "Pitch", "Yaw"):
        assert re.search(rf"\b{axis} -?\d+\.\d°", text), text
    everything = phone.value("document.body.textContent")
    assert not re.search(r"-0\.?0*(?![\d.])", everything)


def test_the_speed_is_reported_in_mm_per_second_too(phone):
    said = "document.querySelector('.speed').textContent"
    percent = "document.querySelector('.speed input[type=range]')"
    for share, speed in ((20, "50 mm/s"), (100, "250 mm/s"), (1, "2.5 mm/s")):
        phone.value(f"{percent}.value = {share}; {percent}.dispatchEvent(new Event('input')); 1")
        assert speed in phone.value(said)


@pytest.mark.parametrize("size", SCREENS)
def test_the_authority_is_always_said_and_colored(address, browser, size):
    looks = (
        "(e => [e.innerText.replace(/\\s+/g, ' ').trim(), "
        "getComputedStyle(e.querySelector('.owner')).backgroundColor,"
        "e.getBoundingClientRect().right])(document.querySelector('.authority'))"
    )
    with browser.open(address, *size, scripts=[ENGLISH]) as page:
        page.until(RELOADED)
        nobody, free, right = page.value(looks)
        assert nobody.casefold().startswith("authority")
        assert "nobody" in nobody
        assert right <= size[0]
        enable(page)
        page.until("document.querySelector('.authority').dataset.owner === 'own'")
        own, taken, right = page.value(looks)
        assert "you" in own
        assert right <= size[0]
        with browser.open(address, *size, scripts=[ENGLISH]) as other:
            other.until(RELOADED)
            other.until("document.querySelector('.authority').dataset.owner === 'other'")
            theirs, alien, right = other.value(looks)
            assert "console" in theirs
            assert right <= size[0]
        page.value(
            "[...document.querySelectorAll('button')]"
            ".find(each => each.textContent === 'Release').click()"
        )
        page.until("document.querySelector('.authority').dataset.owner === 'nobody'")
    assert len({free, taken, alien}) == 3


@pytest.mark.parametrize(("language", "word"), [("en", "Loop period"), ("es", "Periodo del lazo")])
def test_parameters_have_words_with_units_and_their_raw_names_as_a_hint(
    address, browser, language, word
):
    with browser.open(address, *PHONE, scripts=[keeps(language=language)]) as page:
        page.until(RELOADED)
        show(page, "setup")
        page.until("document.querySelectorAll('.parameter').length > 10")
        reported = page.value(
            "[...document.querySelectorAll('.parameter')].map(e => "
            "[e.querySelector('b').textContent, e.title, e.textContent])"
        )
    titles = [title for title, _, _ in reported]
    assert f"{word}, ms" in titles
    assert not [title for title in titles if "_" in title or re.search(r"cmc|ref\b", title, re.I)]
    assert all(re.search(r"\b[a-z_]+\b", hint.split(":")[0]) for _, hint, _ in reported)
    assert len(set(titles)) == len(titles)


def test_sliders_of_the_goal_are_as_long_as_the_arm_reaches(phone):
    """A UR5 reaches 0.85 m from its shoulder to the wrist's center, 0.95 m to the flange."""
    show(phone, "goal")
    ends = (
        "(e => [Number(e.min), Number(e.max)])"
        "(document.querySelector('input[type=range][aria-label=%s]'))"
    )
    for axis, least, most in (("X", 850, 1050), ("Y", 850, 1050), ("Z", 900, 1200)):
        low, high = phone.value(ends % axis)
        assert least <= high <= most, (axis, low, high)
        assert -most <= low <= -least + 200, (axis, low, high)


@pytest.mark.parametrize("language", ["en", "es"])
@pytest.mark.parametrize("size", SCREENS)
def test_no_word_is_cut_and_what_is_pressed_is_as_large_as_a_finger(
    address, browser, language, size
):
    with browser.open(address, *size, scripts=[keeps(language=language)]) as page:
        page.until(RELOADED)
        for tab in TABS:
            show(page, tab)
            assert page.value(CUT) == [], tab
            assert page.value(SMALL) == [], tab


@pytest.mark.parametrize("size", SCREENS)
def test_the_page_has_its_heading_on_every_screen(address, browser, size):
    with browser.open(address, *size, scripts=[ENGLISH]) as page:
        page.until(RELOADED)
        found = page.value(
            "[...document.querySelectorAll('h1')].filter(e => e.checkVisibility()).length"
        )
    assert found == 1


def test_plots_step_once_a_second_where_less_motion_is_wanted(address, browser):
    wants = (
        "Emulation.setEmulatedMedia",
        {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]},
    )
    drawn = (
        "(drawing => { const clear = drawing.clearRect; window.drawn = 0;"
        "drawing.clearRect = function (...all) { drawn += 1; return clear.apply(this, all); };"
        "})(CanvasRenderingContext2D.prototype)"
    )
    with browser.open(address, scripts=[ENGLISH], asks=[wants]) as page:
        page.until(RELOADED)
        show(page, "plots")
        page.until("document.querySelector('#panel-plots canvas') !== null")
        page.value(drawn)
        begun_s = time.monotonic()
        page.until("drawn > 0")
        page.value("new Promise(done => setTimeout(done, 3000)).then(() => 1)")
        seconds = time.monotonic() - begun_s
        assert page.value("drawn") <= seconds + 1
        moves = page.value(
            "[...document.querySelectorAll('*')].map(getComputedStyle)"
            ".filter(e => parseFloat(e.transitionDuration) > 0.01 || e.animationName !== 'none')"
            ".length"
        )
    assert moves == 0


def test_the_controls_and_stop_are_drawn_before_the_picture(address, browser):
    """The page works while the 3-D scene is still loading."""
    slow = """
      const get = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
        if (String(kind).startsWith('webgl')) {
          const paints = performance.getEntriesByName('first-contentful-paint');
          const chosen = document.querySelector('.arm-select').value;
          window.stopBeforeScene ??= document.querySelector('.stop') !== null
            && paints.length > 0 && chosen !== '';
        }
        return get.call(this, kind, ...more);
      };
    """
    with browser.open(address, scripts=[ENGLISH, slow]) as page:
        page.until(RELOADED)
        assert page.value("window.stopBeforeScene") is True
