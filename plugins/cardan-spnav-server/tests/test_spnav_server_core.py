"""Records that programs of spacenavd receive from a device, in virtual time."""

import struct
from itertools import pairwise

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.spnav.codes import MASK_V1, Code, EventMask, LedMode
from cardan.protocols.spnav.records import (
    Button,
    ConfigChange,
    DeviceChange,
    MotionEvent,
    ServerReply,
    encode_handshake,
    encode_request,
    encode_sensitivity,
)
from cardan.protocols.spnav.streams import Handshake, ServerReader
from cardan.protocols.spnav.strings import encode_string
from cardan.types import ButtonEvent, DeviceLink, DeviceState
from cardan_spnav_server import DeviceIdentity, SpnavServerCore, SpnavServerOptions
from cardan_spnav_server.client import QUIET_S, UNREAD_EDGES
from cardan_spnav_server.core import (
    MAX_CLIENTS,
    MOTION_PERIOD_S,
    REPEAT_PERIOD_S,
    STALE_AFTER_S,
)
from cardan_spnav_server.protocol import MASK_V0, StringAssembler, bits_of, float_of

REST = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PUSH = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
AWAY = (0, 0, 175, 0, 0, 0)
"""PUSH in spacenavd's axes."""
TICK_S = 0.004


def device_state(axes=REST, link=DeviceLink.LIVE):
    return DeviceState(0.0, link, axes, frozenset())


class Program:
    """A client of the core, connected by an ideal socket."""

    def __init__(self, bench, *, version=0):
        self.bench = bench
        self.number = bench.core.connect(bench.now_s)
        self.reader = ServerReader()
        self.reads = True
        if version:
            self.send(encode_handshake(version))
            assert self.take() == [Handshake(1)]

    def send(self, data):
        self.bench.core.receive(self.number, data, self.bench.now_s)

    def take(self):
        values = []
        while self.reads and (record := self.bench.core.outgoing(self.number, self.bench.now_s)):
            values += self.reader.feed(record)
            self.bench.core.sent(self.number, len(record))
        return values

    def ask(self, code, *data):
        self.send(encode_request(code, data))
        (reply,) = self.take()
        assert isinstance(reply, ServerReply)
        assert reply.code == code
        return reply


class Bench:
    """The core, a clock, and a device initially at rest."""

    def __init__(self, *buttons, plugged=True, **options):
        self.now_s = 100.0
        self.core = SpnavServerCore(buttons, **options)
        if plugged:
            self.core.offer(device_state(), (), self.now_s)

    def program(self, *, version=0, settled=True):
        program = Program(self, version=version)
        if settled:
            self.now_s += 2 * QUIET_S
            self.core.advance(self.now_s)
            assert program.take() == []
        return program

    def offer(self, axes=REST, *edges, link=DeviceLink.LIVE):
        events = [ButtonEvent(self.now_s, button, pressed) for button, pressed in edges]
        self.core.offer(device_state(axes, link), events, self.now_s)

    def run(self, duration_s, axes=REST, *, link=DeviceLink.LIVE):
        """Offer the same state every 4 ms, like the session's loop."""
        for _ in range(round(duration_s / TICK_S)):
            self.now_s += TICK_S
            self.offer(axes, link=link)

    def run_and_take(self, program, duration_s, axes=REST):
        values = []
        for _ in range(round(duration_s / TICK_S)):
            self.now_s += TICK_S
            self.offer(axes)
            values += [(self.now_s, value) for value in program.take()]
        return values


# -- motion -------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [0, 1])
def test_a_constant_deflection_is_repeated_and_ends_in_one_zero(version):
    bench = Bench()
    program = bench.program(version=version)
    values = bench.run_and_take(program, 0.2, PUSH)
    stamps = [stamp_s for stamp_s, _ in values]
    assert all(value[:6] == AWAY for _, value in values)
    gaps = [b - a for a, b in pairwise(stamps)]
    assert all(MOTION_PERIOD_S <= gap <= REPEAT_PERIOD_S + TICK_S for gap in gaps)
    assert {value.period_ms for _, value in values[1:]} <= {16, 20}
    assert [value[:6] for _, value in bench.run_and_take(program, 0.5)] == [(0,) * 6]


