"""Serial devices: driver session and simulated devices in virtual time, then over a port."""

import errno
import os
import termios
import threading
import time
import types

import pytest
from hypothesis import given, settings, strategies as st

from cardan.drivers import reader_thread
from cardan.drivers.spacemouse import SpaceMouseOptions
from cardan.errors import CommandError, DeviceAccessError, DeviceNotFoundError, OptionError
from cardan.types import DeviceFeedback, DeviceLink
from cardan_serial_mice.driver import SpaceMouseSerial, SpaceMouseSerialOptions, port as port_module
from cardan_serial_mice.driver.jumps import JUMP
from cardan_serial_mice.driver.session import DETECT_TIMEOUT_S, SerialSession
from cardan_serial_mice.peer import (
    SerialPuckPeer,
    SerialPuckPeerOptions,
    peer as peer_module,
)
from cardan_serial_mice.protocol import (
    SERIAL_MODELS,
    encode_orb_keys,
    serial_model_by_key,
)
from serial_bench import REST, STEP_S, Bench
from tests.examples import examples
from tests.serving import in_a_thread
from tests.waiting import WITHIN_S, until

pytestmark = pytest.mark.matrix

PATIENCE_S = WITHIN_S
DEFLECTION = (0.4, -0.2, 0.6, -0.1, 0.3, -0.5)
LATE_S = 0.1 + STEP_S
"""Limit for the time from the last good report to neutral."""


MODELS = [model.key for model in SERIAL_MODELS]


def test_of_a_model_that_nobody_knows_the_nearest_is_named():
    with pytest.raises(OptionError, match=r"^model: .*; did you mean 'spaceball-4000'\?$"):
        SpaceMouseSerialOptions(model="spacebal-4000")


@pytest.mark.parametrize("known_model", [True, False])
@pytest.mark.parametrize("key", MODELS)
def test_every_model_is_found_started_and_followed(key, known_model):
    bench = Bench(key, known_model=known_model)
    assert bench.run(3.0).link is DeviceLink.NEEDS_NEUTRAL
    assert bench.session.model.key == key
    assert bench.touch().link is DeviceLink.LIVE
    state = bench.run(1.0, DEFLECTION)
    assert state.link is DeviceLink.LIVE
    assert state.axes == pytest.approx(DEFLECTION, abs=0.0015)
    state = bench.run(6.0, REST)
    assert (state.link, state.axes) == (DeviceLink.LIVE, REST)
    assert bench.core.diagnosis(bench.now_s) == []
    assert bench.failures == []
    assert bench.puck.refused_commands <= 1  # questions to other devices


@pytest.mark.parametrize("key", MODELS)
def test_every_button_is_heard(key):
    bench = Bench(key, known_model=False).live()
    labels = list(bench.puck.model.buttons.values())
    bench.core.events()
    for label in labels:
        bench.puck.press(label)
        assert bench.run(0.1).buttons == {label}
        bench.puck.release(label)
        assert not bench.run(0.1).buttons
    edges = [(event.button, event.pressed) for event in bench.core.events()]
    assert edges == [(label, pressed) for label in labels for pressed in (True, False)]
    assert bench.core.labels == tuple(labels)


def test_a_button_that_is_down_at_the_start_is_heard():
    bench = Bench("magellan")
    bench.puck.press("3")
    assert bench.run(3.0).buttons == {"3"}


def test_a_spaceball_of_an_ambiguous_firmware_is_reported_by_its_keys():
    session = SerialSession(None, 0.0)
    session.receive(b"@1 Spaceball alive and well.\r@2 Firmware version 2.42 created.\r", 0.1)
    assert session.model.key == "spaceball-2003"
    assert session.send(0.1) == b"CB\r"
    session.receive(b"CB@\r", 0.15)
    assert session.send(0.15) == b"P@r@r\r"
    assert session.send(0.39) == b""
    assert session.send(0.41) == b"MSSV\r"  # A missing answer also advances the session.
    session.receive(b"MSSV\r", 0.45)
    assert session.send(0.45) == b"k\r"
    session.receive(b"K@@\r", 0.5)
    assert not session.running
    session.receive(b".`@\r", 0.5)
    assert session.running
    assert session.model.key == "spaceball-4000"


