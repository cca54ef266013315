"""Simulated SpaceMouse on a real socket, advanced step by step."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import pty
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from cardan.errors import AddressError, OptionError, ScriptError
from cardan.sim_peers.backends.unix_socket import MAX_CLIENTS, QUEUE_REPORTS
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

PATIENCE_S = WITHIN_S
"""Longest wait of a test for an event that takes milliseconds."""


@pytest.fixture
def path() -> Iterator[str]:
    # The paths of pytest's folders can be too long for a socket.
    with tempfile.TemporaryDirectory(prefix="puck") as directory:
        yield str(Path(directory) / "puck.sock")


@contextlib.contextmanager
def served(path: str, script: str, **options: object) -> Iterator[SpaceMousePeer]:
    """Open a peer that plays `script` (text, or the name of a built-in one)."""
    if " " in script:
        file = Path(path).with_suffix(".txt")
        file.write_text(script)
        script = str(file)
    peer = SpaceMousePeer(SpaceMousePeerOptions(hid=path, script=script, **options))  # type: ignore[arg-type]
    peer.open()
    try:
        yield peer
    finally:
        peer.close()


def connect(path: str) -> socket.socket:
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        client.connect(path)
    except OSError:
        client.close()
        raise
    client.setblocking(False)
    return client


def step_until(peer: SpaceMousePeer, done: Callable[[], object]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not done():
        now_s = time.monotonic()
        assert now_s < end_s, "it did not happen"
        peer.step(now_s + 0.005)


def advance(peer: SpaceMousePeer, seconds: float) -> None:
    """Advance the peer's clock without waiting."""
    assert peer._start_s is not None
    peer._start_s -= seconds
    peer.step(0.0)


class Reader:
    """Collects the messages that a client receives."""

    def __init__(self, client: socket.socket) -> None:
        self.client = client
        self.reports: list[bytes] = []
        self.ended = False

    def read(self) -> list[bytes]:
        try:
            while not self.ended:
                report = self.client.recv(4096)
                self.ended = not report
                self.reports += [report] * bool(report)
        except BlockingIOError:
            pass
        except ConnectionResetError:
            self.ended = True
        return self.reports


@pytest.mark.real
def test_all_clients_get_all_reports_and_outputs_reach_the_device(path: str) -> None:
    with served(path, "0.05 axes 1 0 0 0 0 0\n0.15 neutral\n0.3 press left", jitter_lsb=0) as peer:
        assert peer.endpoint == path
        with connect(path) as first, connect(path) as second:
            readers = [Reader(first), Reader(second)]
            first.send(b"\x04\x00")
            step_until(peer, lambda: all(b"\x03\x01\x00" in r.read() for r in readers))
            assert not peer.device.led
            reports = readers[0].reports
            assert readers[1].reports == reports
            assert not any(any(report[1:]) for report in reports[-3:-1])
            assert reports[0] == bytes.fromhex("01 0000 a2fe 0000")


def test_a_late_peer_makes_no_burst(path: str) -> None:
    with (
        served(path, "0 axes 1 0 0 0 0 0\n0.5 press left\n0.6 release left") as peer,
        connect(path) as client,
    ):
        reader = Reader(client)
        step_until(peer, reader.read)
        before = len(reader.reports)
        advance(peer, 30.0)
        came = reader.read()[before:]
        assert [r for r in came if r[0] == 3] == [b"\x03\x01\x00", b"\x03\x00\x00"]
        assert len([r for r in came if r[0] != 3]) <= 3


def test_the_script_starts_with_the_first_client(path: str) -> None:
    with served(path, "0 press left") as peer:
        peer.step(time.monotonic() + 0.05)
        assert peer.device.held == ()
        with connect(path) as client:
            step_until(peer, Reader(client).read)
        assert peer.device.held == ("left",)