def test_a_changing_deflection_is_sent_every_8_ms():
    bench = Bench()
    program = bench.program()
    motions = 0
    for step in range(100):
        bench.now_s += 0.001
        bench.offer((0.1 + 0.005 * step, 0.0, 0.0, 0.0, 0.0, 0.0))
        motions += len(program.take())
    assert 12 <= motions <= 14


def test_rest_is_silent():
    bench = Bench()
    program = bench.program()
    assert bench.run_and_take(program, 1.0) == []


def test_full_scale_is_what_it_is_asked_to_be():
    bench = Bench(full_scale=500.0)
    program = bench.program()
    bench.offer((0.0, 0.0, 1.0, 0.0, -1.0, 0.0))
    (motion,) = program.take()
    assert motion[:6] == (0, 500, 0, 500, 0, 0)


@pytest.mark.parametrize(
    "link", [DeviceLink.STALE, DeviceLink.NEEDS_NEUTRAL, DeviceLink.LOST, DeviceLink.CLOSED]
)
def test_a_device_that_is_not_live_gives_zero_once(link):
    bench = Bench()
    program = bench.program()
    bench.run_and_take(program, 0.1, PUSH)
    bench.offer(REST, link=link)
    (motion,) = program.take()
    assert motion[:6] == (0,) * 6
    bench.run(0.2, link=link)
    assert program.take() == []


def test_axes_of_a_device_that_is_not_live_do_not_count():
    bench = Bench()
    program = bench.program()
    bench.run(0.1, PUSH, link=DeviceLink.STALE)
    assert program.take() == []


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_numbers_that_are_none_are_rest(bad):
    bench = Bench()
    program = bench.program()
    bench.run_and_take(program, 0.1, PUSH)
    bench.offer((bad, 0.0, 0.0, 0.0, 0.0, 0.0))
    (motion,) = program.take()
    assert motion[:6] == (0,) * 6
    assert bench.core.metrics()["bad_axes"] == 1


def test_a_deflection_that_is_not_offered_any_more_ends():
    bench = Bench("left")
    program = bench.program()
    bench.offer(PUSH, ("left", True))
    bench.run_and_take(program, 0.1, PUSH)
    end_s = bench.now_s + STALE_AFTER_S
    while bench.now_s < end_s - TICK_S:
        bench.now_s += TICK_S
        bench.core.advance(bench.now_s)
        assert all(motion[:6] == AWAY for motion in program.take())
    bench.now_s += 2 * TICK_S
    bench.core.advance(bench.now_s)
    release, motion = program.take()
    assert release == Button(0, False)
    assert motion[:6] == (0,) * 6


# -- buttons ------------------------------------------------------------------------------------


GROWN = DeviceChange(True, 0, 0, 0, 0)
"""Repeated announcement of a device that has more buttons than were known."""


@pytest.mark.parametrize("first", [("left", "right"), ("right", "left")])
def test_left_and_right_of_a_device_that_lists_none_have_the_numbers_0_and_1(first):
    bench = Bench()
    program = bench.program(version=1)
    pressed = []
    for button in (*first, "menu"):
        bench.offer(REST, (button, True))
        pressed += [value for value in program.take() if isinstance(value, Button)]
    assert pressed == [*(Button(int(b == "right"), True) for b in first), Button(2, True)]


@pytest.mark.parametrize(
    ("pressed", "numbers"),
    [
        (("button-7", "button-0"), (7, 0)),
        (("3", "1"), (2, 0)),
        (("trigger", "left"), (2, 0)),
        (("left", "button-0"), (0, 2)),
        (("button-256", "0", "²", "button-"), (2, 3, 4, 5)),
        (("button-255", "trigger"), (255, 0)),
    ],
)
def test_buttons_of_a_device_that_lists_none(pressed, numbers):
    bench = Bench()
    program = bench.program(version=1)
    reported = []
    for button in pressed:
        bench.offer(REST, (button, True), (button, False))
        reported += [v.number for v in program.take() if isinstance(v, Button) and v.pressed]
        assert program.ask(Code.DEV_NBUTTONS).data[0] == max(reported) + 1
    assert tuple(reported) == numbers


