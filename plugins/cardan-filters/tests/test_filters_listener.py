"""The sockets: reading never blocks, is limited in size, and never returns an old datagram as
new."""

import os
import socket
import stat
import subprocess
import sys

import pytest

from cardan.errors import AddressError
from cardan.types import NEVER_S
from cardan_filters.listener import (
    MAX_PER_TICK,
    DatagramListener,
    ListenerOptions,
    Sender,
)
from cardan_filters.readings import MAX_DATAGRAM_BYTES, Malformed


class Sensor:
    """A listener on a free port, and a sender. Loopback delivers within sendto()."""

    def __init__(self):
        self.taken = []
        self.senders = []
        self.listener = DatagramListener(("127.0.0.1", 0), self.take)
        self.listener.open()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def take(self, data, received_s, sender):
        self.senders.append(sender)
        if data == b"bad":
            return Malformed("it is bad")
        self.taken.append((data, received_s))
        return None

    def send(self, *datagrams):
        for data in datagrams:
            self.socket.sendto(data, self.listener.place)


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
    assert "nothing was received" in sensor.listener.diagnosis("sensor")[0]
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
    second = DatagramListener(sensor.listener.place, sensor.take)
    with pytest.raises(AddressError, match=f"127.0.0.1:{sensor.listener.place[1]}"):
        second.open()
    assert not second.is_open


def test_closed_it_hears_nothing_and_says_nothing():
    listener = DatagramListener(("127.0.0.1", 0), lambda *_: None)
    listener.drain(10.0)
    assert listener.diagnosis("sensor") == ()
    listener.close()
    listener.open()
    listener.open()
    listener.close()
    listener.close()
    listener.drain(11.0)


def test_senders_to_a_port_are_distinguished_by_their_addresses(sensor):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.sendto(b"b", sensor.listener.place)
        sensor.send(b"a", b"a")
        sensor.listener.drain(10.0)
        assert sensor.senders == [
            Sender("127.0.0.1", other.getsockname()[1]),
            *[Sender("127.0.0.1", sensor.socket.getsockname()[1])] * 2,
        ]
    assert str(sensor.senders[0]) == f"127.0.0.1:{sensor.senders[0].number}"


class TestUnixSocket:
    @pytest.fixture
    def path(self, tmp_path):
        return str(tmp_path / "sensor.sock")

    @pytest.fixture
    def heard(self, path):
        """Drain a listener at the path; return the received datagrams and senders."""
        taken = []
        listener = DatagramListener(path, lambda *datagram: taken.append(datagram))
        before = os.umask(0)
        listener.open()
        os.umask(before)
        listener.drain(10.0)
        yield lambda: (listener.drain(10.004), taken)[1]
        listener.close()
        assert not os.path.exists(path)

    @pytest.mark.usefixtures("heard")
    def test_only_its_owner_can_write_to_it(self, path):
        assert stat.S_IMODE(os.stat(path).st_mode) == 0o600

    def test_the_kernel_tells_which_process_sent(self, path, heard):
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as own:
            own.sendto(b"20", path)
        code = f"import socket; socket.socket(1, 2).sendto(b'30', {path!r})"
        with subprocess.Popen([sys.executable, "-c", code]) as other:
            pass
        assert heard() == [
            (b"20", 10.0, Sender("", os.getpid())),
            (b"30", 10.0, Sender("", other.pid)),
        ]
        assert str(heard()[0][2]) == f"process {os.getpid()}"

    @pytest.mark.usefixtures("heard")
    def test_a_second_listener_is_refused(self, path):
        with pytest.raises(AddressError, match="does another filter or program listen there"):
            DatagramListener(path, lambda *_: None).open()


class TestOptions:
    def test_without_any_it_is_a_socket_in_the_users_runtime_folder(self, tmp_path, monkeypatch):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        assert ListenerOptions().place("camera") == f"{tmp_path}/cardan-camera.sock"

    def test_without_such_a_folder_one_is_made_that_only_the_user_can_change(
        self, tmp_path, monkeypatch
    ):
        monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        place = ListenerOptions().place("camera")
        assert place == f"{tmp_path}/cardan-{os.getuid()}/cardan-camera.sock"
        listener = DatagramListener(place, lambda *_: None)
        listener.open()
        assert stat.S_IMODE(os.stat(os.path.dirname(place)).st_mode) == 0o700
        listener.close()
        os.chmod(os.path.dirname(place), 0o777)
        with pytest.raises(AddressError, match="is not a folder that only you can change"):
            listener.open()

    def test_a_path_or_a_port_where_they_are_given(self):
        assert ListenerOptions(socket="s").place("camera") == "s"
        assert ListenerOptions(port=6601).place("camera") == ("127.0.0.1", 6601)
        assert ListenerOptions(port=6601, host="0.0.0.0").place("x") == ("0.0.0.0", 6601)

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"socket": "s", "port": 6601}, "socket: 's' is not allowed; it must be left out"),
            ({"host": "0.0.0.0"}, "host: '0.0.0.0' is not allowed; it must be left out, or given"),
            ({"socket": ""}, "socket: '' is not allowed"),
        ],
    )
    def test_what_does_not_fit_is_refused(self, options, words):
        with pytest.raises(ValueError, match="allowed") as caught:
            ListenerOptions(**options)
        assert words in str(caught.value)