def test_a_spaceball_that_does_not_tell_its_firmware():
    session = SerialSession(None, 0.0)
    session.receive(b"@1 Spaceball alive and well.\r", 0.1)
    session.send(0.4)
    assert session.model is None
    session.send(0.6)
    assert session.model.key == "spaceball-2003"


def test_a_power_loss_starts_a_spaceball_anew():
    bench = Bench("spaceball-2003", faults={"power-loss": 5.0}).live()
    bench.run(1.6, DEFLECTION)
    bench.run(3.0, REST)
    assert bench.states[-1][1].link is DeviceLink.NEEDS_NEUTRAL
    assert bench.touch().link is DeviceLink.LIVE
    assert bench.run(1.0, DEFLECTION).axes == pytest.approx(DEFLECTION, abs=0.002)
    assert bench.failures == []


def test_a_lost_spaceball_packet_does_not_double_the_next():
    bench = Bench("spaceball-2003", faults={"half-packet": 1000.0}).live()
    session = bench.session
    two_periods = b"D\x06\x40" + b"\x00\x00\x10\x00" + b"\x00" * 8 + b"\r"
    (value,) = session.receive(two_periods, bench.now_s)
    assert value.z == -2048
    first = b"D\xff\xff" + b"\x00\x00\x10\x00" + b"\x00" * 8 + b"\r"
    (value,) = session.receive(first, bench.now_s)
    assert value.z == -4096


# -- faults ------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", MODELS)
def test_a_cable_that_is_pulled_at_rest_is_noticed_by_the_questions(key):
    bench = Bench(key).live()
    bench.puck.press(next(iter(bench.puck.model.buttons.values())))
    assert bench.run(0.1).buttons
    pulled_s = bench.now_s
    bench.puck.silence()
    bench.run(4.0)
    assert bench.failures
    at_s, reason = bench.failures[0]
    assert at_s - pulled_s < 3.0
    assert "does not answer any more" in reason
    assert not bench.states[-1][1].buttons
    bench.puck.resume()
    bench.puck.release(next(iter(bench.puck.model.buttons.values())))
    bench.run(7.0)
    assert bench.states[-1][1].link is DeviceLink.NEEDS_NEUTRAL
    assert bench.touch().link is DeviceLink.LIVE


@pytest.mark.parametrize("key", MODELS)
def test_a_lost_zero_packet_sticks_for_no_longer_than_the_rule(key):
    bench = Bench(key, faults={"missing-zero": 1.0})
    bench.run(3.0)
    bench.run(0.5, DEFLECTION)
    let_go_s = bench.now_s
    state = bench.run(1.0, REST)
    assert any(state.link is DeviceLink.STALE for at_s, state in bench.states if at_s > let_go_s)
    assert bench.last_motion_s() <= let_go_s + LATE_S
    # It is unknown whether a Spaceball sends one.
    shows_rest = bench.puck.model.protocol == "spaceball"
    assert state.link is (DeviceLink.LIVE if shows_rest else DeviceLink.STALE)


@pytest.mark.parametrize("fault", ["parity-error", "half-packet", "garbage"])
@pytest.mark.parametrize("key", MODELS)
def test_mangled_packets_never_become_motion(key, fault):
    bench = Bench(key, faults={fault: 4.0})
    bench.run(3.0)
    for _ in range(8):
        bench.run(0.7, DEFLECTION)
        bench.run(0.7, REST)
    moving = {state.axes for _, state in bench.states if any(state.axes)}
    assert moving
    if bench.puck.model.protocol == "spaceball" and fault == "parity-error":
        # The packets have no checksum: a wrong bit changes them, but by no more than a hand may.
        for axes in moving:
            for axis, held in zip(axes, DEFLECTION, strict=True):
                assert min(0.0, held) - JUMP <= axis <= max(0.0, held) + JUMP
    else:
        assert all(axes == pytest.approx(DEFLECTION, abs=0.002) for axes in moving)
    assert bench.core.metrics(bench.now_s)["malformed_reports"] > 5
    assert any("ignored" in words for words in bench.core.diagnosis(bench.now_s))