def test_a_device_is_reported_again_when_it_has_more_buttons_than_were_known():
    bench = Bench()
    program = bench.program(version=1)
    assert program.ask(Code.DEV_NBUTTONS).data[0] == 0
    bench.offer(REST, ("right", True))
    assert program.take() == [GROWN, Button(1, True)]
    assert program.ask(Code.DEV_NBUTTONS).data[0] == 2
    bench.offer(REST, ("left", True))
    assert program.take() == [Button(0, True)]


def test_buttons_that_nobody_offers_any_more_are_released():
    bench = Bench("left")
    program = bench.program()
    bench.offer(REST, ("left", True))
    assert program.take() == [Button(0, True)]
    bench.now_s += STALE_AFTER_S
    bench.core.advance(bench.now_s)
    assert program.take() == []
    bench.now_s += TICK_S
    bench.core.advance(bench.now_s)
    assert program.take() == [Button(0, False)]
    assert STALE_AFTER_S <= 0.1
    bench.offer(REST)
    bench.offer(REST, ("left", False))
    assert program.take() == []


def test_buttons_have_the_numbers_of_their_order():
    bench = Bench("left", "right")
    program = bench.program()
    bench.offer(REST, ("right", True), ("left", True), ("right", False))
    assert program.take() == [Button(1, True), Button(0, True), Button(1, False)]


def test_a_button_that_was_not_named_gets_the_next_number():
    bench = Bench("left")
    program = bench.program(version=1)
    bench.offer(REST, ("key-77", True))
    assert program.take() == [GROWN, Button(1, True)]
    assert program.ask(Code.DEV_NBUTTONS).data[0] == 2


def test_buttons_that_are_reported_later_follow_in_their_order():
    bench = Bench("left")
    program = bench.program(version=1)
    bench.core.name_buttons(("right", "left", "top"))
    bench.offer(REST, ("top", True))
    assert program.take() == [GROWN, Button(2, True)]
    bench.core.name_buttons([f"key-{n}" for n in range(300)])
    assert program.take() == [GROWN]
    assert program.ask(Code.DEV_NBUTTONS).data[0] == 256
    bench.offer(REST, ("key-299", True))
    assert program.take() == []
    assert bench.core.metrics()["unnumbered_buttons"] == 1


def test_a_device_that_is_gone_holds_no_button():
    bench = Bench("left")
    program = bench.program()
    bench.offer(REST, ("left", True))
    bench.offer(REST, link=DeviceLink.LOST)
    assert program.take() == [Button(0, True), Button(0, False)]


# -- clients that connect, disconnect, and do not read -------------------------------------------


def test_programs_get_the_same_whatever_their_version():
    bench = Bench("left")
    old, new = bench.program(), bench.program(version=1)
    bench.offer(PUSH, ("left", True))
    got = old.take()
    assert got == new.take()
    assert [type(value) for value in got] == [Button, MotionEvent]


def test_nothing_is_sent_to_one_that_is_gone():
    bench = Bench()
    program = bench.program()
    bench.core.disconnect(program.number)
    bench.run(0.1, PUSH)
    assert program.take() == []
    bench.core.receive(program.number, bytes(99), bench.now_s)
    bench.core.disconnect(program.number)


def test_motion_that_is_not_read_becomes_one_and_its_period_all_of_theirs():
    bench = Bench()
    program = bench.program()
    bench.run_and_take(program, 0.1, PUSH)
    start_s = bench.now_s
    program.reads = False
    bench.run(1.0, PUSH)
    bench.run(1.0, REST)
    program.reads = True
    first, *others = program.take()
    assert others == []
    assert first[:6] == (0,) * 6
    assert first.period_ms == pytest.approx(1000 * (1.0 + bench.now_s - start_s - 2.0), abs=25)


def test_edges_that_are_not_read_are_kept_in_order_with_the_motion_between():
    bench = Bench("left")
    program = bench.program()
    program.reads = False
    bench.offer(REST, ("left", True))
    bench.run(0.1, PUSH)
    bench.run(0.1, REST)
    bench.offer(REST, ("left", False))
    bench.run(0.1, PUSH)
    program.reads = True
    press, stop, release, motion = program.take()
    assert (press, release) == (Button(0, True), Button(0, False))
    assert stop[:6] == (0,) * 6
    assert motion[:6] == AWAY


