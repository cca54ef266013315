"""The UDP shell: never waits, reads a bounded amount, never takes an old datagram for a new one."""

import socket

import pytest

from cardan.errors import AddressError
from cardan.gateway.hand.filters.listener import MAX_PER_TICK, DatagramListener
from cardan.gateway.hand.filters.readings import MAX_DATAGRAM_BYTES, Malformed
from cardan.types import NEVER_S


class Sensor:
    """A listener on a free port, and who sends to it. Loopback delivers within sendto()."""

    def __init__(self):
        self.taken = []
        self.listener = DatagramListener("127.0.0.1", 0, self.take)
        self.listener.open()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def take(self, data, received_s):
        if data == b"bad":
            return Malformed("it is bad")
        self.taken.append((data, received_s))
        return None

    def send(self, *datagrams):
        for data in datagrams:
            self.socket.sendto(data, self.listener.address)


@pytest.fixture
def sensor():
    made = Sensor()
    yield made
    made.listener.close()
    made.socket.close()


def test_a_datagram_counts_as_received_when_the_queue_was_last_empty(sensor):
    sensor.listener.drain(10.0)
    sensor.send(b"a")
    sensor.listener.drain(10.004)
    assert sensor.taken == [(b"a", 10.0)]


def test_what_lay_there_during_a_stall_is_as_old_as_the_stall(sensor):
    sensor.listener.drain(10.0)
    sensor.send(b"a")
    sensor.listener.drain(12.0)
    sensor.send(b"b")
    sensor.listener.drain(12.004)
    assert sensor.taken == [(b"a", 10.0), (b"b", 12.0)]


def test_what_came_before_the_first_tick_has_no_age(sensor):
    sensor.send(b"a")
    sensor.listener.drain(10.0)
    assert sensor.taken == [(b"a", NEVER_S)]


def test_a_flood_is_read_in_portions_and_grows_old(sensor):
    sensor.listener.drain(10.0)
    for tick in range(1, 4):
        sensor.send(*[b"x"] * (MAX_PER_TICK + 1))
        sensor.listener.drain(10.0 + tick)
        assert len(sensor.taken) == tick * MAX_PER_TICK
    assert {received_s for _, received_s in sensor.taken} == {10.0}


def test_malformed_datagrams_are_counted_and_named(sensor):
    assert "nothing was heard" in sensor.listener.diagnosis("sensor")[0]
    sensor.send(b"bad", b"good", b"bad")
    sensor.listener.drain(10.0)
    assert (sensor.listener.heard, sensor.listener.malformed) == (1, 2)
    assert sensor.listener.diagnosis("camera") == (
        "2 datagrams from the camera are malformed, the last one because it is bad",
    )


def test_a_long_datagram_is_seen_to_be_too_long(sensor):
    sensor.send(b"x" * 5000)
    sensor.listener.drain(10.0)
    assert len(sensor.taken[0][0]) == MAX_DATAGRAM_BYTES + 1


def test_a_port_that_is_taken_is_named(sensor):
    second = DatagramListener(*sensor.listener.address, sensor.take)
    with pytest.raises(AddressError, match=f"127.0.0.1:{sensor.listener.address[1]}"):
        second.open()
    assert not second.is_open


def test_closed_it_hears_nothing_and_says_nothing():
    listener = DatagramListener("127.0.0.1", 0, lambda _data, _received_s: None)
    listener.drain(10.0)
    assert listener.diagnosis("sensor") == ()
    listener.close()
    listener.open()
    listener.open()
    listener.close()
    listener.close()
    listener.drain(11.0)