def test_a_stalled_line_does_not_move_late():
    bench = Bench("magellan", faults={"burst": 0.5})
    bench.run(4.0)
    bench.touch()
    start = len(bench.states)
    bench.run(4.0, DEFLECTION)
    states = [state for _, state in bench.states[start:]]
    links = [state.link for state in states]
    if DeviceLink.STALE in links:
        assert not any(any(state.axes) for state in states[links.index(DeviceLink.STALE) :])


@pytest.mark.parametrize("key", MODELS)
@pytest.mark.parametrize("fault", ["mute", "deaf"])
def test_what_does_not_answer_is_given_up(key, fault):
    bench = Bench(key, faults={fault: 1.0}, known_model=False)
    bench.run(DETECT_TIMEOUT_S + 0.2)
    if fault == "deaf" and key == "spaceorb":
        assert bench.failures == []  # no question is needed
        return
    if fault == "deaf" and key.startswith("spaceball-") and not key.endswith("5000"):
        bench.run(1.0)  # the device greets and then accepts no command
        assert "does not answer any more" in bench.failures[0][1]
        return
    assert "no serial device answers" in bench.failures[0][1]
    assert bench.states[-1][1].link is not DeviceLink.LIVE


def test_another_device_than_the_one_said_to_be_there():
    bench = Bench("magellan")
    bench.known_model = serial_model_by_key("spaceorb")
    bench.run(DETECT_TIMEOUT_S + 0.2)
    assert "no SpaceOrb 360 answers" in bench.failures[0][1]


BANNER = b"\x11\r@1 Spaceball alive.\r@2 Firmware version 2.%d created.\r"
GREETINGS = {
    "magellan": b"v MAGELLAN\r",
    "spaceball-5000": b"v SPACEBALL\r",
    "spaceball-2003": BANNER % 15,
    "spaceball-3003": BANNER % 63,
    "spaceball-4000": BANNER % 43,
    "spaceorb": encode_orb_keys(100, 0),
}


@settings(max_examples=examples(40))
@given(data=st.lists(st.binary(max_size=60), max_size=20), key=st.sampled_from([None, *MODELS]))
def test_noise_never_raises(data, key):
    session = SerialSession(serial_model_by_key(key) if key else None, 0.0)
    session.receive(GREETINGS.get(key, b""), 0.0)
    assert (session.model is not None) is (key is not None)
    for index, noise in enumerate(data):
        session.receive(noise, 0.1 * index)
        session.send(0.1 * index)
        session.failure(0.1 * index)


# -- keys --------------------------------------------------------------------------------------

ASKED = [key for key in MODELS if key != "spaceorb"]
HEARD_AGAIN_S = 0.25
"""Time within which a lost release is recovered; the remainder is the simulated line's."""


def first_of(bench):
    return next(iter(bench.puck.model.buttons.values()))


def moving_with_a_key(key, **more):
    """A device that is deflected with its first key down."""
    bench = Bench(key, **more).live()
    bench.puck.press(first_of(bench))
    state = bench.run(0.3, DEFLECTION)
    assert state.buttons == {first_of(bench)}
    return bench


def spoil_keys(bench, spoil, packets=1):
    """Let `spoil` change the next key packets on the line."""
    line = bench.puck._line
    carry_keys, left = line.carry_keys, [packets]

    def carry(packet, sent_s):
        if left[0]:
            left[0] -= 1
            packet = spoil(packet)
        if packet:
            carry_keys(packet, sent_s)

    line.carry_keys = carry