def test_one_that_never_reads_is_given_up_and_others_are_not():
    bench = Bench("left")
    dead, alive = bench.program(), bench.program()
    dead.reads = False
    edges = 0
    for step in range(UNREAD_EDGES + 2):
        bench.offer(REST, ("left", step % 2 == 0))
        edges += len(alive.take())
    assert edges == UNREAD_EDGES + 2
    ((number, reason),) = bench.core.given_up()
    assert number == dead.number
    assert "unread" in reason
    assert bench.core.clients == 1
    assert "did not read" in " ".join(bench.core.diagnosis())
    assert bench.core.given_up() == []


def test_one_that_asks_and_never_reads_is_given_up():
    bench = Bench()
    program = bench.program(version=1)
    program.reads = False
    for _ in range(5000):
        program.send(encode_request(Code.DEV_TYPE))
    ((number, reason),) = bench.core.given_up()
    assert number == program.number
    assert "replies" in reason


def test_too_many_are_turned_away():
    bench = Bench()
    for _ in range(MAX_CLIENTS):
        assert bench.core.connect(bench.now_s) is not None
    assert bench.core.connect(bench.now_s) is None
    assert "programs refused" in " ".join(bench.core.diagnosis())


def test_a_new_program_is_left_in_peace_until_it_has_asked_its_questions():
    bench = Bench("left")
    program = bench.program(version=1, settled=False)
    bench.offer(PUSH, ("left", True))
    for _ in range(5):
        bench.run(0.6 * QUIET_S, PUSH)
        assert program.ask(Code.DEV_NAXES).data[0] == 6
    bench.run(0.6 * QUIET_S, PUSH)
    assert program.take() == []
    bench.run(0.6 * QUIET_S, PUSH)
    assert [type(value) for value in program.take()] == [Button, MotionEvent]
    # From now on answers overtake events and delay none of them.
    bench.run(0.1, PUSH)
    program.send(encode_request(Code.DEV_NAXES))
    assert [type(value) for value in program.take()] == [ServerReply, MotionEvent]


def test_one_that_asks_without_end_gets_its_events_all_the_same():
    bench = Bench()
    program = bench.program(version=1, settled=False)
    kinds = set()
    for _ in range(600):
        bench.run(TICK_S, PUSH)
        program.send(encode_request(Code.DEV_NAXES))
        kinds |= {type(value) for value in program.take()}
    assert kinds == {ServerReply, MotionEvent}


# -- requests -----------------------------------------------------------------------------------


def test_a_newer_program_is_granted_version_1():
    bench = Bench()
    program = Program(bench)
    program.send(encode_handshake(7))
    assert program.take() == [Handshake(1)]


def test_the_device_is_described():
    identity = DeviceIdentity("Wiimote", "/dev/hidraw3", 0x20D, 0x256F, 0xC631)
    program = Bench("a", "b", "c", identity=identity).program(version=1)
    assert program.ask(Code.DEV_NAXES).data[0] == 6
    assert program.ask(Code.DEV_NBUTTONS).data[0] == 3
    assert program.ask(Code.DEV_USBID).data[:2] == (0x256F, 0xC631)
    assert program.ask(Code.DEV_TYPE).data[0] == 0x20D
    assert StringAssembler().take(program.ask(Code.DEV_NAME).data) == "Wiimote"
    assert StringAssembler().take(program.ask(Code.DEV_PATH).data) == "/dev/hidraw3"


def test_a_long_name_comes_in_one_piece_before_any_event():
    bench = Bench(identity=DeviceIdentity("x" * 60))
    program = bench.program(version=1)
    bench.run(0.1, PUSH)
    program.send(encode_request(Code.DEV_NAME))
    assert [type(value) for value in program.take()] == [
        ServerReply,
        ServerReply,
        ServerReply,
        MotionEvent,
    ]


def test_no_usb_id_no_device_no_answer():
    program = Bench().program(version=1)
    assert not program.ask(Code.DEV_USBID).ok
    program = Bench(plugged=False).program(version=1)
    for code in (Code.DEV_NAME, Code.DEV_PATH, Code.DEV_NAXES, Code.DEV_NBUTTONS, Code.DEV_TYPE):
        assert not program.ask(code).ok


