"""Core of the spacenavd driver in virtual time: plausibility of data, faults, handshake."""

import struct

import pytest
from hypothesis import given, strategies as st

from cardan.drivers.spnav import SpnavCore, SpnavOptions
from cardan.drivers.spnav.core import (
    HANDSHAKE_TIMEOUT_S,
    MOST_MOTIONS,
    OUT_OF_STEP,
    REPEAT_CHECK_S,
    REPLY_TIMEOUT_S,
    SETTLE_S,
    USUAL_STALE_AFTER_S,
    usual_full_scales,
)
from cardan.protocols.spnav.codes import Code, LedMode
from cardan.protocols.spnav.records import (
    FAILED,
    RECORD_BYTES,
    ConfigChange,
    DeviceChange,
    encode_handshake,
    encode_reply,
)
from cardan.protocols.spnav.streams import Handshake
from cardan.types import ButtonEvent, DeviceLink
from cardan_spnav_server.protocol import (
    ClientReader,
    ClientRequest,
    Sensitivity,
    encode_button,
    encode_config,
    encode_device,
    encode_motion,
)

REST = (0, 0, 0, 0, 0, 0)
PUSH = (0, 0, 175, 0, 0, 0)
"""Half deflection forward."""
FORWARD = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0)
NEUTRAL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
PERIOD_S = 0.016