def lost(packet):
    return b""


def flipped(packet):
    return bytes((packet[0], packet[1] ^ 1)) + packet[2:]


def half(packet):
    return packet[:2]


def like_an_echo(packet):
    return b"c" + packet[1:]


@pytest.mark.parametrize("spoil", [lost, flipped, half, like_an_echo])
@pytest.mark.parametrize("key", ASKED)
def test_a_release_that_is_lost_in_motion_is_heard_by_asking(key, spoil):
    bench = moving_with_a_key(key)
    spoil_keys(bench, spoil)
    bench.puck.release(first_of(bench))
    state = bench.run(HEARD_AGAIN_S)
    assert not state.buttons
    assert not bench.notices
    if spoil is not half:  # which also swallows the next packet
        assert (state.link, state.axes[0]) == (DeviceLink.LIVE, pytest.approx(0.4, abs=0.01))


@pytest.mark.parametrize("key", ASKED)
def test_keys_that_are_not_reported_are_released_and_wait_for_rest(key):
    bench = moving_with_a_key(key)
    label = first_of(bench)
    bench.core.events()
    spoil_keys(bench, lost, packets=1000)
    mute_s = bench.now_s
    state = bench.run(0.45)
    doubts = [(at_s, s) for at_s, s in bench.states if s.link is not DeviceLink.LIVE]
    doubts = [(at_s, s) for at_s, s in doubts if at_s > mute_s]
    assert doubts[0][0] - mute_s <= 0.15 + 0.15 + 2 * STEP_S
    assert "does not say which buttons are down" in doubts[0][1].reason
    assert (state.link, state.axes, state.buttons) == (DeviceLink.NEEDS_NEUTRAL, REST, frozenset())
    assert [event.pressed for event in bench.core.events()] == [False]
    assert any(
        "queries of the buttons without an answer" in words
        for words in bench.core.diagnosis(bench.now_s)
    )
    # Answers are back, and the key has been down all the time: no new press.
    del bench.puck._line.carry_keys
    assert bench.run(1.0, REST).link is DeviceLink.LIVE
    assert not bench.run(1.0).buttons
    bench.puck.release(label)
    bench.run(0.2)
    bench.puck.press(label)
    assert bench.run(0.2).buttons == {label}


@pytest.mark.parametrize("key", ASKED)
def test_questions_in_motion_are_few_and_short(key):
    bench = moving_with_a_key(key)
    sent = []
    receive = bench.puck.receive
    bench.puck.receive = lambda data: (sent.append((bench.now_s, data)), receive(data))
    bench.run(2.0)
    assert 13 <= len(sent) <= 17
    assert max(len(words) for _, words in sent) <= 5
    bench.puck.release(first_of(bench))
    bench.run(0.2)
    sent.clear()
    bench.run(2.0)
    assert sent == []  # No key is down: motion is enough as a sign of life.


@pytest.mark.parametrize("fault", ["key-lost", "key-parity", "key-half", "key-garbage"])
@pytest.mark.parametrize("key", MODELS)
def test_with_a_bad_line_a_release_is_late_but_never_lost(key, fault):
    bench = Bench(key, faults={fault: 2.0}).live()
    label = first_of(bench)
    bench.run(0.3, DEFLECTION)
    for _ in range(6):
        bench.puck.press(label)
        bench.run(0.5)
        bench.puck.release(label)
        # Every second packet is damaged, so the next one is good, or the keys count as released.
        bench.run(0.45)
        assert label not in bench.run(0.04).buttons