@pytest.mark.parametrize("code", [0x0000, 0x1005, 0x2006, 0x301A, 0xFFFF])
def test_unknown_requests_are_refused(code):
    assert not Bench().program(version=1).ask(code, 1, 2, 3).ok


def test_settings_cardan_does_not_have():
    program = Bench().program(version=1)
    assert float_of(program.ask(Code.GCFG_SENS).data[0]) == 1.0
    assert [float_of(word) for word in program.ask(Code.GCFG_SENS_AXIS).data[:6]] == [1.0] * 6
    assert program.ask(Code.GCFG_DEADZONE, 3).data[:2] == (3, 0)
    assert program.ask(Code.GCFG_INVERT).data[:6] == (0,) * 6
    assert program.ask(Code.GCFG_AXISMAP, 4).data[:2] == (4, 4)
    assert program.ask(Code.GCFG_BNMAP, 7).data[:2] == (7, 7)
    assert program.ask(Code.GCFG_BNACTION, 7).data[:2] == (7, 0)
    assert program.ask(Code.GCFG_KBMAP, 7).data[:2] == (7, 0)
    assert program.ask(Code.GCFG_SWAPYZ).data[0] == 0
    assert program.ask(Code.GCFG_GRAB).data[0] == 0
    assert program.ask(Code.GCFG_REPEAT).data[0] == -1
    assert StringAssembler().take(program.ask(Code.GCFG_SERDEV).data) == ""
    for code in (Code.GCFG_DEADZONE, Code.GCFG_AXISMAP, Code.GCFG_BNMAP):
        assert not program.ask(code, -1).ok
    for code in range(Code.SCFG_SENS, Code.SCFG_GRAB + 1, 2):
        assert not program.ask(code, 1).ok
    for code in (Code.SCFG_REPEAT, Code.CFG_SAVE, Code.CFG_RESTORE, Code.CFG_RESET):
        assert not program.ask(code).ok


def test_requests_without_an_answer_get_none():
    program = Bench().program(version=1)
    for code in (Code.SET_NAME, Code.SCFG_SERDEV):
        for record in encode_string(code, "some string that needs two records"):
            program.send(record)
    assert program.take() == []


@pytest.mark.parametrize("version", [0, 1])
def test_each_program_has_its_own_sensitivity(version):
    bench = Bench()
    program, other = bench.program(version=version), bench.program()
    if version:
        assert program.ask(Code.SET_SENS, bits_of(-0.3)).ok
        assert float_of(program.ask(Code.GET_SENS).data[0]) == pytest.approx(-0.3)
    else:
        program.send(encode_sensitivity(-0.3))
    bench.offer(PUSH)
    assert program.take()[0].z == -52  # truncated, not rounded
    assert other.take()[0].z == 175


@pytest.mark.parametrize("word", [0, 0x7FC00000, 0x7F800000, 0x33333333, bits_of(-1.588e-23)])
def test_half_a_double_is_no_sensitivity(word):
    bench = Bench()
    program, old = bench.program(version=1), bench.program()
    assert not program.ask(Code.SET_SENS, word).ok
    old.send(struct.pack("=i", word))
    bench.offer(PUSH)
    assert program.take()[0].z == old.take()[0].z == 175


def test_masks():
    bench = Bench("left", plugged=False)
    program = bench.program(version=1)
    assert program.ask(Code.GET_EVMASK).data[0] == MASK_V1
    assert program.ask(Code.SET_EVMASK, EventMask.BUTTON).ok
    bench.offer(PUSH, ("left", True))
    assert program.take() == [Button(0, True)]
    program.send(encode_request(Code.SET_EVMASK, (EventMask.MOTION,)))
    assert [type(value) for value in program.take()] == [ServerReply, MotionEvent]
    bench.run(0.1, PUSH)
    bench.offer(PUSH, ("left", False))
    assert {type(value) for value in program.take()} == {MotionEvent}


