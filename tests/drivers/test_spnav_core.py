"""What the driver makes of a spacenavd socket, in virtual time: trust, faults, handshake."""

import struct

import pytest
from hypothesis import given, strategies as st

from cardan.drivers.spnav import SpnavCore, SpnavOptions
from cardan.drivers.spnav.core import (
    HANDSHAKE_TIMEOUT_S,
    OUT_OF_STEP,
    REPLY_TIMEOUT_S,
    SETTLE_S,
    STALE_AFTER_S,
    usual_full_scales,
)
from cardan.protocols.spnav import (
    FAILED,
    RECORD_BYTES,
    ClientReader,
    Code,
    DeviceChange,
    Handshake,
    LedMode,
    Request,
    Sensitivity,
    encode_button,
    encode_device,
    encode_handshake,
    encode_motion,
    encode_reply,
)
from cardan.types import ButtonEvent, DeviceLink

REST = (0, 0, 0, 0, 0, 0)
PUSH = (0, 0, 175, 0, 0, 0)
"""Half of the way forward."""
FORWARD = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
NEUTRAL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PERIOD_S = 0.016


class Daemon:
    """A daemon of version 0 or 1, its device, and the driver's core at the other end."""

    def __init__(self, *, version=1, buttons=2, usb_id=(0x046D, 0xC626), led=2, **options):
        self.now_s = 50.0
        self.core = SpnavCore(SpnavOptions(dead_zone=0.0, **options))
        self.version = version
        self.buttons = buttons
        self.usb_id = usb_id
        self.device_type = 0x206 if usb_id else 0x103
        self.led = led
        self.answers = True
        self.asked = []
        self.reopen()

    def reopen(self):
        self.reader = ClientReader(self.version)
        self.core.on_opened(self.now_s)
        self.exchange()

    def exchange(self):
        while output := self.core.outgoing():
            for piece in output:
                for value in self.reader.feed(piece):
                    self.asked.append(value)
                    if self.answers:
                        self.answer(value)

    def answer(self, value):
        if isinstance(value, Handshake):
            self.send(encode_handshake(value.version))
        elif isinstance(value, Request):
            there = self.buttons is not None
            answers = {
                Code.SET_EVMASK: value.data[:1],
                Code.DEV_NBUTTONS: (self.buttons,) if there else None,
                Code.DEV_TYPE: (self.device_type,) if there else None,
                Code.DEV_USBID: self.usb_id if there else None,
                Code.SCFG_LED: value.data[:1],
                Code.GCFG_LED: None if self.led is None else (self.led,),
            }
            if value.code != Code.SET_NAME:
                answer = answers.get(value.code)
                status = FAILED if answer is None else 0
                self.send(encode_reply(value.word, answer or (), status))
                if value.code == Code.SCFG_LED:
                    self.led = value.data[0]

    def send(self, data):
        self.core.on_bytes(data, self.now_s)

    def motion(self, counts):
        self.send(encode_motion(counts, 16))

    def hold(self, counts, duration_s):
        for _ in range(round(duration_s / PERIOD_S)):
            self.wait(PERIOD_S)
            self.motion(counts)

    def wait(self, duration_s):
        self.now_s += duration_s
        self.core.on_time(self.now_s)
        self.exchange()

    def arm(self):
        self.motion(REST)
        assert self.state.link is DeviceLink.LIVE
        assert self.state.stamp_s == self.now_s

    @property
    def state(self):
        return self.core.state(self.now_s)

    def codes(self):
        return [value.code for value in self.asked if isinstance(value, Request)]


# -- trust --------------------------------------------------------------------------------------


def test_nothing_counts_before_the_device_was_seen_at_rest():
    daemon = Daemon()
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    daemon.hold(PUSH, 0.5)
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    assert daemon.state.axes == NEUTRAL
    daemon.motion(REST)
    assert daemon.state.link is DeviceLink.LIVE
    daemon.motion(PUSH)
    assert daemon.state.axes == FORWARD
    assert daemon.state.reason == ""


