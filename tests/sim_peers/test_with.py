"""A simulated peer in a ``with`` statement serves in its own thread."""

import threading
import time

import pytest

from cardan.errors import AddressError
from cardan.sim_peers.base import SimulatedPeer

PATIENCE_S = 10.0


class Peer(SimulatedPeer):
    endpoint = "nowhere"

    def __init__(self, obstacle=""):
        self.obstacle = obstacle
        self.stepped = threading.Event()
        self.calls = []

    def open(self):
        if self.obstacle:
            raise AddressError(self.obstacle)
        self.calls.append("open")

    def step(self, until_s):
        self.calls.append(threading.current_thread())
        self.stepped.set()
        time.sleep(0.0)

    def close(self):
        self.calls.append("close")


def test_it_serves_until_the_end_of_the_block():
    before = threading.active_count()
    with Peer() as peer:
        assert peer.stepped.wait(PATIENCE_S)
    assert threading.active_count() == before
    first, *steps, last = peer.calls
    assert (first, last) == ("open", "close")
    (thread,) = set(steps)
    assert thread is not threading.current_thread()


def test_an_error_in_the_block_closes_it():
    peer = Peer()
    with pytest.raises(ZeroDivisionError), peer:
        _ = 1 / 0
    assert peer.calls[-1] == "close"


def test_one_that_cannot_be_opened_serves_nothing():
    before = threading.active_count()
    peer = Peer("the port is in use")
    with pytest.raises(AddressError), peer:
        pytest.fail("it was entered")
    assert threading.active_count() == before
    assert peer.calls == []
