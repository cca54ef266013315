"""Wrong bits in a serial device's packets never cause a deflection that the hand did not make."""

import itertools

import pytest
from hypothesis import given, settings, strategies as st

from cardan.protocols.connexion.reports import from_robot_axes
from cardan.types import DeviceLink
from cardan_serial_mice.driver import SerialMouseCore, SpaceMouseSerialOptions
from cardan_serial_mice.driver.jumps import JUMP, REST, JumpGuard
from cardan_serial_mice.driver.session import SerialSession, device_model
from cardan_serial_mice.protocol import (
    SERIAL_MODELS,
    SpaceballMotion,
    encode_magellan_motion,
    encode_orb_motion,
    encode_spaceball_motion,
    from_hid_counts,
    serial_model_by_key,
)
from tests.examples import examples

pytestmark = pytest.mark.matrix

MODELS = [model.key for model in SERIAL_MODELS]
SPACEBALLS = [model.key for model in SERIAL_MODELS if model.protocol == "spaceball"]
NEUTRAL = (0.0,) * 6
ROUNDING = 0.005
"""Resolution of the coarsest device, 400 counts."""


def along(count):
    """A packet that moves the first axis."""
    return (count, 0, 0, 0, 0, 0)


def judged(*counts, step=4000):
    """Return the accepted count after each packet (None: nothing new), and the number of garbled
    ones."""
    guard = JumpGuard(step)
    verdicts = [guard.judge(along(count)) for count in counts]
    taken = [verdict.counts and verdict.counts[0] for verdict in verdicts]
    return taken, sum(verdict.garbled for verdict in verdicts)


@pytest.mark.parametrize(
    ("counts", "taken", "garbled"),
    [
        pytest.param((100, 3900, 7000), [100, 3900, 7000], 0, id="a hand"),
        pytest.param((100, 16484, 120), [100, 100, 120], 1, id="one wrong bit"),
        pytest.param((6000, 6100), [None, 6100], 0, id="a bang from rest waits a packet"),
        pytest.param((100, 6000, 12000, 18000, 18000), [100, 100, 6000, 12000, 18000], 0,
                     id="faster than a hand: at most a packet late"),
        pytest.param((7000, 7000, 0), [None, 7000, 0], 0, id="let go"),
        pytest.param((7000, 7000, 200), [None, 7000, 200], 0, id="almost let go"),
        pytest.param((7000, 7000, -3000), [None, 7000, -3000], 0, id="sprung back beyond zero"),
        pytest.param((3000, 16484, 0), [3000, 3000, 0], 1, id="a wrong bit, and let go"),
        pytest.param((3000, 7000, 2904, 7100), [3000, 7000, 2904, 7100], 0,
                     id="a wrong bit that takes away"),
        pytest.param((100, 5000, 21384, 5000), [100, 100, 5000, 5000], 1,
                     id="a wrong bit right after a bang"),
        pytest.param((100, 9000, -9000, 9000, -9000), [100, 100, None, None, None], 3,
                     id="noise ages what was there before"),
    ],
)  # fmt: skip
def test_what_counts(counts, taken, garbled):
    assert judged(*counts) == (taken, garbled)


def test_a_packet_that_was_lost_gives_the_next_two_steps():
    guard = JumpGuard(4000)
    assert guard.judge(along(2000)).counts == along(2000)
    guard.miss()
    assert guard.judge(along(9000)).counts == along(9000)
    assert guard.judge(along(14000)).counts == along(9000)


def test_a_packet_that_cannot_be_is_bridged_once():
    guard = JumpGuard(4000)
    assert guard.refuse() is None  # At rest nothing is bridged.
    guard.judge(along(2000))
    assert guard.refuse() == along(2000)
    assert guard.refuse() is None
    assert guard.judge(along(2100)).counts == along(2100)
    assert guard.judge(along(9000)).counts == along(2100)
    assert guard.refuse() is None
    assert guard.judge(along(9100)).counts == along(9100)


@given(st.lists(st.tuples(*[st.integers(-20000, 20000)] * 6), max_size=12))
def test_what_counts_is_the_newest_packet_or_the_one_before(packets):
    guard = JumpGuard(4000)
    at, now = -1, REST
    for index, packet in enumerate(packets):
        verdict = guard.judge(packet)
        if not any(packet):
            assert verdict.counts == REST
        if verdict.counts is None:
            continue
        # A packet is held at most once: the accepted one is the present or the previous packet.
        recent = {packet: index, **({packets[index - 1]: index - 1} if index else {})}
        held = verdict.counts == now and at == index - 1
        assert held or verdict.counts in recent
        now, at = verdict.counts, recent.get(verdict.counts, at)


# -- whole devices -----------------------------------------------------------------------------

GREETINGS = {
    "magellan": b"v MAGELLAN\r",
    "spaceball": b"@1 Spaceball alive.\r@2 Firmware version 2.15 created.\r",
    "spaceorb": encode_orb_motion(0, REST),
}
ANSWERS = (b"m3\r", b"c33\r", b"q00\r", b"pBB\r", b"k000\r", b"CB@\r", b"P@r@r\r", b"MSSV\r",
           b"K@@\r.`@\r")  # fmt: skip