def test_rest_may_be_silent():
    daemon = Daemon()
    daemon.arm()
    daemon.send(encode_button(1, True))
    daemon.wait(3600.0)
    assert daemon.state.link is DeviceLink.LIVE
    assert daemon.state.buttons == {"button-1"}


def test_frame_and_shaping():
    daemon = Daemon(full_scale=500.0)
    daemon.arm()
    daemon.motion((100, 200, 300, 50, 150, 250))
    assert daemon.state.axes == pytest.approx((0.6, -0.2, 0.4, 0.5, -0.1, 0.3))
    daemon = Daemon(rotation=False)
    daemon.arm()
    daemon.motion((0, 0, 350, 0, 0, 350))
    assert daemon.state.axes == (1, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(("shape", "live"), [("axis", True), ("radial", False)])
def test_the_dead_zone_is_rest(shape, live):
    core = SpnavCore(SpnavOptions(dead_zone=0.1, dead_zone_shape=shape))
    core.on_opened(0.0)
    core.on_bytes(encode_motion((30, 30, 30, 0, 0, 0), 0), 0.0)
    assert (core.state(0.0).link is DeviceLink.LIVE) is live


# -- faults -------------------------------------------------------------------------------------


def test_silence_while_deflected_is_neutral_within_100_ms():
    daemon = Daemon()
    daemon.arm()
    daemon.send(encode_button(0, True))
    daemon.hold(PUSH, 0.2)
    assert daemon.state.axes == FORWARD
    daemon.now_s += STALE_AFTER_S - 0.001
    assert daemon.state.axes == FORWARD
    daemon.now_s += 0.0011
    state = daemon.state
    assert (state.link, state.axes, state.buttons) == (DeviceLink.STALE, NEUTRAL, frozenset())
    assert "no motion" in state.reason
    assert daemon.core.events()[-1] == ButtonEvent(daemon.now_s, "button-0", False)
    assert daemon.core.metrics(daemon.now_s)["silences"] == 1


def test_a_device_as_slow_as_60_ms_is_not_silent():
    daemon = Daemon()
    daemon.arm()
    for _ in range(20):
        daemon.wait(0.06)
        daemon.motion(PUSH)
        assert daemon.state.axes == FORWARD


def test_after_a_silence_the_cap_has_to_be_let_go():
    daemon = Daemon()
    daemon.arm()
    daemon.motion(PUSH)
    daemon.wait(1.0)
    daemon.hold(PUSH, 0.5)
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    assert daemon.state.axes == NEUTRAL
    daemon.motion(REST)
    assert daemon.state.link is DeviceLink.LIVE
    daemon.motion(PUSH)
    assert daemon.state.axes == FORWARD


def test_a_rest_that_had_queued_up_meanwhile_does_not_arm():
    daemon = Daemon()
    daemon.arm()
    daemon.motion(PUSH)
    daemon.wait(1.0)
    for counts in (PUSH, REST, PUSH):
        daemon.motion(counts)
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    assert daemon.state.axes == NEUTRAL


def test_the_single_zero_of_a_release_arms_once_nothing_follows_it():
    daemon = Daemon()
    daemon.arm()
    daemon.motion(PUSH)
    daemon.wait(1.0)
    daemon.motion(REST)
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    daemon.wait(SETTLE_S)
    assert daemon.state.link is DeviceLink.LIVE


def test_a_silence_is_noticed_though_nobody_asks_for_the_state():
    daemon = Daemon()
    daemon.arm()
    daemon.motion(PUSH)
    daemon.wait(1.0)
    daemon.motion(PUSH)
    assert daemon.core.metrics(daemon.now_s)["silences"] == 1
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL


@pytest.mark.parametrize("kind", ["lost", "closed"])
def test_the_end_is_neutral_at_once(kind):
    daemon = Daemon()
    daemon.arm()
    daemon.send(encode_button(0, True))
    daemon.motion(PUSH)
    if kind == "lost":
        daemon.core.on_lost("the daemon closed the connection", daemon.now_s)
    else:
        daemon.core.on_closed(daemon.now_s)
    state = daemon.state
    assert state.link is (DeviceLink.LOST if kind == "lost" else DeviceLink.CLOSED)
    assert (state.axes, state.buttons) == (NEUTRAL, frozenset())
    daemon.motion(PUSH)  # late bytes
    assert daemon.state.axes == NEUTRAL
    daemon.reopen()
    daemon.motion(PUSH)
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    assert [event.pressed for event in daemon.core.events()] == [True, False]


def test_unplugging_is_told_and_neutral_at_once():
    daemon = Daemon()
    daemon.arm()
    daemon.send(encode_button(0, True))
    daemon.motion(PUSH)
    daemon.buttons = None
    daemon.send(encode_device(DeviceChange(False, 0, 0x206, 0x046D, 0xC626)))
    state = daemon.state
    assert (state.link, state.axes, state.buttons) == (DeviceLink.LOST, NEUTRAL, frozenset())
    assert "unplugged" in state.reason
    daemon.exchange()
    assert daemon.state.link is DeviceLink.LOST
    daemon.buttons = 15
    daemon.send(encode_device(DeviceChange(True, 1, 0x20D, 0x256F, 0xC631)))
    daemon.usb_id = (0x256F, 0xC631)
    daemon.exchange()
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    assert len(daemon.core.labels) == 15
    assert daemon.core.full_scale == 500.0
    daemon.motion((0, 0, 250, 0, 0, 0))
    assert daemon.state.axes == NEUTRAL
    daemon.motion(REST)
    daemon.motion((0, 0, 250, 0, 0, 0))
    assert daemon.state.axes == FORWARD


def test_a_device_that_shows_more_buttons_goes_on():
    daemon = Daemon(buttons=0)
    daemon.arm()
    daemon.motion(PUSH)
    daemon.buttons = 2
    daemon.send(encode_device(DeviceChange(True, 0, 0x206, 0x046D, 0xC626)))
    daemon.send(encode_button(1, True))
    daemon.exchange()
    assert daemon.core.labels == ("button-0", "button-1")
    state = daemon.state
    assert (state.link, state.axes) == (DeviceLink.LIVE, FORWARD)
    assert state.buttons == {"button-1"}


def test_another_device_beside_the_first_has_to_come_to_rest():
    daemon = Daemon()
    daemon.arm()
    daemon.motion(PUSH)
    daemon.send(encode_device(DeviceChange(True, 1, 0x20D, 0x256F, 0xC631)))
    state = daemon.state
    assert (state.link, state.axes) == (DeviceLink.NEEDS_NEUTRAL, NEUTRAL)


def test_one_of_two_devices_unplugged_leaves_the_other():
    daemon = Daemon()
    daemon.arm()
    daemon.send(encode_device(DeviceChange(False, 1, 0x206, 0x046D, 0xC626)))
    assert daemon.state.link is DeviceLink.LOST
    daemon.exchange()
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL


def test_a_daemon_without_a_device_says_so():
    daemon = Daemon(buttons=None)
    assert daemon.state.link is DeviceLink.LOST
    assert "no device" in daemon.state.reason
    daemon.motion(REST)  # it has one after all
    assert daemon.state.link is DeviceLink.LIVE


@pytest.mark.parametrize(
    "garbage",
    [
        struct.pack("=8i", 99, 0, 0, 0, 0, 0, 0, 0),
        struct.pack("=8i", 1, 4000, 1, 0, 0, 0, 0, 0),
        b"\xff" * RECORD_BYTES,
    ],
)
def test_garbled_records_change_nothing_and_do_not_keep_it_alive(garbage):
    daemon = Daemon()
    daemon.arm()
    daemon.motion(PUSH)
    for _ in range(20):
        daemon.wait(0.01)
        daemon.send(garbage)
    state = daemon.state
    assert (state.link, state.axes, state.buttons) == (DeviceLink.STALE, NEUTRAL, frozenset())
    assert daemon.core.metrics(daemon.now_s)["malformed_records"] == 20
    assert "20 records" in " ".join(daemon.core.diagnosis(daemon.now_s))


def test_a_stream_out_of_step_is_told_from_a_few_bad_records():
    daemon = Daemon()
    daemon.send(b"\xff" * RECORD_BYTES * (OUT_OF_STEP - 1))
    daemon.motion(REST)
    daemon.send(b"\xff" * RECORD_BYTES * (OUT_OF_STEP - 1))
    assert not daemon.core.out_of_step
    daemon.send(b"\xff" * RECORD_BYTES)
    assert daemon.core.out_of_step
    daemon.reopen()
    assert not daemon.core.out_of_step


def test_half_a_record_is_no_motion():
    daemon = Daemon()
    daemon.arm()
    record = encode_motion(PUSH, 16)
    daemon.send(record[:20])
    assert daemon.state.axes == NEUTRAL
    daemon.send(record[20:])
    assert daemon.state.axes == FORWARD


@given(st.lists(st.binary(max_size=70), max_size=30), st.sampled_from([0, 1]))
def test_whatever_the_daemon_sends_nothing_is_raised_and_silence_is_neutral(chunks, version):
    daemon = Daemon(version=version)
    daemon.wait(HANDSHAKE_TIMEOUT_S)
    for chunk in chunks:
        daemon.wait(0.01)
        daemon.send(chunk)
        daemon.exchange()
        assert all(-1.0 <= axis <= 1.0 for axis in daemon.state.axes)
    daemon.wait(STALE_AFTER_S + 0.01)
    daemon.core.diagnosis(daemon.now_s)
    assert daemon.state.axes == NEUTRAL or daemon.state.link is DeviceLink.LIVE
    if daemon.state.link is DeviceLink.LIVE:  # at rest
        assert daemon.state.axes == NEUTRAL


# -- buttons ------------------------------------------------------------------------------------


def test_button_edges_keep_their_order():
    daemon = Daemon()
    for number, pressed in ((3, True), (1, True), (3, False), (1, True), (2, False)):
        daemon.send(encode_button(number, pressed))
    assert [(event.button, event.pressed) for event in daemon.core.events()] == [
        ("button-3", True),
        ("button-1", True),
        ("button-3", False),
    ]
    assert daemon.state.buttons == {"button-1"}


# -- handshake and requests ---------------------------------------------------------------------


def test_version_1_asks_what_it_wants_to_know():
    daemon = Daemon(buttons=15, usb_id=(0x256F, 0xC631))
    assert daemon.core.settled
    assert daemon.core.version == 1
    assert daemon.core.labels[-1] == "button-14"
    assert daemon.core.has_led
    assert daemon.core.full_scale == 500.0
    assert daemon.codes()[:2] == [Code.SET_NAME, Code.SET_EVMASK]


def test_an_old_daemon_gets_its_sensitivity_back_after_300_ms():
    daemon = Daemon(version=0)
    daemon.wait(HANDSHAKE_TIMEOUT_S - 0.01)
    assert not daemon.core.settled
    daemon.wait(0.02)
    assert daemon.core.settled
    assert daemon.core.version == 0
    assert daemon.asked[-1] == Sensitivity(1.0)
    assert daemon.core.labels == ()
    assert not daemon.core.has_led
    daemon.arm()
    daemon.motion(PUSH)
    assert daemon.state.axes == FORWARD
    assert "version 0" in " ".join(daemon.core.diagnosis(daemon.now_s))


def test_motion_counts_while_the_handshake_is_under_way():
    daemon = Daemon(version=0)
    daemon.arm()
    daemon.motion(PUSH)
    assert daemon.state.axes == FORWARD


def test_a_daemon_that_answers_late_is_not_put_out_of_step():
    daemon = Daemon()
    daemon.answers = False
    daemon.reopen()
    daemon.wait(HANDSHAKE_TIMEOUT_S)
    assert daemon.core.version == 0
    assert daemon.reader.version == 1  # it is: our sensitivity is the start of a request
    daemon.asked.clear()
    daemon.answers = True
    daemon.send(encode_handshake(1))
    daemon.exchange()
    assert daemon.core.version == 1
    assert daemon.core.settled
    nonsense, *requests = daemon.asked
    assert nonsense.code == 0
    assert requests[0].code == Code.SET_NAME
    assert daemon.core.labels == ("button-0", "button-1")


def test_requests_that_are_not_answered_are_given_up():
    daemon = Daemon()
    daemon.answers = False
    daemon.asked.clear()
    daemon.core.set_led(LedMode.ON, daemon.now_s)
    daemon.exchange()
    daemon.wait(REPLY_TIMEOUT_S + 0.01)
    assert daemon.core.settled
    assert daemon.core.metrics(daemon.now_s)["unanswered_requests"] == 1
    assert "did not answer" in " ".join(daemon.core.diagnosis(daemon.now_s))


def test_answers_nobody_asked_for_are_counted():
    daemon = Daemon()
    daemon.send(encode_reply(0x2003, (99,)))
    assert len(daemon.core.labels) == 2
    assert daemon.core.metrics(daemon.now_s)["unasked_replies"] == 1


def test_the_led_is_put_back_as_it_was_found():
    daemon = Daemon(led=2)
    daemon.core.set_led(LedMode.ON, daemon.now_s)
    daemon.exchange()
    assert daemon.led == 1
    daemon.core.restore_led(daemon.now_s)
    daemon.exchange()
    assert daemon.led == 2
    daemon.core.restore_led(daemon.now_s)
    assert daemon.core.outgoing() == []


def test_no_led_no_request():
    daemon = Daemon(led=None)
    assert not daemon.core.has_led
    daemon.core.set_led(LedMode.ON, daemon.now_s)
    assert daemon.core.outgoing() == []


@pytest.mark.parametrize(
    ("device_type", "vendor_id", "product_id", "full_scales"),
    [
        (0x206, 0x046D, 0xC626, (350.0, 350.0)),
        (0x20D, 0x256F, 0xC631, (500.0, 500.0)),
        (0x20D, 0, 0, (500.0, 500.0)),
        (0x20F, 0, 0, (350.0, 350.0)),
        (0x103, 0, 0, (400.0, 400.0)),
        (0x102, 0, 0, (8000.0, 1600.0)),
        (0, 0, 0, (350.0, 350.0)),
        (0x7777, -1, -1, (350.0, 350.0)),
    ],
)
def test_full_scale_goes_by_the_device(device_type, vendor_id, product_id, full_scales):
    assert usual_full_scales(device_type, vendor_id, product_id) == full_scales


def test_a_spaceball_turns_in_smaller_numbers_than_it_shifts():
    daemon = Daemon(usb_id=None)
    daemon.device_type = 0x102
    daemon.reopen()
    daemon.arm()
    daemon.motion((0, 0, 4000, 0, 0, 800))
    assert daemon.state.axes == (0.5, 0, 0, 0.5, 0, 0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"full_scale": 0.0}, "full_scale: 0.0 is not allowed"),
        ({"full_scale": float("nan")}, "full_scale: nan is not allowed"),
        ({"dead_zone": 1.0}, "dead_zone: 1.0 is not allowed"),
        ({"socket": "a\0b"}, "socket: .* is not allowed"),
    ],
)
def test_options_name_what_is_wrong(options, words):
    with pytest.raises(ValueError, match=words):
        SpnavOptions(**options)
