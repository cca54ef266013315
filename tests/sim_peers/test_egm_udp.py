"""Socket of the simulated controller, over loopback."""

from __future__ import annotations

import socket
from contextlib import ExitStack, contextmanager
from itertools import pairwise

import pytest

from cardan.errors import AddressError
from cardan.protocols.egm.decode import decode_robot
from cardan.protocols.egm.encode import encode_sensor
from cardan.protocols.egm.messages import EgmRobot
from cardan.sim_peers.egm_controller import EgmControllerOptions, EgmControllerPeer
from tests.serving import in_a_thread
from tests.sim_peers.egm_pc import TS, echo
from tests.waiting import WITHIN_S, until

pytestmark = pytest.mark.matrix


@contextmanager
def pc_socket():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pc:
        pc.bind(("127.0.0.1", 0))
        pc.settimeout(WITHIN_S)
        yield pc


def serving(**options):
    return in_a_thread(EgmControllerPeer(EgmControllerOptions(**options)))


def converse(pc, count, answer=True):
    """Answer `count` datagrams at once; return (message, source) of each."""
    got = []
    while len(got) < count:
        data, source = pc.recvfrom(2048)
        message = decode_robot(data)
        if not isinstance(message, EgmRobot):
            continue
        got.append((message, source))
        if answer:
            pc.sendto(encode_sensor(echo(message)), source)
    return got


@pytest.mark.real
def test_answers_are_taken_and_the_schedule_holds():
    with pc_socket() as pc:
        port = pc.getsockname()[1]
        with serving(pc_port=port, mode="joint", comm_timeout_s=WITHIN_S) as peer:
            assert peer.endpoint == f"127.0.0.1:{port}"
            got = converse(pc, 100)
            source_port = peer.local_port
        assert {source[1] for _, source in got} == {source_port}
        messages = [m for m, _ in got]
        seqnos = [m.header.seqno for m in messages]
        assert seqnos == list(range(100))
        # The schedule is absolute: 149 periods, even if single cycles are late.
        span_s = (messages[-1].feed_back.time_us - messages[0].feed_back.time_us) * 1e-6
        cycles = span_s / TS
        assert cycles == pytest.approx(round(cycles), abs=0.01)
        assert peer.core.counters.accepted > 80
        assert peer.local_port is None


def test_messages_from_elsewhere_are_not_heard():
    with pc_socket() as pc, pc_socket() as stranger:
        with serving(pc_port=pc.getsockname()[1], mode="joint") as peer:
            for _ in range(20):
                data, source = pc.recvfrom(2048)
                message = decode_robot(data)
                stranger.sendto(encode_sensor(echo(message)), source)
        assert peer.core.counters.accepted == 0
        assert peer.core.counters.ignored == {}


def test_nobody_listens_at_first():
    with pc_socket() as pc:
        address = pc.getsockname()
    with serving(pc_port=address[1], mode="joint", comm_timeout_s=60.0) as peer:
        until(lambda: peer.core.events, "an event")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pc:
            pc.bind(address)
            pc.settimeout(WITHIN_S)
            got = converse(pc, 20)
            codes = [event.code for event in peer.core.events]
    assert codes == [41830]
    assert got[0][0].header.seqno > 0
    assert peer.core.counters.accepted > 5


def test_a_restarted_controller_has_a_new_port():
    """A new port after each 0.2 s of its own time, however many datagrams a busy computer sends in
    it."""
    faults = {"port-change": 0.2}
    with (
        pc_socket() as pc,
        serving(pc_port=pc.getsockname()[1], mode="joint", comm_timeout_s=WITHIN_S, faults=faults),
    ):
        got = converse(pc, 120)
    ports = {}
    for message, source in got:
        if message.header.tm_ms % 200:  # At the change the rounded time fits both ports.
            ports.setdefault(message.header.tm_ms // 200, set()).add(source[1])
    assert len(ports) >= 3
    assert all(len(each) == 1 for each in ports.values())
    assert len(set.union(*ports.values())) == len(ports)


def test_a_bad_network_both_ways():
    faults = {"drop": 0.1, "duplicate": 0.1, "reorder": 0.1, "delay": 5.0, "garbage": 0.2}
    with ExitStack() as stack:
        pc = stack.enter_context(pc_socket())
        port = pc.getsockname()[1]
        peer = stack.enter_context(serving(pc_port=port, mode="joint", faults=faults, seed=3))
        got = converse(pc, 100)
    seqnos = [m.header.seqno for m, _ in got]
    assert len(set(seqnos)) < len(seqnos)
    assert any(b < a for a, b in pairwise(seqnos))
    assert set(range(min(seqnos), max(seqnos))) - set(seqnos)
    assert 50 < peer.core.counters.accepted < 150
    assert peer.core.counters.flaws["seqno did not advance"] > 5


def test_an_address_that_cannot_be():
    host = "a" * 70  # longer than a DNS label: refused without a query
    peer = EgmControllerPeer(EgmControllerOptions(pc_host=host))
    with pytest.raises(AddressError, match="cannot send to a"):
        peer.open()
    peer.close()