class Followed:
    """A session and its core, started, live and at rest; packets arrive at each period."""

    def __init__(self, key):
        self.model = model = serial_model_by_key(key)
        self.session = SerialSession(model, 0.0)
        self.core = SerialMouseCore(SpaceMouseSerialOptions(dead_zone=0.0))
        self.now_s = 0.0
        self.session.receive(GREETINGS[model.protocol], 0.0)
        while not self.session.running:
            self.now_s += 0.01
            for line in self.session.send(self.now_s).split(b"\r"):
                answer = next(
                    (a for a in ANSWERS if line and a[:1].lower() == line[:1].lower()), b""
                )
                self.session.receive(answer, self.now_s)
        self.core.on_opened(self.now_s, device_model(model), None, model.period_s)
        self.state = self.hear(self.packet(NEUTRAL))
        assert self.state.link is DeviceLink.LIVE

    def packet(self, axes):
        """Return the device's packet for a cap at `axes`, robot frame."""
        model = self.model
        translation = from_robot_axes(axes, model.full_scale)
        rotation = from_robot_axes(axes, model.rotation_full_scale)
        counts = from_hid_counts(model, (*translation[:3], *rotation[3:]))
        if model.protocol == "magellan":
            return encode_magellan_motion(counts, compressed=True)
        if model.protocol == "spaceorb":
            return encode_orb_motion(0, counts)
        return encode_spaceball_motion(SpaceballMotion(800, *counts))

    def hear(self, data):
        """Feed `data` one period after the previous packet; return the state."""
        self.now_s += self.model.period_s
        for value in self.session.receive(data, self.now_s):
            self.core.on_value(value, self.now_s)
        for notice in self.session.notices(self.now_s):
            self.core.on_notice(notice, self.now_s)
        return self.core.state(self.now_s)


STEP = 0.25
"""Largest change per packet of a fast hand, as a share of full scale."""
steps = st.lists(st.lists(st.floats(-STEP, STEP), min_size=6, max_size=6), min_size=6, max_size=16)


def path_of(hand):
    """Return the deflections of a hand that starts at rest and never jumps."""
    path = [NEUTRAL]
    for step in hand:
        path.append(tuple(max(-1.0, min(1.0, a + b)) for a, b in zip(path[-1], step, strict=True)))
    return path


def between(value, neighbors, margin):
    return min(0.0, *neighbors) - margin <= value <= max(0.0, *neighbors) + margin


@settings(max_examples=examples(150))
@given(hand=steps, key=st.sampled_from(MODELS), data=st.data())
def test_a_wrong_bit_is_no_deflection_and_is_over_with_the_next_packet(hand, key, data):
    path = path_of(hand)
    bench = Followed(key)
    packets = [bench.packet(axes) for axes in path]
    at = data.draw(st.integers(0, len(packets) - 4), label="packet")
    bit = data.draw(st.integers(0, 8 * len(packets[at]) - 1), label="bit")
    spoilt = bytearray(packets[at])
    spoilt[bit // 8] ^= 1 << bit % 8
    packets[at] = bytes(spoilt)
    # A packet without its end swallows the next one.
    over = at + (2 if spoilt[-1] != 0x0D and key != "spaceorb" else 1)
    for index, packet in enumerate(packets):
        state = bench.hear(packet)
        if at <= index < over:
            nearby = path[max(0, at - 1) : over + 1]
            for axis in range(6):
                near = [axes[axis] for axes in nearby]
                assert between(state.axes[axis], near, JUMP + ROUNDING)
        elif any(state.axes):
            assert state.axes == pytest.approx(path[index], abs=ROUNDING)
        else:  # A gap of two packets counts as silence; the hand may also be at rest.
            assert (
                state.link is not DeviceLink.LIVE
                or index <= over
                or not any(abs(axis) > ROUNDING for axis in path[index])
            )


@settings(max_examples=examples(50))
@given(hand=steps, key=st.sampled_from(MODELS))
def test_a_hand_is_followed_packet_by_packet(hand, key):
    bench = Followed(key)
    for axes in path_of(hand):
        state = bench.hear(bench.packet(axes))
        assert state.link is DeviceLink.LIVE
        assert state.axes == pytest.approx(axes, abs=ROUNDING)
    assert bench.hear(bench.packet(NEUTRAL)).axes == NEUTRAL
    assert bench.core.metrics(bench.now_s)["malformed_reports"] == 0


@pytest.mark.parametrize("key", SPACEBALLS)
def test_the_bits_of_a_gentle_push_are_refused_and_reported(key):
    bench = Followed(key)
    push = bench.packet((0.0, 0.0, 0.0125, 0.0, 0.0, 0.0))  # 100 counts
    for _ in range(3):
        state = bench.hear(push)
    for bit in (13, 14, 15):
        count = 100 ^ 1 << bit
        count -= (count & 0x8000) << 1
        spoilt = encode_spaceball_motion(SpaceballMotion(800, 0, count, 0, 0, 0, 0))
        assert bench.hear(spoilt).axes == state.axes
        assert bench.hear(push) == state._replace(stamp_s=bench.now_s)
    assert bench.core.metrics(bench.now_s)["malformed_reports"] == 3
    words = " ".join(bench.core.diagnosis(bench.now_s))
    assert "2 reports far from those around them (id 0x44), ignored" in words
    assert "1 reports beyond what the device can give (id 0x44), ignored" in words


@pytest.mark.parametrize("key", SPACEBALLS)
def test_a_cap_that_is_held_from_the_start_is_not_seen_at_rest(key):
    bench = Followed(key)
    bench.core.on_opened(bench.now_s, device_model(bench.model), None, bench.model.period_s)
    for _ in range(4):
        assert bench.hear(bench.packet((0.9,) * 6)).link is DeviceLink.NEEDS_NEUTRAL


@pytest.mark.parametrize("key", SPACEBALLS)
def test_counts_as_large_as_have_been_seen_are_taken(key):
    bench = Followed(key)
    for count in itertools.chain(range(0, 20001, 4000), [20000] * 3):
        state = bench.hear(encode_spaceball_motion(SpaceballMotion(800, 0, count, 0, 0, 0, 0)))
    assert state.link is DeviceLink.LIVE
    assert state.axes[2] == 1.0
    assert bench.core.metrics(bench.now_s)["malformed_reports"] == 0