def test_what_ended_while_it_was_left_out_is_reported_once_it_is_asked_for():
    bench = Bench("left", "right", "top")
    program = bench.program(version=1)
    bench.offer(PUSH, ("left", True), ("top", True))
    program.take()
    assert program.ask(Code.SET_EVMASK, EventMask.DEVICE).ok
    bench.run(0.1, REST)
    bench.offer(REST, ("left", False), ("right", True))
    assert program.take() == []
    program.send(encode_request(Code.SET_EVMASK, (MASK_V1,)))
    bench.now_s += 2 * QUIET_S
    reply, motion, *edges = program.take()
    assert reply.ok
    assert motion[:6] == (0,) * 6
    assert edges == [Button(0, False), Button(1, True)]
    program.send(encode_request(Code.SET_EVMASK, (MASK_V1,)))
    assert len(program.take()) == 1  # Nothing was left out.


def test_motion_beyond_32_bits_is_clamped():
    bench = Bench(full_scale=1e6)
    program = bench.program()
    bench.offer(PUSH)
    bench.core._clients[program.number].sensitivity = 1e300
    (motion,) = program.take()
    assert motion.z == 2**31 - 1
    with pytest.raises(ValueError, match="1 to 1000000"):
        SpnavServerCore(full_scale=1e306)


# -- plugging -----------------------------------------------------------------------------------


def test_programs_of_version_1_are_reported_plugging():
    identity = DeviceIdentity("x", "", 0x206, 0x046D, 0xC626)
    bench = Bench(plugged=False, identity=identity)
    new, old = bench.program(version=1), bench.program()
    assert not MASK_V0 & EventMask.DEVICE
    bench.offer(REST, link=DeviceLink.NEEDS_NEUTRAL)
    assert new.take() == [DeviceChange(True, 0, 0x206, 0x046D, 0xC626)]
    bench.run(0.1, PUSH)
    new.take()
    bench.offer(REST, link=DeviceLink.LOST)
    stop, removed = new.take()
    assert stop[:6] == (0,) * 6
    assert removed == DeviceChange(False, 0, 0x206, 0x046D, 0xC626)
    bench.offer(REST)
    assert new.take() == [DeviceChange(True, 1, 0x206, 0x046D, 0xC626)]
    assert {type(value) for value in old.take()} == {MotionEvent}


# -- LED ----------------------------------------------------------------------------------------


def test_programs_may_switch_the_led():
    shown = []
    bench = Bench(on_led=shown.append)
    program = bench.program(version=1)
    assert shown == [True]  # by itself while a program is connected
    program.ask(Code.SET_EVMASK, EventMask.CONFIG)
    assert program.ask(Code.GCFG_LED).data[0] == LedMode.AUTO
    program.send(encode_request(Code.SCFG_LED, (LedMode.OFF,)))
    reply, change = program.take()
    assert reply.ok
    assert change == ConfigChange(Code.GCFG_LED, (LedMode.OFF, 0, 0, 0, 0, 0))
    assert shown == [True, False]
    assert not program.ask(Code.SCFG_LED, 3).ok
    program.send(encode_request(Code.SCFG_LED, (LedMode.AUTO,)))
    bench.core.disconnect(program.number)
    assert shown == [True, False, True, False]


def test_an_led_that_is_not_theirs_is_refused():
    program = Bench().program(version=1)
    assert not program.ask(Code.SCFG_LED, 1).ok
    assert not program.ask(Code.GCFG_LED).ok


# -- invalid data -------------------------------------------------------------------------------


@given(st.lists(st.binary(max_size=100), max_size=20), st.booleans())
def test_whatever_a_program_sends_nothing_is_raised(chunks, shakes_hands):
    bench = Bench()
    program = bench.program(version=int(shakes_hands))
    other = bench.program()
    for chunk in chunks:
        program.send(chunk)
        program.take()
    bench.offer(PUSH)
    assert other.take()[0][:6] == AWAY


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"socket": ""}, "socket: '' is not allowed"),
        ({"socket": "x" * 200}, "up to 107 bytes"),
        ({"access": "friends"}, "it must be one of owner, everybody"),
        ({"full_scale": 0.0}, "full_scale: 0.0 is not allowed"),
        ({"full_scale": float("nan")}, "full_scale: nan is not allowed"),
        ({"full_scale": 1e7}, "1 to 1000000 counts"),
    ],
)
def test_options_name_what_is_wrong(options, words):
    with pytest.raises(ValueError, match=words):
        SpnavServerOptions(**options)
