"""The simulated remote in virtual time: reports, memory, extensions, sensors."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, strategies as st

from cardan.errors import OptionError, ScriptError
from cardan_wiimote.peer import SimulatedWiimote
from cardan_wiimote.protocol import (
    EEPROM,
    EXTENSION_IDS,
    EXTENSION_START,
    MOTION_PLUS_START,
    MOTION_PLUS_STOP,
    PASS_NONE,
    PASS_NUNCHUK,
    READ_MOTION_PLUS_ID,
    Ack,
    CalibrationSource,
    Data,
    DataMode,
    ErrorCode,
    Extension,
    Interleaved,
    IrDot,
    IrFormat,
    Leds,
    ReadData,
    ReadMemory,
    Rumble,
    Status,
    StatusRequest,
    Switch,
    WriteMemory,
    button_mask,
    camera_start,
    decode_dots,
    decode_input,
    decode_motion_plus,
    decode_motion_plus_calibration,
    decode_nunchuk,
    decode_nunchuk_calibration,
    decode_nunchuk_pass_through,
    encode_output,
    extension_of,
    join_halves,
    motion_plus_activate,
    read_accelerometer_calibration,
    roll_and_pitch_rad,
    to_g,
    to_operator_axes,
    to_rad_s,
)
from wiimote_virtual import Host, without_data

ID_ADDRESS, PLUS_ID_ADDRESS = 0xA400FA, 0xA600FA


# -- common to all output reports ----------------------------------------------------------------


@pytest.mark.parametrize(
    "report",
    ["10 01", "11 11", "12 05 31", "12 05 77", "15 01", "16 05 00 00 00 00" + " 00" * 16, "17 01"],
)
def test_every_output_report_sets_the_motor_first(report):
    host = Host()
    host.send(bytes.fromhex(report))
    assert host.remote.rumble
    host.send(Rumble(False))
    assert not host.remote.rumble
    assert [entry.what for entry in host.remote.log][-1] == "rumble off"


def test_rubbish_is_ignored_without_an_answer():
    host = Host()
    host.run(0.05)
    for report in (b"", b"\x1b\x00", b"\x12\x04", b"\x12\x04\x38", b"\x11", b"\x16\x00\x00"):
        assert host.send(report) == []
    assert host.remote.ignored_outputs == 6
    assert (host.remote.mode, host.remote.leds) == (0x30, 0)


@pytest.mark.parametrize(
    ("value", "answers"),
    [
        (Rumble(True), []),
        (Leds(5), []),
        (Leds(5, ack=True), [Ack(0, 0x11, 0)]),
        (Switch(0x13, True), []),
        (Switch(0x13, True, ack=True), [Ack(0, 0x13, 0)]),
        (Switch(0x14, True, ack=True), [Ack(0, 0x14, 0)]),
        (Switch(0x19, True, ack=True), [Ack(0, 0x19, 0)]),
        (Switch(0x1A, True, ack=True), [Ack(0, 0x1A, 0)]),
        (StatusRequest(), [Status(0, False, False, False, False, 0, 0xC0)]),
        (DataMode(0x30, ack=True), [Ack(0, 0x12, 0), Data(0x30, 0, None, b"", b"")]),
        (WriteMemory(0x100, b"\x01", EEPROM), [Ack(0, 0x16, 0)]),
    ],
)
def test_acknowledgments(value, answers):
    host = Host()
    host.run(0.05)
    assert host.send(value) == answers


def test_status_shows_leds_and_switches():
    host = Host(extension="nunchuk")
    for value in (Leds(0b1001), Switch(0x13, True), Switch(0x14, True)):
        host.send(value)
    host.remote.press("a")
    (status,) = host.send(StatusRequest())
    assert status == Status(button_mask(["a"]), False, True, True, True, 0b1001, 0xC0)
    assert [entry.what for entry in host.remote.log] == ["connected", "LEDs 1--4"]


# -- the two channels ----------------------------------------------------------------------------


def test_old_and_new_way_to_send():
    remote = SimulatedWiimote()
    remote.connect(0.0)
    assert remote.control(bytes.fromhex("52 11 10"), 0.0) == b"\x00"
    assert remote.leds == 1
    remote.interrupt(bytes.fromhex("a2 11 20"), 0.0)
    assert remote.leds == 2
    remote.interrupt(bytes.fromhex("52 11 40"), 0.0)
    assert remote.control(bytes.fromhex("a2 11 40"), 0.0) == b""
    assert remote.leds == 2
    assert remote.ignored_outputs == 2


def test_tr_obeys_on_the_interrupt_channel_only():
    remote = SimulatedWiimote(tr=True)
    remote.connect(0.0)
    assert remote.control(bytes.fromhex("52 11 10"), 0.0) == b"\x02"
    assert remote.leds == 0
    remote.interrupt(bytes.fromhex("a2 11 10"), 0.0)
    assert remote.leds == 1


def test_a_new_link_begins_afresh():
    host = Host()
    host.send(Leds(15, rumble=True))
    host.send(DataMode(0x31))
    host.remote.disconnect(0.1)
    assert not host.remote.rumble
    assert host.remote.reports(1.0) == []
    host.remote.output(b"\x11\xf0", 1.0)
    assert host.remote.leds == 0
    assert host.remote.connect(1.0)
    assert not host.remote.connect(1.0)  # a host is connected
    assert (host.remote.mode, host.remote.continuous) == (0x30, False)


# -- data ----------------------------------------------------------------------------------------


def test_buttons_only_on_change():
    host = Host()
    assert len(host.run(1.0)) <= 1
    host.remote.press("a")
    host.remote.press("home")
    assert [value for _, value in host.run(0.5)] == [
        Data(0x30, button_mask(["a", "home"]), None, b"", b"")
    ]
    host.remote.release("a")
    host.remote.release("home")
    assert [value.buttons for _, value in host.run(0.5)] == [0]


def test_continuous_reports_come_every_10_ms():
    host = Host()
    host.send(DataMode(0x31))
    times = [time_s for time_s, value in host.run(2.0) if isinstance(value, Data)]
    assert len(times) == pytest.approx(200, abs=1)
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert min(gaps) >= 0.008
    assert max(gaps) <= 0.012
    # Deadlines are absolute: the jitter does not accumulate.
    assert times[-1] - times[0] == pytest.approx(0.01 * (len(times) - 1), abs=0.002)


def test_a_still_remote_is_silent_unless_continuous_and_noise_makes_it_speak():
    assert len(Host().stream(0x31, 1.0, continuous=False)) == 1
    assert len(Host(noise_lsb=1).stream(0x31, 1.0, continuous=False)) > 80


@pytest.mark.parametrize("mode", [0x30, 0x31, 0x32, 0x33, 0x34, 0x35, 0x36, 0x37, 0x3D])
def test_every_mode_is_sent(mode):
    reports = Host(extension="nunchuk", motion_plus=True).stream(mode, 0.1)
    assert len(reports) >= 10
    assert {report.mode for report in reports} == {mode}


@pytest.mark.parametrize("mode", [0x3E, 0x3F])
def test_interleaved_halves_take_turns(mode):
    host = Host()
    host.remote.set_attitude(0.5, -0.3)
    values = host.send(DataMode(mode)) + [value for _, value in host.run(0.2)]
    assert all(isinstance(value, Interleaved) for value in values)
    assert [value.mode for value in values[:4]] == [0x3E, 0x3F, 0x3E, 0x3F]
    whole = host.stream(0x31, 0.05)[0].accelerometer
    assert join_halves(values[0], values[1]).accelerometer == tuple(c & ~3 for c in whole)


def test_reads_suspend_the_data():
    host = Host()
    host.send(DataMode(0x31))
    host.run(0.1)
    first = host.send(ReadMemory(0x0, 64, EEPROM))
    assert [value.address for value in first] == [0]
    came = host.run(0.1)
    kinds = [type(value) for _, value in came]
    assert kinds[:3] == [ReadData] * 3
    assert set(kinds[3:]) == {Data}
    pieces = [time_s for time_s, value in came if isinstance(value, ReadData)]
    assert pieces[2] - pieces[0] == pytest.approx(0.02, abs=0.003)


def test_a_stall_leaves_no_burst():
    host = Host()
    host.send(DataMode(0x31))
    host.remote.skip_to(10.0)
    assert len(host.run(10.05)) <= 7


# -- memory --------------------------------------------------------------------------------------


def test_eeprom():
    host = Host()
    calibration, source = read_accelerometer_calibration(host.read(0x16, 20, EEPROM))
    assert source is CalibrationSource.FIRST
    assert calibration.zero == (531, 520, 536)
    camera = host.read(0, 22, EEPROM)
    assert camera[:11] == camera[11:]
    assert (sum(camera[:10]) + 0x55) & 255 == camera[10]
    assert host.send(WriteMemory(0x2A, b"Cardan", EEPROM)) == [Ack(0, 0x16, 0)]
    assert host.read(0x2A, 6, EEPROM) == b"Cardan"
    assert len(host.read(0, 0x1700, EEPROM)) == 0x1700


@pytest.mark.parametrize(
    ("address", "size", "space", "error"),
    [
        (0x1700, 16, 0, ErrorCode.INVALID_ADDRESS),
        (0x16FF, 2, 0, ErrorCode.INVALID_ADDRESS),
        (ID_ADDRESS, 6, 1, ErrorCode.NO_DEVICE),
        (ID_ADDRESS, 6, 2, ErrorCode.NO_DEVICE),
        (PLUS_ID_ADDRESS, 6, 1, ErrorCode.NO_DEVICE),
        (0xB00000, 6, 1, ErrorCode.NO_DEVICE),
        (0xA00000, 6, 1, ErrorCode.INVALID_ADDRESS),
        (0x16, 6, 3, ErrorCode.INVALID_SPACE),
    ],
)
def test_memory_that_is_not_there(address, size, space, error):
    host = Host()
    assert host.send(ReadMemory(address, size, space)) == [
        ReadData(0, error, address & 0xFFFF, b"")
    ]
    assert host.send(WriteMemory(address, bytes(min(16, size)), space)) == [Ack(0, 0x16, error)]


def test_one_memory_operation_at_a_time():
    host = Host()
    host.send(ReadMemory(0, 64, EEPROM))
    assert host.send(ReadMemory(0, 16, EEPROM)) == [Ack(0, 0x17, ErrorCode.BUSY)]
    assert host.send(WriteMemory(0x2A, b"x", EEPROM)) == [Ack(0, 0x16, ErrorCode.BUSY)]
    host.run(0.1)
    assert host.send(WriteMemory(0x2A, b"x", EEPROM)) == [Ack(0, 0x16, 0)]


def test_speaker_and_the_ignored_address_bit():
    host = Host()
    host.send(WriteMemory(0xA20001, b"\x08\x09"))
    assert host.read(0xA30001, 2) == b"\x08\x09"


# -- the Nunchuk ---------------------------------------------------------------------------------


def start(host: Host) -> None:
    for value in EXTENSION_START:
        assert Ack(0, 0x16, 0) in host.send(value)


def test_nunchuk_wants_its_start_up():
    host = Host(extension="nunchuk")
    assert host.read(ID_ADDRESS, 6) == b"\xff" * 6
    assert decode_nunchuk(host.stream(0x32, 0.02)[0].extension) is None
    start(host)
    assert extension_of(host.read(ID_ADDRESS, 6)) is Extension.NUNCHUK
    block = host.read(0xA40020, 32)
    assert block[:16] == block[16:]
    calibration = decode_nunchuk_calibration(block)
    assert calibration is not None
    host.remote.set_stick(1.0, -1.0)
    host.remote.press("z")
    value = decode_nunchuk(host.stream(0x35, 0.02)[-1].extension)
    assert (value.stick_x, value.stick_y) == (calibration.stick_x[2], calibration.stick_y[0])
    assert (value.c, value.z) == (False, True)
    assert to_g(value.accelerometer, calibration.zero, calibration.one_g) == (0.0, 0.0, 1.0)


def test_the_old_start_up_leaves_it_encrypted():
    host = Host(extension="nunchuk")
    host.send(WriteMemory(0xA40040, b"\x00"))
    secret = host.read(ID_ADDRESS, 6)
    assert secret != EXTENSION_IDS[Extension.NUNCHUK]
    clear = bytes(((byte ^ 0x17) + 0x17) & 255 for byte in secret)
    assert clear == EXTENSION_IDS[Extension.NUNCHUK]
    host.send(EXTENSION_START[0])  # enough for an extension started before
    assert host.read(ID_ADDRESS, 6) == EXTENSION_IDS[Extension.NUNCHUK]


def test_a_change_at_the_port_ends_the_data_until_a_mode_is_set():
    host = Host()
    host.stream(0x31, 0.1)
    host.remote.plug(host.now_s)
    came = host.run(0.5)
    (index,) = [i for i, (_, value) in enumerate(came) if isinstance(value, Status)]
    assert came[index][1].extension
    assert came[index + 1 :] == []
    assert host.stream(0x31, 0.1)
    host.remote.unplug(host.now_s)
    assert [value.extension for value in without_data(host.run(0.5))] == [False]
    assert host.remote.mode is None
    # A requested status ends no data.
    assert host.stream(0x31, 0.1)
    host.send(StatusRequest())
    assert len(host.run(0.5)) > 40


def test_extension_bytes_without_extension_are_ff():
    assert Host().stream(0x32, 0.02)[0].extension == b"\xff" * 8


# -- MotionPlus ----------------------------------------------------------------------------------


def activate(host: Host, passing: int = PASS_NONE) -> list[bool]:
    """Activate the MotionPlus; return the extension flags reported meanwhile."""
    host.send(MOTION_PLUS_START)
    host.send(motion_plus_activate(passing))
    return [value.extension for value in without_data(host.run(0.1))]


def test_motion_plus_moves_to_the_port_and_back():
    host = Host(motion_plus=True)
    assert host.read(PLUS_ID_ADDRESS, 6) == EXTENSION_IDS[Extension.MOTION_PLUS_INACTIVE]
    assert host.read(ID_ADDRESS, 6) == ErrorCode.NO_DEVICE
    block = host.read(0xA60020, 32)
    assert decode_motion_plus_calibration(block) is not None
    assert activate(host) == [True]
    assert host.read(ID_ADDRESS, 6) == EXTENSION_IDS[Extension.MOTION_PLUS]
    assert host.read(0xA40020, 32) == block
    assert host.send(READ_MOTION_PLUS_ID) == [ReadData(0, ErrorCode.NO_DEVICE, 0xFA, b"")]
    host.send(MOTION_PLUS_STOP)
    assert [value.extension for value in without_data(host.run(0.1))] == [False]
    assert host.read(PLUS_ID_ADDRESS, 6) == bytes.fromhex("00 00 a6 20 04 05")
    assert activate(host) == [True]


def test_the_port_is_dead_while_it_moves():
    host = Host(motion_plus=True)
    host.send(motion_plus_activate())
    for address in (ID_ADDRESS, PLUS_ID_ADDRESS):
        assert host.send(ReadMemory(address, 6))[-1].error == ErrorCode.NO_DEVICE
    host.run(0.02)
    assert host.remote.port.connected is False
    host.run(0.02)
    assert host.remote.port.connected is True


def test_with_a_nunchuk_behind_it_the_flag_falls_and_rises():
    host = Host(extension="nunchuk", motion_plus=True)
    assert activate(host, PASS_NUNCHUK) == [False, True]
    host.remote.press("c")
    reports = host.stream(0x35, 0.2)
    own = [report for report in reports if decode_motion_plus(report.extension)]
    passed = [report for report in reports if decode_nunchuk_pass_through(report.extension)]
    assert len(own) == pytest.approx(len(passed), abs=1)
    assert len(own) + len(passed) == len(reports) - 1  # The first frame is invalid.
    assert decode_nunchuk_pass_through(passed[0].extension).c
    assert decode_motion_plus(own[0].extension).extension
    host.remote.unplug(host.now_s)
    assert without_data(host.run(0.1)) == []  # The MotionPlus is still at the port.
    assert all(decode_motion_plus(r.extension) for r in host.stream(0x35, 0.1))


def test_built_in_motion_plus_says_so():
    assert Host(tr=True, motion_plus=True).read(PLUS_ID_ADDRESS, 1) == b"\x01"


@pytest.mark.parametrize(
    ("rates", "slow"), [((0.5, -0.4, 0.3), True), ((0.0, 0.0, 15.0), False), ((9.0, 0, 0), False)]
)
def test_turn_rates_are_measured_in_their_axes(rates, slow):
    host = Host(motion_plus=True)
    calibration = decode_motion_plus_calibration(host.read(0xA60020, 32))
    activate(host)
    host.remote.set_attitude(0.0, 0.0, 0.0, rates)
    data = decode_motion_plus(host.stream(0x35, 0.1)[-1].extension)
    roll, pitch, yaw = rates
    forward, left, up = to_operator_axes(to_rad_s(data, calibration))
    # Nose up is a negative rotation about the left axis.
    assert (forward, left, up) == pytest.approx((roll, -pitch, yaw), abs=0.005)
    assert all((data.yaw_slow, data.roll_slow, data.pitch_slow)) is slow


# -- accelerometers ------------------------------------------------------------------------------


@given(st.floats(-3.0, 3.0), st.floats(-1.3, 1.3), st.floats(-3.0, 3.0))
def test_attitude_is_read_back_through_the_calibration(roll, pitch, yaw):
    host = Host()
    calibration, _ = read_accelerometer_calibration(host.read(0x16, 20, EEPROM))
    host.remote.set_attitude(roll, pitch, yaw)
    raw = host.stream(0x31, 0.02)[-1].accelerometer
    assert raw[1] & 1 == raw[2] & 1 == 0
    measured = to_g(raw, calibration.zero, calibration.one_g)
    assert math.hypot(*measured) == pytest.approx(1.0, abs=0.03)
    x, y, z = measured
    assert math.atan2(-y, math.hypot(x, z)) == pytest.approx(pitch, abs=0.06)
    assert x == pytest.approx(math.cos(pitch) * math.sin(roll), abs=0.02)
    assert z == pytest.approx(math.cos(pitch) * math.cos(roll), abs=0.03)


def test_gravity_and_acceleration():
    host = Host()
    zero, one = (531, 520, 536), (636, 628, 638)

    def force() -> tuple[float, ...]:
        return to_g(host.stream(0x31, 0.02)[-1].accelerometer, zero, one)

    host.remote.set_attitude(math.radians(30), 0.0)
    roll, pitch = roll_and_pitch_rad(force())
    assert math.degrees(roll) == pytest.approx(30, abs=1)  # right side down is positive
    host.remote.set_attitude(0.0, math.radians(30))
    roll, pitch = roll_and_pitch_rad(force())
    assert math.degrees(pitch) == pytest.approx(30, abs=1)  # nose up is positive
    host.remote.set_attitude(0.0, 0.0)
    host.remote.set_acceleration((0.5, 0.0, -1.0))  # forward, in free fall
    assert force() == pytest.approx((0.0, -0.5, 0.0), abs=0.02)
    host.remote.set_acceleration((0.0, 9.0, 0.0))
    assert host.stream(0x31, 0.02)[-1].accelerometer[0] == 1023


# -- camera --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ir_format", "mode", "fields"),
    [(IrFormat.BASIC, 0x37, 2), (IrFormat.EXTENDED, 0x33, 3)],
)
def test_camera_sees_once_it_runs_in_the_format_of_the_mode(ir_format, mode, fields):
    host = Host()
    dots = (IrDot(100, 200, 3), IrDot(1000, 700, 5))
    host.remote.set_dots(dots)

    def seen() -> tuple[IrDot | None, ...]:
        return decode_dots(host.stream(mode, 0.02)[-1].ir, ir_format)

    assert seen() == (None,) * 4
    for value in camera_start(ir_format):
        assert any(isinstance(answer, Ack) and not answer.error for answer in host.send(value))
    assert seen() == (*(IrDot(*dot[:fields]) for dot in dots), None, None)
    host.send(WriteMemory(0xB00033, b"\x05"))
    assert seen() == (None,) * 4
    host.send(Switch(0x13, False))
    assert host.read(0xB00033, 1) == ErrorCode.NO_DEVICE


# -- sequences of real clients -------------------------------------------------------------------


def test_the_kernel_drivers_probe():
    host = Host(extension="nunchuk", motion_plus=True)
    for text in ("15 00", "12 00 30", "11 10"):
        host.send(bytes.fromhex(text))
    for address, byte in ((0xA400F0, 0x55), (0xA400FB, 0), (0xA600F0, 0x55), (0xA600FB, 0)):
        assert Ack(0, 0x16, 0) in host.send(WriteMemory(address, bytes((byte,))))
    assert extension_of(host.read(PLUS_ID_ADDRESS, 6)) is Extension.MOTION_PLUS_INACTIVE
    assert extension_of(host.read(ID_ADDRESS, 6)) is Extension.NUNCHUK
    statuses = host.send(StatusRequest()) + host.send(StatusRequest())
    assert [status.extension for status in statuses if isinstance(status, Status)] == [True, True]
    host.send(bytes.fromhex("12 00 30"))
    assert host.remote.ignored_outputs == 0


def test_a_long_read_of_the_extension():
    host = Host(extension="nunchuk")
    start(host)
    assert len(host.read(0xA40020, 0xE0)) == 0xE0


@given(st.lists(st.binary(max_size=24), max_size=20))
def test_no_output_report_breaks_it(outputs):
    host = Host(extension="nunchuk", motion_plus=True)
    for data in outputs:
        host.remote.control(data, host.now_s)
        host.remote.interrupt(data, host.now_s)
        host.send(data)
        for _, value in host.run(0.02):
            assert type(value).__name__ != "MalformedReport"


@given(
    st.lists(
        st.one_of(
            st.builds(
                ReadMemory,
                st.sampled_from([0, 0x16F0, 0xA400FA, 0xA60020, 0xB00000]),
                st.integers(1, 64),
                st.integers(0, 3),
            ),
            st.builds(
                WriteMemory,
                st.sampled_from([0x16F8, 0xA400F0, 0xA400FE, 0xA600FE, 0xB00030]),
                st.sampled_from([b"\x55", b"\x04", b"\x05", b"\x00", bytes(16)]),
                st.integers(0, 3),
            ),
            st.builds(DataMode, st.sampled_from([0x31, 0x35, 0x37, 0x3E])),
        ),
        max_size=8,
    )
)
def test_reads_and_writes_are_each_answered_once(values):
    host = Host(extension="nunchuk", motion_plus=True)
    for value in values:
        host.remote.output(encode_output(value), host.now_s)
        answers = [decode_input(report) for report in host.remote.reports(host.now_s)]
        answers += [answer for _, answer in host.run(0.06)]
        if isinstance(value, WriteMemory):
            assert sum(isinstance(answer, Ack) for answer in answers) == 1
        elif isinstance(value, ReadMemory):
            pieces = [answer for answer in answers if isinstance(answer, ReadData)]
            assert sum(len(piece.data) for piece in pieces) == value.size or pieces[-1].error


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"extension": "guitar"}, "extension: 'guitar' is not allowed; it must be"),
        ({"faults": {"nosuch": 1.0}}, "no fault 'nosuch'"),
        ({"faults": {"power-on": 1.0}}, "needs the fault power-off"),
        ({"faults": {"woken-by-1-2": 1.0}}, "only a -TR remote"),
        ({"noise_lsb": -1}, "noise_lsb: -1 is not allowed; it must be 0 to 50"),
    ],
)
def test_nonsense_is_refused(settings, words):
    error = OptionError if "it must be" in words else ScriptError
    with pytest.raises(error, match=words):
        SimulatedWiimote(**settings)


def test_hands_that_cannot_be():
    remote = SimulatedWiimote()
    with pytest.raises(ScriptError, match="no Nunchuk"):
        remote.press("z")
    with pytest.raises(ScriptError, match="there are: left"):
        remote.press("x")
    for act in (remote.set_attitude, remote.set_stick):
        with pytest.raises(ValueError, match="finite"):
            act(math.nan, 0.0)
    with pytest.raises(ValueError, match="finite"):
        remote.set_acceleration((0.0, math.inf, 0.0))


def test_no_number_of_requests_makes_it_send_more_than_its_slots_carry():
    remote = SimulatedWiimote()
    remote.connect(0.0)
    reports = 0
    for tick in range(1000):
        for _ in range(20):
            remote.output(encode_output(StatusRequest()), 0.001 * tick)
        reports += len(remote.reports(0.001 * tick))
    assert 750 < reports <= 800 + 33
