"""Messages sent to a server during a pause move nothing when the server continues."""

import threading
import time

import pytest
from websockets.exceptions import ConnectionClosed

from cardan.gateway.servers import pause_detector
from cardan.gateway.servers.pause_detector import STOOD_STILL_S, StandStill
from tests.gateway.servers.bench import plain_client, rosbridge
from tests.gateway.servers.memory_network import MemoryNetwork
from tests.waiting import WITHIN_S, until

TWIST = "geometry_msgs/msg/Twist"


@pytest.mark.usefixtures("notices_pauses")
@pytest.mark.parametrize(
    ("passed_s", "worked_s", "still"),
    [
        (0.1, 0.0, False),
        (STOOD_STILL_S, 0.0, False),
        (STOOD_STILL_S + 0.1, 0.05, True),
        (3600.0, 0.1, True),
        (3.0, 2.5, False),  # a large frame, not a pause
    ],
)
def test_who_did_nothing_for_long_stood_still(passed_s, worked_s, still):
    reported = []
    watch = StandStill(reported.append)
    watch.observe(100.0, 7.0)
    watch.observe(100.0 + passed_s, 7.0 + worked_s)
    assert reported == ([pytest.approx(passed_s)] if still else [])
    watch.observe(100.1 + passed_s, 7.0 + worked_s)
    assert len(reported) == still


def stand_still(stands, patched):
    """Block a server's loop, with the detection of pauses in effect."""
    patched.setattr(pause_detector, "STOOD_STILL_S", STOOD_STILL_S)
    stands.set()
    time.sleep(STOOD_STILL_S + 0.5)


@pytest.mark.real
def test_what_came_meanwhile_is_dropped_and_the_client_is_cut_off(monkeypatch):
    network = MemoryNetwork()
    with rosbridge(network) as running, plain_client(running) as client:
        client.send("advertise", topic="/cmd", type=TWIST)
        client.send("publish", topic="/cmd", msg={"linear": {"x": 1}})
        client.settle()
        assert len(network.published) == 1
        stands = threading.Event()
        running.loop.call_soon_threadsafe(stand_still, stands, monkeypatch)
        assert stands.wait(WITHIN_S)
        for _ in range(500):
            client.send("publish", topic="/cmd", msg={"linear": {"x": 2}})
        with pytest.raises(ConnectionClosed):
            client.settle()
        until(lambda: running.server.counts["cut off"] == 1)
        monkeypatch.undo()
        assert len(network.published) == 1
        with plain_client(running) as again:
            again.send("publish", topic="/cmd", type=TWIST, msg={"linear": {"x": 3}})
            again.settle()
        assert network.published[-1][1]["linear"]["x"] == 3.0
