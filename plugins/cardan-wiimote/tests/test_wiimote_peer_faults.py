"""Every fault of the simulated remote, in virtual time."""

from __future__ import annotations

import pytest

from cardan.errors import ScriptError
from cardan.sim_peers.base import parse_faults
from cardan_wiimote.peer import FAULTS
from cardan_wiimote.protocol import (
    BATTERY_LOW,
    EEPROM,
    Ack,
    CalibrationSource,
    Data,
    DataMode,
    ErrorCode,
    Leds,
    MalformedReport,
    ReadData,
    ReadMemory,
    Status,
    StatusRequest,
    WriteMemory,
    read_accelerometer_calibration,
)
from wiimote_virtual import Host


def with_fault(word: str, **settings: object) -> Host:
    host = Host(faults=parse_faults(word.split(), FAULTS), **settings)
    host.send(DataMode(0x31))
    return host


@pytest.mark.parametrize(
    ("word", "source"),
    [("bad-checksum", CalibrationSource.SECOND), ("no-calibration", CalibrationSource.DEFAULT)],
)
def test_calibration(word, source):
    assert read_accelerometer_calibration(with_fault(word).read(0x16, 20, EEPROM))[1] is source


def test_no_calibration_anywhere():
    host = with_fault("no-calibration", extension="nunchuk", motion_plus=True)
    assert host.read(0xA60020, 32) == b"\xff" * 32
    host.send(WriteMemory(0xA400F0, b"\x55"))
    assert host.read(0xA40020, 16) == b"\xff" * 16


def test_busy():
    host = with_fault("busy=2")
    assert len(host.read(0x16, 10, EEPROM)) == 10
    assert host.send(ReadMemory(0x16, 10, EEPROM)) == [Ack(0, 0x17, ErrorCode.BUSY)]
    assert len(host.read(0x16, 10, EEPROM)) == 10


def test_lost_ack():
    host = with_fault("lost-ack=2")
    answers = [host.send(Leds(i, ack=True)) for i in range(4)]
    assert [bool(answer) for answer in answers] == [True, False, True, False]


def test_slow_memory():
    host = with_fault("slow-memory=0.3")
    assert host.send(ReadMemory(0x16, 20, EEPROM)) == []
    came = [(t, v) for t, v in host.run(1.0) if isinstance(v, ReadData)]
    assert [time_s for time_s, _ in came] == pytest.approx([0.3, 0.31], abs=0.012)
    assert host.send(WriteMemory(0x2A, b"x", EEPROM)) == []
    assert [t for t, v in host.run(1.0) if isinstance(v, Ack)] == pytest.approx([1.3])


def test_silence():
    host = with_fault("silence=1")
    assert len(host.run(1.0)) > 90
    assert host.send(Leds(1)) == host.send(StatusRequest()) == host.run(60.0) == []
    assert host.remote.leds == 0
    assert host.remote.connected


def test_out_of_range_ends_the_link_in_the_end():
    host = with_fault("out-of-range=1 in-range=5")
    host.run(1.0)
    assert host.run(1.9) == []
    assert host.remote.connected
    assert host.run(0.2) == []
    assert not host.remote.connected
    assert not host.remote.reachable
    host.run(2.0)
    assert host.remote.reachable


def test_power_off_and_on():
    host = with_fault("power-off=1 power-on=2")
    host.run(1.01)
    assert not host.remote.connected
    assert not host.remote.reachable
    assert "switched off" in host.remote.log[-1].what
    host.run(1.0)
    assert host.remote.connect(host.now_s)


@pytest.mark.parametrize(
    ("word", "open_ones"),
    [("close-control=1", (False, True)), ("close-interrupt=1", (True, False))],
)
def test_one_channel_closes(word, open_ones):
    host = with_fault(word)
    host.run(1.0)
    assert (host.remote.control_open, host.remote.interrupt_open) == open_ones
    assert bool(host.run(0.5)) is open_ones[1]
    host.remote.disconnect(host.now_s)
    assert host.remote.reachable


def test_battery_low():
    host = with_fault("battery-low=1")
    status = [v for v in host.send(StatusRequest()) if isinstance(v, Status)][-1]
    assert not status.battery_low
    host.run(1.0)
    status = [v for v in host.send(StatusRequest()) if isinstance(v, Status)][-1]
    assert status.battery_low
    assert status.battery < BATTERY_LOW


@pytest.mark.parametrize("extension", ["", "nunchuk"])
def test_hot_plug_in_the_middle_of_a_read(extension):
    host = with_fault("hot-plug", extension=extension)
    host.send(ReadMemory(0x0, 64, EEPROM))
    kinds = [type(value) for _, value in host.run(0.2)]
    assert kinds == [Status, ReadData, ReadData, ReadData]
    assert host.remote.port.connected is not bool(extension)
    host.stream(0x31, 0.05)
    host.send(ReadMemory(0x0, 64, EEPROM))
    assert Status not in [type(value) for _, value in host.run(0.2)]  # once


def test_unplugged_while_it_was_read():
    host = with_fault("hot-plug", extension="nunchuk")
    host.send(WriteMemory(0xA400F0, b"\x55"))
    host.send(ReadMemory(0xA40000, 64))
    last = [v for _, v in host.run(0.2) if isinstance(v, ReadData)][-1]
    assert last == ReadData(0, ErrorCode.NO_DEVICE, 0x10, b"")


def test_stale_mode():
    host = with_fault("stale-mode")
    assert len(host.run(0.1)) > 8
    host.send(StatusRequest())
    assert host.run(1.0) == []
    assert host.stream(0x31, 0.1)


def test_stolen_mode():
    host = with_fault("stolen-mode=1")
    assert len(host.run(0.99)) > 90
    host.send(Leds(1, rumble=True))
    host.run(0.03)
    assert not host.remote.rumble  # Each host sets its own rumble bit.
    assert {value.mode for _, value in host.run(0.5) if isinstance(value, Data)} <= {0x30}
    assert len(host.stream(0x31, 0.5)) > 40
    assert len(host.run(0.5)) < 3


def test_woken_by_1_2():
    host = Host(tr=True, faults={"woken-by-1-2": 1.0})
    assert host.remote.connected
    host.send(Leds(1))
    assert not host.remote.connected
    assert host.remote.leds == 0


def test_short_and_unknown_reports():
    host = with_fault("short-report=5 unknown-id=7")
    values = [value for _, value in host.run(2.0)]
    bad = [value for value in values if isinstance(value, MalformedReport)]
    reasons = {value.reason for value in bad}
    assert reasons == {"too short", "of an unknown id"}
    assert 50 < len(bad) < 90
    assert len(values) > 200


def test_burst():
    host = with_fault("burst=0.2")
    times = [time_s for time_s, _ in host.run(2.0)]
    assert all(not 0.201 < time_s % 0.4 < 0.399 for time_s in times)
    assert len(times) > 150
    assert times == sorted(times)


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("busy=0", "busy: 0 is not in 1"),
        ("in-range=5", "needs the fault out-of-range"),
        ("power-off=5 power-on=4", "at an earlier time"),
        ("nosuch", "no fault 'nosuch'"),
    ],
)
def test_nonsense_is_refused(word, words):
    with pytest.raises(ScriptError, match=words):
        with_fault(word)