class Daemon:
    """Daemon of version 0 or 1 with its device, connected to the driver's core."""

    def __init__(
        self, *, version=1, buttons=2, usb_id=(0x046D, 0xC626), led=2, repeat_ms=None, **options
    ):
        self.now_s = 50.0
        self.core = SpnavCore(SpnavOptions(dead_zone=0.0, **options))
        self.version = version
        self.buttons = buttons
        self.usb_id = usb_id
        self.device_type = 0x206 if usb_id else 0x103
        self.led = led
        self.repeat_ms = repeat_ms
        """None: not reported, as by spacenavd 1.1."""
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
        elif isinstance(value, ClientRequest):
            there = self.buttons is not None
            answers = {
                Code.SET_EVMASK: value.data[:1],
                Code.DEV_NBUTTONS: (self.buttons,) if there else None,
                Code.DEV_TYPE: (self.device_type,) if there else None,
                Code.DEV_USBID: self.usb_id if there else None,
                Code.SCFG_LED: value.data[:1],
                Code.GCFG_LED: None if self.led is None else (self.led,),
                Code.GCFG_REPEAT: None if self.repeat_ms is None else (self.repeat_ms,),
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
        return [value.code for value in self.asked if isinstance(value, ClientRequest)]


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
    daemon.now_s += USUAL_STALE_AFTER_S - 0.001
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


def test_unplugging_is_reported_and_neutral_at_once():
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


def test_a_daemons_count_is_no_bound():
    """spacenavd up to 1.3.1 reports 15 buttons for a device with 31."""
    daemon = Daemon(buttons=15)
    daemon.arm()
    daemon.send(encode_button(23, True))
    daemon.exchange()
    assert daemon.state.buttons == {"button-23"}
    assert "button-23" not in daemon.core.labels
    assert daemon.core.further_labels[:9][-1] == "button-23"
    assert set(daemon.core.labels).isdisjoint(daemon.core.further_labels)


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
    daemon.motion(PUSH)  # a device appeared after all
    assert (daemon.state.link, daemon.state.axes) == (DeviceLink.NEEDS_NEUTRAL, NEUTRAL)
    daemon.motion(REST)
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
    assert "20 invalid records" in " ".join(daemon.core.diagnosis(daemon.now_s))


def test_a_stream_out_of_step_is_distinguished_from_a_few_bad_records():
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
    daemon.wait(USUAL_STALE_AFTER_S + 0.01)
    daemon.core.diagnosis(daemon.now_s)
    assert daemon.state.axes == NEUTRAL or daemon.state.link is DeviceLink.LIVE
    if daemon.state.link is DeviceLink.LIVE:  # at rest
        assert daemon.state.axes == NEUTRAL


# -- a daemon that repeats ----------------------------------------------------------------------

FULL = (0, 0, 350, 0, 0, 0)
"""The end stop of an axis, where a device repeats its report."""


def test_a_daemon_that_repeats_is_refused():
    daemon = Daemon(repeat_ms=250)
    assert "repeat-interval = 250" in daemon.core.refusal
    daemon.motion(REST)
    daemon.motion(PUSH)
    state = daemon.state
    assert (state.link, state.axes) == (DeviceLink.LOST, NEUTRAL)
    assert "repeat-interval = -1" in state.reason
    assert "spnavrc" in state.reason


def test_a_daemon_that_begins_to_repeat_in_a_session_is_refused():
    daemon = Daemon(repeat_ms=-1)
    assert daemon.core.refusal == ""
    asked = daemon.codes().count(Code.GCFG_REPEAT)
    for _ in range(7):
        daemon.wait(0.5 * REPEAT_CHECK_S)
    assert daemon.codes().count(Code.GCFG_REPEAT) == asked + 3
    daemon.arm()
    daemon.send(encode_button(0, True))
    daemon.motion(PUSH)
    assert daemon.state.axes == FORWARD
    daemon.repeat_ms = 250
    daemon.hold(PUSH, REPEAT_CHECK_S + PERIOD_S)
    state = daemon.state
    assert (state.link, state.axes, state.buttons) == (DeviceLink.LOST, NEUTRAL, frozenset())
    daemon.repeat_ms = -1
    daemon.wait(REPEAT_CHECK_S)
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    daemon.arm()


def test_a_daemon_that_tells_of_a_change_is_asked_at_once():
    daemon = Daemon(repeat_ms=-1)
    daemon.arm()
    daemon.repeat_ms = 0
    daemon.send(encode_config(ConfigChange(Code.SCFG_REPEAT, (0,) * 6)))
    daemon.exchange()
    assert daemon.state.link is DeviceLink.LOST


def test_another_device_of_a_daemon_that_repeats_is_refused_too():
    daemon = Daemon(repeat_ms=16)
    daemon.send(encode_device(DeviceChange(True, 1, 0x20D, 0x256F, 0xC631)))
    daemon.exchange()
    daemon.motion(REST)
    assert daemon.state.link is DeviceLink.LOST
    assert "repeat-interval = 16" in daemon.state.reason


def test_a_daemon_that_cannot_tell_is_not_asked_again():
    daemon = Daemon()
    daemon.asked.clear()
    daemon.wait(10.0)
    assert daemon.codes() == []


def repeat(daemon, counts, period_s, duration_s):
    """Send `counts` periodically, like a daemon that repeats them."""
    for _ in range(round(duration_s / period_s)):
        daemon.now_s += period_s
        daemon.motion(counts)


@pytest.mark.matrix(
    *(f"{ids}-60.0" for ids in ("0-6e-05", "0-0.0011", "1-0.0003", "1-0.002")),
    *(f"{ids}-0.0" for ids in ("0-0.0003", "0-0.002", "1-6e-05", "1-0.0011")),
)
@pytest.mark.parametrize("held_s", [0.0, 60.0])
@pytest.mark.parametrize("period_s", [60e-6, 300e-6, 1.1e-3, 2e-3])
@pytest.mark.parametrize("version", [0, 1])
def test_a_dead_device_behind_a_daemon_that_repeats_is_stale_in_time(version, period_s, held_s):
    daemon = Daemon(version=version)
    daemon.arm()
    daemon.send(encode_button(0, True))
    daemon.hold(PUSH, held_s + PERIOD_S)
    last_s = daemon.now_s
    repeat(daemon, PUSH, period_s, USUAL_STALE_AFTER_S - 0.005)
    assert daemon.state.axes == FORWARD
    repeat(daemon, PUSH, period_s, 0.01)
    state = daemon.state
    assert daemon.now_s < last_s + 0.11
    assert (state.link, state.axes, state.buttons) == (DeviceLink.STALE, NEUTRAL, frozenset())
    assert "repeat-interval" in state.reason
    repeat(daemon, PUSH, period_s, 1.0)
    assert daemon.state.link is DeviceLink.STALE
    metrics = daemon.core.metrics(daemon.now_s)
    assert metrics["silences"] == 1
    assert metrics["repeats"] <= round((USUAL_STALE_AFTER_S + 1.005) / period_s)
    assert metrics["motion_age_s"] > 1.0
    assert "repeated by itself" in " ".join(daemon.core.diagnosis(daemon.now_s))


def test_a_dead_device_whose_daemon_is_read_in_pieces_is_stale_in_time():
    """The reader may get the repeats of a daemon in a burst, after a pause."""
    daemon = Daemon()
    daemon.arm()
    daemon.motion(PUSH)
    for _ in range(9):
        daemon.wait(0.02)
        daemon.send(encode_motion(PUSH, 0) * 60)
    assert daemon.state.link is DeviceLink.STALE


def test_a_device_that_lives_on_counts_again_once_it_was_at_rest():
    daemon = Daemon()
    daemon.arm()
    daemon.motion(PUSH)
    repeat(daemon, PUSH, 0.001, 1.0)
    daemon.motion(FULL)
    assert daemon.state.link is DeviceLink.NEEDS_NEUTRAL
    assert daemon.state.axes == NEUTRAL
    daemon.wait(SETTLE_S)
    daemon.motion(REST)
    assert daemon.state.link is DeviceLink.LIVE
    daemon.motion(PUSH)
    assert daemon.state.axes == FORWARD


def test_a_hand_that_moves_counts_though_the_daemon_repeats():
    daemon = Daemon()
    daemon.arm()
    for step in range(100):
        daemon.motion((0, 0, 175 + step % 2, 0, 0, 0))
        repeat(daemon, (0, 0, 175 + step % 2, 0, 0, 0), 0.001, 0.06)
        assert daemon.state.link is DeviceLink.LIVE


@pytest.mark.parametrize("period_s", [0.008, 0.016, 0.06])
def test_a_device_held_at_its_stop_is_not_taken_for_a_repeat(period_s):
    daemon = Daemon()
    daemon.arm()
    for _ in range(round(60.0 / period_s)):
        daemon.wait(period_s)
        daemon.motion(FULL)
        assert daemon.state.axes == (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert daemon.core.metrics(daemon.now_s)["repeats"] == 0


@pytest.mark.parametrize("held_up_s", [0.04, 0.095])
def test_motions_that_were_held_up_are_not_taken_for_repeats(held_up_s):
    """A busy computer delivers the reports of a device in repeated bursts."""
    daemon = Daemon()
    daemon.arm()
    daemon.motion(FULL)
    sent = 0
    for burst in range(1, 200):
        daemon.wait(held_up_s)
        due = int(burst * held_up_s / 0.008)
        daemon.send(encode_motion(FULL, 8) * (due - sent))
        sent = due
        assert daemon.state.link is DeviceLink.LIVE
    assert daemon.core.metrics(daemon.now_s)["repeats"] == 0


# -- serial devices -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("device_type", "name"), [(0x103, "Magellan SpaceMouse"), (0x102, "Spaceball 4000 FLX")]
)
def test_a_serial_device_behind_the_daemon_is_reported_with_the_way_out(device_type, name):
    daemon = Daemon(usb_id=None)
    daemon.device_type = device_type
    daemon.reopen()
    words = " ".join(daemon.core.diagnosis(daemon.now_s))
    assert name in words
    assert 'driver = "spacemouse_serial"' in words
    assert "install the plug-in cardan-serial-mice" in words
    assert daemon.core.device_name == name
    daemon.arm()
    daemon.motion(PUSH)
    daemon.wait(0.11)
    assert "steady" in daemon.state.reason


def test_a_usb_device_is_not_asked_to_be_read_at_a_serial_port():
    daemon = Daemon()
    assert "serial" not in " ".join(daemon.core.diagnosis(daemon.now_s))
    assert daemon.core.device_name == "SpaceNavigator"


@pytest.mark.parametrize("repeats", [False, True])
def test_a_longer_silence_may_be_allowed_and_is_said(repeats):
    daemon = Daemon(stale_after_s=0.5)
    assert "stale_after_s = 0.5" in " ".join(daemon.core.diagnosis(daemon.now_s))
    daemon.arm()
    daemon.motion(PUSH)
    if repeats:
        repeat(daemon, PUSH, 0.001, 0.49)
    else:
        daemon.wait(0.49)
    assert daemon.state.axes == FORWARD
    daemon.wait(0.011)
    assert daemon.state.link is DeviceLink.STALE
    assert "0.5 s" in daemon.state.reason


def test_what_was_held_up_within_a_longer_silence_is_no_repeat():
    daemon = Daemon(stale_after_s=0.5)
    daemon.arm()
    daemon.motion(FULL)
    for _ in range(20):
        daemon.wait(0.48)
        daemon.send(encode_motion(FULL, 8) * 60)
        assert daemon.state.link is DeviceLink.LIVE


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
    assert "version 0" not in " ".join(daemon.core.diagnosis(daemon.now_s))
    daemon.send(encode_handshake(0))
    assert daemon.core.version == 1
    assert daemon.core.metrics(daemon.now_s)["unasked_replies"] == 1
    assert daemon.core.labels[-1] == "button-14"
    assert daemon.core.has_led
    assert daemon.core.full_scale == 500.0
    assert daemon.codes()[:2] == [Code.SET_NAME, Code.SET_EVMASK]
    daemon.core.on_opened(daemon.now_s)
    daemon.send(encode_handshake(2))
    assert daemon.core.version == 1, "a newer daemon speaks it, too"


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
    assert daemon.reader.version == 1  # valid: our sensitivity is the start of a request
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
        ({"stale_after_s": 0.05}, "stale_after_s: 0.05 is not allowed"),
        ({"stale_after_s": 1.5}, "stale_after_s: 1.5 is not allowed"),
        ({"full_scale": float("nan")}, "full_scale: nan is not allowed"),
        ({"dead_zone": 1.0}, "dead_zone: 1.0 is not allowed"),
        ({"socket": "a\0b"}, "socket: .* is not allowed"),
    ],
)
def test_options_name_what_is_wrong(options, words):
    with pytest.raises(ValueError, match=words):
        SpnavOptions(**options)


def test_of_motions_that_waited_the_newest_count():
    daemon = Daemon()
    daemon.send(encode_motion(REST, 16))
    before = daemon.core.metrics(daemon.now_s)["superseded"]
    waited = b"".join(encode_motion((0, 0, 100 + n % 50, 0, 0, 0), 16) for n in range(5000))
    daemon.send(waited + encode_button(1, True) + encode_motion(PUSH, 16))
    assert daemon.core.state(daemon.now_s).axes == FORWARD
    assert daemon.core.metrics(daemon.now_s)["superseded"] == before + 5000 - MOST_MOTIONS
    assert daemon.core.state(daemon.now_s).buttons == {"button-1"}