def test_who_only_looks_whether_somebody_listens_starts_nothing(path: str) -> None:
    with served(path, "0 press left") as peer:
        connect(path).close()
        peer.step(time.monotonic() + 0.05)
        assert peer.device.held == ()
        with connect(path) as client:
            step_until(peer, Reader(client).read)


def test_unplug_closes_clients_and_removes_the_socket_until_replug(path: str) -> None:
    with served(path, "0 axes 1 0 0 0 0 0\n1000 unplug\n2000 replug") as peer:
        with connect(path) as client:
            reader = Reader(client)
            step_until(peer, reader.read)
            advance(peer, 1000.0)
            step_until(peer, lambda: reader.read() and reader.ended)
            assert any(reader.reports[-1][1:])
            assert not peer.device.plugged
            assert not os.path.exists(path)
        advance(peer, 1000.0)
        assert os.path.exists(path)
        with connect(path) as client:
            step_until(peer, Reader(client).read)
    assert not os.path.exists(path)


def test_a_client_that_goes_away_harms_nobody(path: str) -> None:
    with served(path, "0 axes 1 0 0 0 0 0") as peer, connect(path) as stays:
        leaves = connect(path)
        reader, leaver = Reader(stays), Reader(leaves)
        step_until(peer, lambda: leaver.read() and reader.read())
        leaves.close()
        count = len(reader.reports)
        step_until(peer, lambda: len(reader.read()) > count + 4)


@pytest.mark.parametrize("newest_lost", [False, True])
def test_a_slow_client_loses_reports_and_nothing_else_waits(path: str, newest_lost: bool) -> None:
    edges = 4 * QUEUE_REPORTS
    taps = [f"{0.5 + 0.01 * i:.2f} {('press', 'release')[i % 2]} left" for i in range(edges)]
    faults = {"newest-lost": 1.0} if newest_lost else {}
    with (
        served(path, "\n".join(taps), faults=faults) as peer,
        connect(path) as slow,
        connect(path) as quick,
    ):
        all_reports, few = Reader(quick), Reader(slow)
        step_until(peer, lambda: len(peer.backend.clients) == 2)
        while len(all_reports.read()) < edges:
            advance(peer, 0.01)
        assert peer.backend.lost > 0
        step_until(peer, lambda: len(few.read()) + peer.backend.lost == edges)
        assert QUEUE_REPORTS <= len(few.reports) <= QUEUE_REPORTS + 16
        assert all(a != b for a, b in itertools.pairwise(all_reports.reports))
        if newest_lost:
            assert few.reports == all_reports.reports[: len(few.reports)]
        else:
            assert few.reports[-QUEUE_REPORTS:] == all_reports.reports[-QUEUE_REPORTS:]


def test_only_so_many_programs_can_have_it_open(path: str) -> None:
    with served(path, "rest") as peer, contextlib.ExitStack() as stack:
        readers = [Reader(stack.enter_context(connect(path))) for _ in range(MAX_CLIENTS)]
        step_until(peer, lambda: len(peer.backend.clients) == MAX_CLIENTS)
        extra = Reader(stack.enter_context(connect(path)))
        step_until(peer, lambda: extra.read() or extra.ended)
        assert extra.ended
        assert not any(reader.ended for reader in readers)


def test_seized_accepts_and_stays_silent(path: str) -> None:
    script = "0 axes 1 0 0 0 0 0"
    with served(path, script, faults={"seized": 1.0}) as peer, connect(path) as client:
        reader = Reader(client)
        client.send(b"\x04\x00")
        step_until(peer, lambda: not peer.device.led)
        peer.step(time.monotonic() + 0.05)
        assert reader.read() == []
        assert not reader.ended


def test_refuse_refuses_and_yields_after_its_time(path: str) -> None:
    with served(path, "rest", faults={"refuse": 1000.0}) as peer:
        with pytest.raises(ConnectionRefusedError):
            connect(path)
        peer._opened_s -= 1000.0  # advances its clock
        peer.step(0.0)
        connect(path).close()


