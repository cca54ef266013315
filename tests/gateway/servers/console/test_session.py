"""A session's simulated arm, the console server, and a program in place of a page: every end of a
hold ends the motion."""

from __future__ import annotations

import json
import threading
import time

import pytest

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install cardan[network]")
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from tests.gateway.servers.bench import WAIT_S
from tests.gateway.servers.console.bench import console, page_program
from tests.serving import session_on_the_network
from tests.waiting import until

pytestmark = pytest.mark.matrix

ARM = "/left/arm"
STATUS = "cardan_msgs/msg/ArmStatus"
FRAME_S = 0.016


@pytest.fixture(scope="module")
def running(tmp_path_factory):
    """A console server for a session."""
    folder = tmp_path_factory.mktemp("console")
    with (
        session_on_the_network(folder) as endpoint,
        BusNetwork(BusOptions(router=endpoint), "console") as network,
    ):
        assert network.wait_for_service(f"{ARM}/ask", WAIT_S)
        with console(network, folder) as running:
            yield running


class Watcher(threading.Thread):
    """Stores a page's messages about the arm, and replies to the server's pings."""

    def __init__(self, page):
        super().__init__(daemon=True)
        self.page, self.status, self.inputs, self.ended = page, None, [], False
        page.ask("subscribe", topic=f"{ARM}/state/status", type=STATUS, queue_length=1)
        self.start()

    def run(self):
        while not self.ended:
            try:
                frame = self.page.next("publish")
            except Exception:
                return
            self.status = frame["msg"]
            self.inputs = [each for each in self.page.heard if each["op"] == "cardan.input"]


def held(page, watcher, seen=lambda: True):
    """Hold until the arm moves and `seen()` is true."""
    page.jog(False)
    end_s = time.monotonic() + WAIT_S
    while not (watcher.status and watcher.status["moving"] and seen()):
        assert time.monotonic() < end_s, (watcher.status, watcher.inputs[-3:])
        if watcher.inputs and watcher.inputs[-1]["grip"] == "lost":
            page.jog(False)
        page.jog(x=0.03)
        time.sleep(FRAME_S)


def let_go(page):
    page.jog(False)


def fall_silent(_page):
    """Send nothing more."""


def hide(page):
    page.jog(visible=False)


def lose_tracking(page):
    page.jog(tracking=False)


def cut(page):
    page.connection.socket.shutdown(2)


@pytest.mark.real("fall_silent", "cut")
@pytest.mark.parametrize("end", [let_go, fall_silent, hide, lose_tracking, cut])
def test_every_end_of_a_hold_stops_the_arm(running, end):
    with page_program(running) as page, page_program(running) as other:
        source = page.begin()["source"]
        page.open(1, arm=ARM)
        watcher, beside = Watcher(page), Watcher(other)

        def seen():
            reported = beside.status
            return reported is not None and reported["moving"] and reported["authority"] == source

        held(page, watcher, seen)
        end(page)
        until(lambda: not beside.status["moving"], "the arm rests")
        watcher.ended = beside.ended = True


def test_a_second_page_waits_for_the_first(running):
    with page_program(running) as first, page_program(running) as second:
        source = first.begin()["source"]
        second.begin()
        for each in (first, second):
            each.open(1, arm=ARM)
        watcher, beside = Watcher(first), Watcher(second)
        held(first, watcher)
        second.jog(False)
        end_s = time.monotonic() + WAIT_S
        while not any(source in each["why"] for each in beside.inputs):
            assert time.monotonic() < end_s, beside.inputs[-3:]
            first.jog(x=0.03)
            second.jog(x=-0.03)
            time.sleep(FRAME_S)
            if beside.inputs and beside.inputs[-1]["grip"] == "free":
                continue
        first.jog(False)
        watcher.ended = beside.ended = True


def verb(page, source, name, value=None):
    """Send a request to the arm as `source`; return the reason if it is refused, or ""."""
    request = {"id": 1, "source": source, "verb": name}
    if value is not None:
        request["value"] = value
    args = {"request": json.dumps(request)}
    page.ask("call_service", id=name, service=f"{ARM}/ask", args=args)
    answer = page.next("service_response", id=name)
    return json.loads(answer["values"]["reply"]).get("error", {}).get("message", "")


def test_the_authority_is_asked_for_and_handed_over_and_stop_needs_none(running):
    with page_program(running) as first, page_program(running) as second:
        one, other = (each.begin()["source"] for each in (first, second))
        # Pages of earlier tests release the arm when they disconnect.
        until(lambda: not verb(first, one, "acquire"), "it is free")
        assert f"'{one}' has authority" in verb(second, other, "acquire")
        requests = f"{ARM}/authority/request"
        first.ask("subscribe", topic=requests, type="cardan_msgs/msg/AuthorityRequest")
        end_s = time.monotonic() + WAIT_S
        # A new subscription reaches its publisher after a moment.
        while not any(each.get("topic") == requests for each in first.heard):
            assert time.monotonic() < end_s
            second.ask("cardan.ask", arm=ARM, owner=one)
            assert not verb(first, one, "acquire")
        asked = next(each["msg"] for each in first.heard if each.get("topic") == requests)
        assert (asked["source"], asked["owner"], asked["answer"]) == (other, one, "")
        second.ask("call_service", id="stop", service=f"{ARM}/stop")
        assert second.next("service_response", id="stop")["values"]["success"]
        assert "has no authority" in verb(second, other, "hand_over", other)
        assert not verb(first, one, "hand_over", asked["source"])
        assert not verb(second, other, "acquire")
        assert f"'{other}' has authority" in verb(first, one, "acquire")
        assert not verb(second, other, "release")
        assert not verb(first, one, "acquire")