@pytest.mark.parametrize("key", MODELS)
def test_a_key_that_stays_down_through_an_outage_is_pressed_anew_only_by_a_hand(key):
    bench = moving_with_a_key(key)
    bench.puck.silence()
    bench.run(0.3)
    bench.puck.resume()
    bench.run(0.3)
    assert bench.run(3.0, REST).link is DeviceLink.LIVE
    bench.puck.press(list(bench.puck.model.buttons.values())[1])
    assert first_of(bench) not in bench.run(1.0).buttons
    bench.puck.unplug()
    bench.run(0.1)
    bench.puck.replug()
    bench.run(5.0)
    assert bench.touch().link is DeviceLink.LIVE
    assert not bench.states[-1][1].buttons
    bench.puck.release(first_of(bench))
    bench.run(0.3)
    bench.puck.press(first_of(bench))
    assert bench.run(0.3).buttons == {first_of(bench)}


# -- power -------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", MODELS)
def test_a_resting_device_that_lost_its_power_has_to_be_seen_at_rest(key):
    bench = Bench(key, faults={"power-loss": 8.0}).live()
    bench.run(8.2 - bench.now_s, REST)
    # The device takes the position held during its start for rest.
    bench.run(2.0, (0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    bench.run(3.0, REST)
    after = [state for at_s, state in bench.states if at_s > 8.0]
    assert not any(any(state.axes) for state in after)
    reasons = [state.reason for state in after if state.link is DeviceLink.LOST]
    assert all("has lost its power for a moment" in reason for reason in reasons)
    assert after[-1].link is DeviceLink.NEEDS_NEUTRAL
    assert bench.failures == []
    assert [type(notice).__name__ for _, notice in bench.notices] == ["Lapse", "Restart"]


@pytest.mark.parametrize("key", MODELS)
def test_after_a_power_loss_it_has_its_settings_again(key):
    bench = Bench(key, faults={"power-loss": 8.0}).live()
    bench.run(12.0 - bench.now_s, REST)
    assert bench.touch().link is DeviceLink.LIVE
    assert bench.run(1.0, DEFLECTION).axes == pytest.approx(DEFLECTION, abs=0.002)
    bench.puck.press(list(bench.puck.model.buttons.values())[-1])
    assert len(bench.run(0.3).buttons) == 1


def test_a_magellan_whose_settings_are_gone_is_noticed_by_its_motion():
    bench = Bench("magellan").live()
    bench.run(0.3, DEFLECTION)
    bench.puck._start()
    state = bench.run(0.2)
    assert not any(state.axes)
    assert state.link in (DeviceLink.LOST, DeviceLink.NEEDS_NEUTRAL)
    bench.run(1.0)
    assert bench.puck.extended == 3


def test_a_magellan_that_its_user_sets_otherwise_has_not_lost_its_power():
    bench = Bench("magellan").live()
    bench.puck.mode = 2  # translation only, by the device's keys
    bench.run(3.0)
    assert bench.core.state(bench.now_s).link is DeviceLink.LIVE
    assert not bench.notices


def test_answers_that_come_late_do_not_hide_a_power_loss():
    bench = Bench("magellan", faults={"slow-answer": 300.0, "power-loss": 8.0}).live()
    assert not bench.notices
    bench.run(12.0 - bench.now_s, REST)
    assert [type(notice).__name__ for _, notice in bench.notices] == ["Lapse", "Restart"]


# -- signs of life -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "noise"),
    [
        ("magellan", b"b\xff\x00noise\r"),
        ("magellan", b"c\xff\r"),
        ("magellan", b"vnoise\r"),
        ("spaceball-2003", b"Bnoise\r"),
        ("spaceball-2003", b"E\r"),
    ],
)
def test_noise_keeps_no_dead_device_alive(key, noise):
    bench = Bench(key).live()
    session = bench.session
    now_s = bench.now_s
    for _ in range(400):
        now_s += 0.01
        session.send(now_s)
        session.receive(noise, now_s)
    assert "does not answer any more" in session.failure(now_s)
    assert session.notices(now_s) == []


@pytest.mark.parametrize("key", ["spaceball-2003", "spaceball-3003", "spaceball-4000"])
def test_a_spaceball_that_tells_of_no_rest_can_be_used(key):
    bench = Bench(key, faults={"missing-zero": 1.0}).live()
    for _ in range(3):
        assert bench.run(0.5, DEFLECTION).axes == pytest.approx(DEFLECTION, abs=0.002)
        assert bench.run(0.8, REST).link is DeviceLink.LIVE
    # Silence alone proves nothing: the device has to answer.
    bench.run(0.5, DEFLECTION)
    bench.puck.silence()
    assert bench.run(0.8).link is DeviceLink.STALE


# -- over a port -------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def eager_scripts(monkeypatch):
    """The script starts soon after its device."""
    monkeypatch.setattr(peer_module, "SCRIPT_DELAY_S", 0.2)


def peer_at(tmp_path, model, script, **more):
    file = tmp_path / "script"
    file.write_text(script)
    return SerialPuckPeer(
        SerialPuckPeerOptions(
            port=str(tmp_path / "port"), model=model, script=str(file), boot_s=0.02, **more
        )
    )


def mouse_at(peer, **more):
    more = {"dead_zone": 0.0, **more}
    return SpaceMouseSerial(SpaceMouseSerialOptions(path=peer.endpoint, **more))


TOUCH_AND_HOLD = """
    0.1  axes 0 0 0.3 0 0 0
    0.2  neutral
    0.4  axes 0.5 0 0 0 0 0.5
    0.4  press first
    0.7  neutral
    0.7  release first
    0.9  loop
"""


def follow(mouse):
    until(lambda: mouse.state().link is DeviceLink.LIVE)
    there = pytest.approx((0.5, 0.0, 0.0, 0.0, 0.0, 0.5), abs=0.01)
    until(lambda: (state := mouse.state()).axes == there and state.buttons)
    until(lambda: not any((state := mouse.state()).axes) and not state.buttons)
    assert [event.pressed for event in mouse.button_events()][:2] == [True, False]


@pytest.mark.real
@pytest.mark.judged(device="Magellan", transport="pseudo-terminal", by="simulated peer")
def test_a_magellan_from_hand_to_state(tmp_path):
    with in_a_thread(peer_at(tmp_path, "magellan", TOUCH_AND_HOLD)) as peer:
        with mouse_at(peer) as mouse:
            assert mouse.capabilities.buttons[:2] == ("1", "2")
            assert mouse.capabilities.feedback == frozenset()
            with pytest.raises(CommandError, match="has no led feedback"):
                mouse.feedback(DeviceFeedback(led=True))
            follow(mouse)
            with pytest.raises(DeviceAccessError, match="another program has it open"):
                mouse_at(peer).open()
        until(lambda: not peer.device.powered)


@pytest.mark.real
@pytest.mark.judged(
    device="Spaceball 2003, 3003, 4000 FLX", transport="pseudo-terminal", by="simulated peer"
)
def test_a_spaceball_from_hand_to_state(tmp_path):
    with (
        in_a_thread(peer_at(tmp_path, "spaceball-4000", TOUCH_AND_HOLD)) as peer,
        mouse_at(peer) as mouse,
    ):
        assert mouse.capabilities.buttons[-1] == "c"
        follow(mouse)


@pytest.mark.judged(device="SpaceOrb 360", transport="pseudo-terminal", by="simulated peer")
def test_a_spaceorb_that_vanishes_and_comes_back(tmp_path, monkeypatch):
    monkeypatch.setattr(reader_thread, "RETRY_FIRST_S", 0.02)
    script = """
        0.2  axes 0 0 0.4 0 0 0
        0.4  neutral
        0.6  axes 0 0 0.4 0 0 0
        0.9  unplug
        1.1  replug
        2.0  loop
    """
    with in_a_thread(peer_at(tmp_path, "spaceorb", script)) as peer, mouse_at(peer) as mouse:
        until(lambda: mouse.state().axes[2] > 0.3)
        until(lambda: mouse.state().link is DeviceLink.LOST)
        assert mouse.state().axes == REST
        until(lambda: mouse.state().link is DeviceLink.NEEDS_NEUTRAL)
        assert mouse.state().axes == REST


def test_ports_that_are_none(tmp_path):
    path = str(tmp_path / "nothing")
    with pytest.raises(DeviceNotFoundError, match=r"no serial port at .*nothing"):
        SpaceMouseSerial(SpaceMouseSerialOptions(path=path)).open()
    (tmp_path / "nothing").touch()
    with pytest.raises(DeviceAccessError, match=r"cannot open .*it is not a serial port"):
        SpaceMouseSerial(SpaceMouseSerialOptions(path=path)).open()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EACCES, "no permission: add yourself"),
        (errno.EBUSY, "another program has it open"),
        (errno.EIO, "no device is at that port"),
        (errno.EDOM, "Numerical argument"),
    ],
)
def test_why_a_port_cannot_be_opened(monkeypatch, tmp_path, number, words):
    import serial

    def refuse(*_args, **_more):
        raise serial.SerialException(number, os.strerror(number))

    monkeypatch.setattr(serial, "Serial", refuse)
    path = tmp_path / "port"
    path.touch()
    with pytest.raises(DeviceAccessError, match=words):
        SpaceMouseSerial(SpaceMouseSerialOptions(path=str(path))).open()


