"""Access of a browser, authority over the arm with two pages, and a client that does not read."""

from __future__ import annotations

import contextlib
import datetime
import json
import socket
import time

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from websockets.sync.client import connect

from cardan.gateway.servers.console.certificate import own_certificate
from tests.console.browser import REBOUND, WAIT_S
from tests.console.page_input import MOUSE, RELOADED, STATE, WHY, hold, jog
from tests.console.robot_and_server import ARM, console_server
from tests.serving import free_tcp_port
from tests.waiting import until

pytestmark = pytest.mark.matrix

TOKEN = "operators-0123456789"
VIEWER = "viewers-0123456789"
TOKEN_FORM = "document.querySelector('form.token')"
LINK = "document.body?.dataset.link"

OTHER_PAGE = """
new Promise((resolve) => {
  const socket = new WebSocket("%s");
  socket.onopen = () => resolve("open");
  socket.onerror = () => resolve("refused");
})
"""


def test_two_browsers_and_one_arm(bench, browser):
    """The page with the authority moves the arm; the other page shows the owner, and gets the arm
    afterwards."""
    tcp = bench.robot.tcp
    with browser.open(bench.address) as one, browser.open(bench.address) as two:
        for page in (one, two):
            page.until(RELOADED)
        at = hold(one, MOUSE, jog("X", -1), lambda: tcp.moving)
        # The other page tries while the first one holds.
        enable_anyway(two)
        MOUSE.press(two, jog("X"))
        end_s = time.monotonic() + 0.4
        while time.monotonic() < end_s:
            assert two.value(STATE) != "held" or one.value(STATE) != "held"
            time.sleep(0.05)
        MOUSE.let_go(two, at)
        MOUSE.let_go(one, at)
        until(lambda: not tcp.moving, "rest")
        one.click(".enable")
        one.until(f"{STATE} === 'watching'")
        at = hold(two, MOUSE, jog("X", -1), lambda: tcp.moving)
        MOUSE.let_go(two, at)


def enable_anyway(page):
    """Click enable, unless the page disables it because another client has the arm."""
    if page.value("!document.querySelector('.enable').disabled"):
        page.click(".enable")


@pytest.fixture(scope="module")
def guarded(bench):
    """A server that requires a token, on the same network."""
    tokens = f"operator {TOKEN}\nviewer {VIEWER}"
    with console_server(
        bench.robot.endpoint, environment={"CARDAN_SERVER_TOKEN": tokens}
    ) as server:
        yield server


@pytest.mark.real
def test_a_page_with_the_right_token_comes_in_and_hides_it(guarded, browser):
    address = guarded.address.partition("#")[0]
    with browser.open(f"{address}#t={TOKEN}") as page:
        page.until(RELOADED)
        assert TOKEN not in page.value("location.href")
        # A reload keeps the token for this tab.
        page.ask("Page.reload")
        page.until(RELOADED)
    with browser.open(f"{address}#t=wrong-0123456789") as page:
        page.until(f"{LINK} === 'refused'")
        assert page.value("document.querySelector('.enable').disabled")
        assert page.value(f"{WHY}.length > 0")
        assert not page.value(RELOADED)


ASKED = (
    "performance.getEntriesByType('resource').filter((each) => each.name.includes('/ws')).length"
)


@pytest.mark.parametrize(
    ("fragment", "says"),
    [("#t=wrong-0123456789", "The server does not know this token"), ("", "The server asks for a")],
)
def test_a_page_with_a_wrong_token_or_none_asks_for_the_right_one(guarded, browser, fragment, says):
    address = guarded.address.partition("#")[0]
    with browser.open(f"{address}{fragment}") as page:
        page.until(f"{LINK} === 'refused'")
        page.until(f"{WHY}.includes({says!r})")
        page.value("new Promise((resolve) => setTimeout(resolve, 2500))")
        assert page.value(ASKED) == 1, "it tries again by itself"
        assert page.value(LINK) == "refused"
        page.value(f"{TOKEN_FORM}.querySelector('input').value = {TOKEN!r}")
        page.value(f"{TOKEN_FORM}.requestSubmit()")
        page.until(RELOADED)
        assert page.value(f"{TOKEN_FORM}.hidden")


def test_another_token_in_the_address_of_an_open_page_counts(guarded, browser):
    address = guarded.address.partition("#")[0]
    with browser.open(f"{address}#t=wrong-0123456789") as page:
        page.until(f"{LINK} === 'refused'")
        page.value(f"location.hash = 't={TOKEN}'")
        page.until(RELOADED)