def test_a_stale_socket_is_replaced_and_a_live_one_is_not(path: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as dead:
        dead.bind(path)
    with served(path, "rest"):
        other = SpaceMousePeer(SpaceMousePeerOptions(hid=path))
        with pytest.raises(AddressError, match=r"another program serves .*puck\.sock"):
            other.open()
        assert os.path.exists(path)
        connect(path).close()
    assert not os.path.exists(path)


def test_a_listening_socket_of_another_kind_is_left_alone(path: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stream:
        stream.bind(path)
        stream.listen()
        with pytest.raises(AddressError, match="another program serves"):
            SpaceMousePeer(SpaceMousePeerOptions(hid=path)).open()
    assert os.path.exists(path)


def test_paths_that_cannot_be_used_are_named(path: str) -> None:
    Path(path).write_text("mine")
    with pytest.raises(AddressError, match="exists and is not a socket"):
        SpaceMousePeer(SpaceMousePeerOptions(hid=path)).open()
    assert Path(path).read_text() == "mine"
    for bad in (path + "-no/puck.sock", "/" + "x" * 200):
        with pytest.raises(AddressError, match=r"x{50}|puck"):
            SpaceMousePeer(SpaceMousePeerOptions(hid=bad)).open()


def test_close_removes_only_its_own_socket(path: str) -> None:
    with served(path, "rest") as peer:
        os.unlink(path)
        Path(path).write_text("mine")
        peer.close()
        peer.close()
        assert Path(path).read_text() == "mine"


def test_wrong_options_are_named(path: str) -> None:
    for options, message in (
        ({"model": "mouse"}, "model: 'mouse' .* it must be one of .*spacenavigator"),
        ({"script": "nosuch"}, "script 'nosuch' is neither a file .* circle, demo"),
        ({"faults": {"explode": 1.0}}, "there is no fault 'explode'"),
        ({"jitter_lsb": -1}, "jitter_lsb: -1 .* it must be 0 to"),
    ):
        error = OptionError if "it must be" in message else ScriptError
        with pytest.raises(error, match=message):
            SpaceMousePeer(SpaceMousePeerOptions(hid=path, **options))  # type: ignore[arg-type]


def test_led_changes_are_logged(path: str, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    with served(path, "rest") as peer, connect(path) as client:
        client.send(b"\x04\x00")
        step_until(peer, lambda: "LED off" in caplog.text)


def test_keyboard_needs_a_terminal_and_leaves_no_socket_behind(
    path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open(os.devnull) as nothing:
        monkeypatch.setattr(sys, "stdin", nothing)
        with pytest.raises(ScriptError, match="standard input is not a terminal"):
            SpaceMousePeer(SpaceMousePeerOptions(hid=path, keyboard=True)).open()
    assert not os.path.exists(path)


def test_keyboard_moves_the_puck(path: str) -> None:
    program = (
        "import sys\n"
        "from cardan.sim_peers.base import serve\n"
        "from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions\n"
        "serve(SpaceMousePeer(SpaceMousePeerOptions(hid=sys.argv[1], keyboard=True)), 20)\n"
    )
    keyboard, screen = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", program, path], stdin=screen, stdout=screen, stderr=screen
    )
    try:
        os.close(screen)
        shown = b""
        while b"READY" not in shown:
            shown += os.read(keyboard, 4096)
        client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with client:
            client.settimeout(PATIENCE_S)
            client.connect(path)
            os.write(keyboard, b"w ")
            reports = []
            while len([r for r in reports if r[0] == 3]) < 1 or not any(reports[-1][1:]):
                reports.append(client.recv(64))
            assert b"\x03\x01\x00" in reports
            client.send(b"\x04\x00")
            while b"LED off" not in shown:
                shown += os.read(keyboard, 4096)
    finally:
        process.terminate()
        assert process.wait(timeout=PATIENCE_S) == 0
        os.close(keyboard)
    assert not os.path.exists(path)