@pytest.mark.parametrize("number", [errno.EIO, errno.EACCES])
def test_a_port_that_hangs_up_while_it_is_opened(monkeypatch, number):
    master, slave = os.openpty()
    refusals = [termios.error(number, os.strerror(number))]

    def flush(_fd, _queue):
        raise refusals[0]

    monkeypatch.setattr(termios, "tcflush", flush)
    words = {errno.EIO: "no device is at that port", errno.EACCES: "no permission"}[number]
    with pytest.raises(DeviceAccessError, match=words):
        SpaceMouseSerial(SpaceMouseSerialOptions(path=os.ttyname(slave))).open()
    os.close(master)
    os.close(slave)


def test_nothing_answers(tmp_path, monkeypatch):
    monkeypatch.setattr(port_module, "time", fast_clock(20.0))
    peer = peer_at(tmp_path, "magellan", "0 neutral", faults={"mute": 1.0})
    with in_a_thread(peer), pytest.raises(DeviceAccessError, match="no serial device answers"):
        mouse_at(peer).open()


def fast_clock(factor):
    """A clock that runs faster by a factor."""
    start_s = time.monotonic()
    return types.SimpleNamespace(monotonic=lambda: start_s + factor * (time.monotonic() - start_s))


def test_closing_does_not_wait_for_a_device_that_does_not_answer(tmp_path):
    peer = peer_at(tmp_path, "magellan", "0 neutral", faults={"mute": 1.0, "refuse": 0.05})
    with in_a_thread(peer):
        mouse = mouse_at(peer, wait_for_device=True)
        mouse.open()
        until(lambda: peer.device.powered)
        begin_s = time.monotonic()
        mouse.close()
        assert time.monotonic() - begin_s < 1.0
        assert not [t for t in threading.enumerate() if t.name == "cardan-spacemouseserial"]


def test_options_of_serial_devices():
    with pytest.raises(ValueError, match="path: '' is not allowed; it must be the path of the"):
        SpaceMouseSerialOptions(path="")
    with pytest.raises(
        ValueError,
        match="model: 'spacenavigator' is not allowed; it must be empty or one of magellan",
    ):
        SpaceMouseSerialOptions(model="spacenavigator")
    with pytest.raises(ValueError, match="model: 'magellan' is not allowed"):
        SpaceMouseOptions(model="magellan")
    options = SpaceMouseSerialOptions(model="spaceorb")
    assert SpaceMouseSerial(options).capabilities.buttons[0] == "a"