def test_a_viewers_stop_stops_the_arm(bench, guarded, page, browser):
    """Stopping needs no authority and no operator token."""
    address, tcp = guarded.address.partition("#")[0], bench.robot.tcp
    with browser.open(f"{address}#t={VIEWER}") as viewer:
        viewer.until(RELOADED)
        at = hold(page, MOUSE, jog("X", -1), lambda: tcp.moving)
        viewer.click(".stop")
        until(lambda: not tcp.moving, "rest")
        viewer.until(
            "document.querySelector('.stop').textContent.startsWith('Stop was sent and taken')"
        )
        page.until(f"{STATE} === 'watching'")
        page.until(f"/stopped: enable again \\(ros2 .*rosbridge_client/.test({WHY})")
        MOUSE.let_go(page, at)


def test_a_page_from_elsewhere_does_not_come_in(bench, guarded, browser):
    """A foreign page is refused even with the token, and even by a server without tokens: any page
    that a user visits could try."""
    for port, token in ((bench.server.port, ""), (guarded.port, f"?t={TOKEN}")):
        address = f"ws://127.0.0.1:{port}/ws{token}"
        with browser.open("data:text/html,elsewhere") as page:
            assert page.value(OTHER_PAGE % address) == "refused"
        with browser.open(f"http://127.0.0.1:{port}/") as page:
            assert page.value(OTHER_PAGE % address) == "open"


def test_a_name_that_is_not_the_servers_shows_nothing(bench, browser):
    """DNS rebinding: a foreign host name that resolves to this computer."""
    with browser.open(f"http://{REBOUND}:{bench.server.port}/") as page:
        page.until("document.body?.textContent.includes('the Host header names another server')")
        assert page.value("location.host").startswith(REBOUND)
        assert page.value("document.scripts.length") == 0


def test_a_client_that_does_not_read_costs_the_others_nothing(bench, page):
    """The client subscribes to everything at full rate and never reads; a page is not affected."""
    idle = socket.create_connection(("127.0.0.1", bench.server.port), WAIT_S)
    idle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with connect(
        f"ws://127.0.0.1:{bench.server.port}/ws", sock=idle, compression=None, close_timeout=0.1
    ) as slow:
        idle_topics = ["/left/joint_states", f"{ARM}/state/pose", f"{ARM}/state/snapshot", "/tf"]
        for topic in idle_topics * 8:
            slow.send(json.dumps({"op": "subscribe", "topic": topic}))
        tcp = bench.robot.tcp
        at = hold(page, MOUSE, jog("X", -1), lambda: tcp.moving)
        MOUSE.let_go(page, at)
        until(lambda: not tcp.moving, "rest")
        page.click(".link summary")
        median_ms = page.until(
            "parseFloat([...document.querySelectorAll('.link dd')].map(e => e.textContent)[0]) || 0"
        )
        assert median_ms < 150.0


def test_a_certificate_is_renewed_and_the_page_connects_again(bench, browser, tmp_path):
    """The server restarts with another certificate at the same port while the tab stays open."""
    state = {"STATE_DIRECTORY": str(tmp_path), "CARDAN_SERVER_TOKEN": TOKEN}
    port = free_tcp_port()
    words = ["--host", "0.0.0.0", "--port", str(port)]
    now = datetime.datetime.now(datetime.timezone.utc)
    long_ago = now - datetime.timedelta(days=380)
    asks = [("Security.enable", {}), ("Security.setIgnoreCertificateErrors", {"ignore": True})]

    old = own_certificate(["127.0.0.1", "localhost"], long_ago, tmp_path).fingerprint
    with contextlib.ExitStack() as stack:
        with console_server(bench.robot.endpoint, words, state):
            # The certificate expires within 30 days, so the server replaces it at the start.
            first = own_certificate([], now, tmp_path)
            assert first.fingerprint != old
            address = f"https://127.0.0.1:{port}/#t={TOKEN}"
            page = stack.enter_context(browser.open(address, asks=asks))
            page.until(RELOADED)
            loaded = page.value("performance.timeOrigin")
        page.until(f"{LINK} === 'lost'")
        first.certificate.unlink()
        with console_server(bench.robot.endpoint, words, state):
            assert own_certificate([], now, tmp_path).fingerprint != first.fingerprint
            page.until(f"{LINK} === 'live'")
            assert page.value("performance.timeOrigin") == loaded
            page.ask("Page.reload")
            page.until(RELOADED)
            assert page.value(LINK) == "live"
