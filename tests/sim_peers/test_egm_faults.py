"""Fault switches of the simulated controller."""

from __future__ import annotations

import random
from itertools import pairwise

import pytest

from cardan.errors import ScriptError
from cardan.protocols.egm.decode import decode_robot
from cardan.protocols.egm.messages import EgmRobot, MCIState, MotorState
from cardan.sim_peers.base import parse_faults
from cardan.sim_peers.egm_controller import FAULTS
from cardan.sim_peers.link import FaultyLink
from tests.sim_peers.egm_pc import TS, Pc, echo


def test_garbage_comes_between_good_datagrams():
    pc = Pc(mode="joint")
    pc.run(2.0, echo)
    link = FaultyLink({"garbage": 0.2}, 1, garbage=True)
    good = bad = 0
    for n, data in enumerate(pc.raw):
        link.push(n * TS, data)
        for arrived in link.pop(n * TS):
            if arrived in pc.raw:
                good += 1
            else:
                bad += 1
                decode_robot(arrived)  # never raises
    assert good == len(pc.raw)
    assert bad == pytest.approx(0.2 * len(pc.raw), rel=0.3)


def test_random_bytes_from_the_pc_change_nothing():
    pc = Pc(mode="joint", encoder_noise_deg=0.0)
    noise = random.Random(8)
    pc.run(0.1, echo)
    before = pc.core.joints_rad
    pc.run(1.0, lambda m: noise.randbytes(noise.randrange(300)) if m.header.seqno % 2 else echo(m))
    assert pc.core.joints_rad == pytest.approx(before, abs=1e-9)
    assert sum(pc.core.counters.ignored.values()) > 100
    assert pc.core.events == []


def test_pause():
    pc = Pc(mode="joint", faults={"pause": 0.3})
    pc.run(11.0, echo)
    gaps = [b - a for a, b in pairwise(pc.times)]
    assert [round(g, 1) for g in gaps if g > 2 * TS] == [0.3, 0.3]
    assert pc.core.events == []
    assert [m.header.seqno for m in pc.received] == list(range(len(pc.received)))
    # A pause longer than CommTimeout counts.
    pc = Pc(mode="joint", faults={"pause": 0.3}, comm_timeout_s=0.2)
    pc.run(5.5, echo)
    assert pc.codes[0] == 41822


def test_restart():
    pc = Pc(mode="joint", faults={"restart": 1.0})
    pc.run(4.0, echo)
    gaps = [b - a for a, b in pairwise(pc.times)]
    assert max(gaps) == pytest.approx(2.0, abs=0.02)
    again = gaps.index(max(gaps)) + 1
    assert pc.received[again].header.seqno == 0
    assert pc.received[again].header.tm_ms < 100
    assert pc.core.port_changes == 1
    assert pc.last.mci_state == MCIState.RUNNING


def test_port_change():
    pc = Pc(mode="joint", faults={"port-change": 0.5})
    pc.run(1.8, echo)
    assert pc.core.port_changes == 3
    assert [m.header.seqno for m in pc.received] == list(range(len(pc.received)))


def test_emergency_stop_and_motors_off():
    for name, code in (("estop", 10013), ("motors-off", 10010)):
        pc = Pc(mode="joint", faults={name: 0.5})
        pc.run(0.6, echo)
        assert pc.codes[0] == code
        assert pc.core.events[0].time_s == pytest.approx(0.5, abs=TS)
        assert pc.last.motor_state == MotorState.OFF
        pc.run(5.0, echo)
        assert pc.last.motor_state == MotorState.OFF


def test_clock_step():
    pc = Pc(mode="joint", faults={"clock-step": -100.0})
    pc.run(3.0, echo)
    steps = [b.feed_back.time_us - a.feed_back.time_us for a, b in pairwise(pc.received)]
    assert min(steps) == pytest.approx(-100e6, rel=1e-3)
    assert sum(s < 0 for s in steps) == 1
    ticks = [b.header.tm_ms - a.header.tm_ms for a, b in pairwise(pc.received)]
    assert set(ticks) == {4, 5} or set(ticks) == {4}


def test_the_command_line_finds_every_switch():
    words = [switch.name for switch in FAULTS]
    faults = parse_faults(words, FAULTS)
    assert set(faults) == set(words)
    with pytest.raises(ScriptError, match="there are: clock-step, delay, drop"):
        parse_faults(["gremlins"], FAULTS)
    message = decode_robot(Pc(faults=faults).core.cycle(0.0))
    assert isinstance(message, EgmRobot)
