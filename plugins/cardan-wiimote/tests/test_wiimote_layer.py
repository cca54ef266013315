"""The Wii Remote's layers: worked reports, comparison with the codec, and damaged reports."""

import pytest
from hypothesis import given, settings, strategies as st

from cardan_wiimote import dissect as layers, protocol as codec
from cardan_wiimote.dissect import (
    AccelerometerCalibration,
    AcknowledgeReport,
    BrokenReport,
    CameraCalibration,
    CoreAccelerationReport,
    DataModeReport,
    IrBasicPair,
    IrExtended,
    IrFull,
    LedsReport,
    MotionPlusCalibration,
    MotionPlusData,
    NunchukCalibration,
    NunchukData,
    PassThroughNunchukData,
    ReadReport,
    ReadRequestReport,
    Spot,
    StatusReport,
    UnknownReport,
    WiimoteInput,
    WiimoteOutput,
    WriteReport,
    interleaved_acceleration,
)
from tests.examples import examples


def _hex(text):
    return bytes.fromhex(text)


ACCELEROMETER = _hex("84 82 86 30 9f 9d 9f 02 40 2e")
MOTION_PLUS_BLOCK = _hex(
    "7983 7354 72E8 30C3 CC4A 34FC C8 4F CC5B 7749 75A4 739A 3552 CA22 3726 2D E5 B5A2"
)

INPUTS = [
    (_hex("20 00 08 12 00 00 c0"), StatusReport(a=1, led_1=1, extension_connected=1, battery=192)),
    (
        _hex("21 00 00 90 00 16") + ACCELEROMETER + bytes(6),
        ReadReport(length_less_1=9, address=0x16, data=ACCELEROMETER + bytes(6)),
    ),
    (_hex("21 00 00 f8 17 00") + bytes(16), ReadReport(length_less_1=15, error=8, address=0x1700)),
    (_hex("22 00 00 16 00"), AcknowledgeReport(of=0x16)),
    (_hex("22 00 00 16 07"), AcknowledgeReport(of=0x16, error=7)),
    (
        _hex("31 60 48 91 82 9c"),
        CoreAccelerationReport(
            x_low=3, a=1, z_low=1, y_low=0, x_high=0x91, y_high=0x82, z_high=0x9C
        ),
    ),
]
OUTPUTS = [
    (_hex("11 21"), LedsReport(led_2=1, rumble=1)),
    (_hex("12 04 31"), DataModeReport(continuous=1, mode=0x31)),
    (_hex("12 05 31"), DataModeReport(continuous=1, rumble=1, mode=0x31)),
    (_hex("13 06"), layers.CameraEnable1Report(on=1, acknowledge=1)),
    (_hex("17 00 00 00 16 00 0a"), ReadRequestReport(address=0x16, size=10)),
    (_hex("17 04 a4 00 fa 00 06"), ReadRequestReport(space=1, address=0xA400FA, size=6)),
    (
        _hex("16 04 a4 00 f0 01 55") + bytes(15),
        WriteReport(space=1, address=0xA400F0, size=1, data=b"\x55" + bytes(15)),
    ),
    (_hex("15 00"), layers.StatusRequestReport()),
    (_hex("10 01"), layers.RumbleReport(rumble=1)),
]


@pytest.mark.parametrize(
    ("entry", "data", "report"),
    [*((WiimoteInput, *row) for row in INPUTS), *((WiimoteOutput, *row) for row in OUTPUTS)],
    ids=lambda v: v.hex(" ")[:8] if isinstance(v, bytes) else "",
)
def test_worked_reports_both_ways(entry, data, report):
    assert bytes(report) == data
    dissected = entry(data)
    assert type(dissected) is type(report)
    for field in report.fields_desc:
        assert dissected.getfieldval(field.name) == report.getfieldval(field.name)
    dissected.clear_cache()
    assert bytes(dissected) == data
    assert bytes(entry(data + bytes(3))) == data + bytes(3)  # Padding is a separate field.


def test_acceleration_and_buttons_of_worked_reports():
    for text, counts, buttons in (
        ("31 70 e4 84 74 9c", (531, 466, 626), ("plus", "b", "home")),
        ("31 60 4c 84 82 9f", (531, 520, 638), ("b", "a")),
    ):
        report = WiimoteInput(_hex(text))
        assert report.acceleration == counts
        assert report.buttons == buttons


def test_interleaved_reports():
    first = WiimoteInput(_hex("3e 20 48 91") + b"\xff" * 18)
    second = WiimoteInput(_hex("3f 00 68 82") + b"\xff" * 18)
    assert interleaved_acceleration(first, second) == (0x91, 0x82, 0x9C)
    assert first.buttons == second.buttons == ("a",)
    assert first.spots == (None, None)


def test_camera_objects():
    assert IrExtended(_hex("bc 2c 63")).spots == (Spot(700, 300, 3),)
    assert IrBasicPair(_hex("bc 2c 68 c8 08")).spots == (Spot(700, 300), Spot(200, 520))
    full = IrFull(_hex("bc 2c 63 01 02 03 04 00 7f"))
    assert full.spots == (Spot(700, 300, 3, (1, 2, 3, 4), 127),)
    report = WiimoteInput(_hex("33 00 00 84 82 9f bc 2c 63") + b"\xff" * 9)
    assert report.spots == (Spot(700, 300, 3), None, None, None)
    assert bytes(layers.CoreAccelerationIr12Report()) == _hex("33 00 00 00 00 00") + b"\xff" * 12


def test_extension_data():
    nunchuk = NunchukData(_hex("80 c0 80 7f b5 e5"))
    assert (nunchuk.stick_x, nunchuk.stick_y) == (128, 192)
    assert nunchuk.acceleration == (513, 510, 727)
    assert (nunchuk.c_up, nunchuk.z_up) == (0, 1)
    gyro = MotionPlusData(_hex("fd 5e fc 6e 5a 52"))
    assert gyro.rates == (7165, 5726, 5372)
    assert gyro.slow == (True, True, False)


def test_blocks_of_memory():
    block = AccelerometerCalibration(ACCELEROMETER)
    assert block.point("zero") == (531, 520, 536)
    assert block.point("one_g") == (636, 628, 638)
    assert block.checksum_ok
    wrong = AccelerometerCalibration(ACCELEROMETER[:-1] + b"\0")
    assert not wrong.checksum_ok
    block.clear_cache()
    block.checksum = None
    assert bytes(block) == ACCELEROMETER

    gyro = MotionPlusCalibration(MOTION_PLUS_BLOCK)
    assert gyro.checksum_ok
    assert (gyro.fast_yaw_zero, gyro.slow_pitch_scale) == (0x7983, 0x3726)
    assert (gyro.fast_degrees_by_6, gyro.slow_degrees_by_6) == (1200 // 6, 270 // 6)
    gyro.clear_cache()
    gyro.crc_high = gyro.crc_low = None
    assert bytes(gyro) == MOTION_PLUS_BLOCK
    assert not MotionPlusCalibration(MOTION_PLUS_BLOCK[:-1] + b"\0").checksum_ok

    for built, size in ((CameraCalibration(), 11), (NunchukCalibration(stick_x_max=228), 16)):
        data = bytes(built)
        assert len(data) == size
        assert built.checksum_ok
        assert type(built)(data).checksum_ok
        assert not type(built)(bytes([data[0] ^ 1]) + data[1:]).checksum_ok


def test_truncated_and_unknown_reports():
    for entry, rows in ((WiimoteInput, INPUTS), (WiimoteOutput, OUTPUTS)):
        for data, _ in rows:
            for size in range(1, len(data)):
                cut = entry(data[:size])
                assert type(cut) is BrokenReport
                assert cut.reason == f"report 0x{data[0]:02x} of {size} bytes"
    assert WiimoteInput(b"").reason == "empty report"
    assert type(WiimoteInput(_hex("2a 01"))) is UnknownReport
    assert type(WiimoteOutput(_hex("30 00 00"))) is UnknownReport


@given(
    st.sampled_from([WiimoteInput, WiimoteOutput]),
    st.sampled_from([*layers.INPUT_LAYERS, *layers.OUTPUT_LAYERS, 0x00, 0x2A]),
    st.binary(max_size=30),
)
def test_random_bytes_never_raise(entry, report_id, rest):
    for data in (rest, bytes([report_id]) + rest):
        report = entry(data)
        assert repr(report)
        assert not data or bytes(report) == data


# Against the codec.

masks = st.integers(0, 0xFFFF).map(lambda n: n & codec.BUTTON_MASK)
byte = st.integers(0, 255)
counts = st.tuples(*[st.integers(0, 1023)] * 3)
flag = st.booleans()


def nine_bits(x, y, z):
    return x, y & ~1, z & ~1


def labels(report):
    return {{"one": "1", "two": "2"}.get(name, name) for name in report.buttons}


def leds(mask):
    return tuple(n + 1 for n in range(4) if mask >> n & 1)


@given(masks, flag, flag, flag, flag, st.integers(0, 15), byte)
def test_status_of_the_codec(mask, low, extension, speaker, camera, lit, battery):
    value = codec.Status(mask, low, extension, speaker, camera, lit, battery)
    report = WiimoteInput(codec.encode_status(value))
    assert labels(report) == set(codec.button_labels(mask))
    assert report.leds == leds(lit)
    assert report.battery == battery
    flags = (report.battery_low, report.extension_connected, report.speaker, report.camera)
    assert flags == (low, extension, speaker, camera)


@given(masks, st.sampled_from(list(codec.ErrorCode)), st.integers(0, 0xFFFF), st.binary(
    min_size=1, max_size=16), byte)  # fmt: skip
def test_memory_reports_of_the_codec(mask, error, address, data, of):
    report = WiimoteInput(codec.encode_read_data(codec.ReadData(mask, error, address, data)))
    assert labels(report) == set(codec.button_labels(mask))
    assert (report.error, report.address) == (error, address)
    assert report.content == (b"" if error else data)
    report = WiimoteInput(codec.encode_ack(codec.Ack(mask, of, error)))
    assert (report.of, report.error) == (of, error)


@settings(max_examples=examples(200))
@given(st.data(), st.sampled_from(sorted(codec.DATA_LAYOUTS)), masks, counts)
def test_data_reports_of_the_codec(data, mode, mask, acceleration):
    layout = codec.DATA_LAYOUTS[mode]
    camera = data.draw(st.binary(min_size=layout.ir_bytes, max_size=layout.ir_bytes))
    size = layout.extension_bytes
    extension = data.draw(st.binary(min_size=size, max_size=size))
    encoded = codec.encode_data(
        codec.Data(
            mode,
            mask if layout.buttons else None,
            acceleration if layout.accelerometer else None,
            camera,
            extension,
        )
    )
    report = WiimoteInput(encoded)
    assert len(encoded) == report.least_bytes
    if layout.buttons:
        assert labels(report) == set(codec.button_labels(mask))
    if layout.accelerometer:
        assert report.acceleration == nine_bits(*acceleration)
    if layout.ir_bytes:
        assert b"".join(map(bytes, report.ir)) == camera
    if size:
        assert report.extension == extension
    assert bytes(type(report)(**report.fields)) == encoded


@given(masks, counts, st.binary(min_size=36, max_size=36))
def test_interleaved_reports_of_the_codec(mask, acceleration, camera):
    first, second = (
        WiimoteInput(codec.encode_interleaved(mode, mask, acceleration, half))
        for mode, half in ((0x3E, camera[:18]), (0x3F, camera[18:]))
    )
    assert interleaved_acceleration(first, second) == tuple(v >> 2 for v in acceleration)
    for report in (first, second):
        assert labels(report) == set(codec.button_labels(mask))
    assert b"".join(map(bytes, (*first.ir, *second.ir))) == camera


dots = st.builds(
    codec.IrDot,
    st.integers(0, 1023),
    st.integers(0, 767),
    st.integers(0, 15),
    st.tuples(*[st.integers(0, 127)] * 4),
    byte,
)


@given(st.lists(st.none() | dots, min_size=4, max_size=4))
def test_camera_objects_of_the_codec(four):
    for ir_format, block, retained in (
        (codec.IrFormat.BASIC, IrBasicPair, 2),
        (codec.IrFormat.EXTENDED, IrExtended, 3),
        (codec.IrFormat.FULL, IrFull, 5),
    ):
        data = codec.encode_dots(four, ir_format)
        size = len(bytes(block()))
        found = [
            spot for at in range(0, len(data), size) for spot in block(data[at : at + size]).spots
        ]
        assert found == [
            None if dot is None else Spot(*dot[:retained], *(None,) * (5 - retained))
            for dot in four
        ]


memory = st.tuples(st.integers(0, 0xFFFFFF), st.integers(0, 3), flag)


@given(
    st.one_of(
        st.builds(codec.Rumble, flag),
        st.builds(codec.Leds, st.integers(0, 15), flag, flag),
        st.builds(codec.DataMode, st.sampled_from(sorted(codec.DATA_MODES)), flag, flag, flag),
        st.builds(codec.Switch, st.sampled_from(sorted(codec.SWITCH_IDS)), flag, flag, flag),
        st.builds(codec.StatusRequest, flag),
        st.builds(codec.SpeakerData, st.binary(min_size=1, max_size=20), flag),
        st.builds(
            lambda m, data: codec.WriteMemory(m[0], data, m[1], m[2]),
            memory,
            st.binary(min_size=1, max_size=16),
        ),
        st.builds(
            lambda m, size: codec.ReadMemory(m[0], size, m[1], m[2]),
            memory,
            st.integers(1, 0xFFFF),
        ),
    )
)
def test_output_reports_of_the_codec(value):
    encoded = codec.encode_output(value)
    report = WiimoteOutput(encoded)
    assert len(encoded) == report.least_bytes
    assert report.rumble == value.rumble
    expected = value._asdict()
    for name, got in (
        ("ack", getattr(report, "acknowledge", 0)),
        ("on", getattr(report, "on", 0)),
        ("continuous", getattr(report, "continuous", 0)),
        ("mode", getattr(report, "mode", 0)),
        ("address", getattr(report, "address", 0)),
        ("space", getattr(report, "space", 0)),
        ("report_id", report.id),
    ):
        if name in expected:
            assert got == expected[name], name
    if isinstance(value, codec.Leds):
        assert report.leds == leds(value.leds)
    if isinstance(value, (codec.WriteMemory, codec.SpeakerData)):
        assert report.content == value.data
    if isinstance(value, codec.ReadMemory):
        assert report.size == value.size
    assert bytes(type(report)(**report.fields)) == encoded


@given(
    st.builds(codec.MotionPlusData, *[st.integers(0, codec.RAW_MAX)] * 3, flag, flag, flag, flag)
)
def test_motion_plus_data_of_the_codec(value):
    data = MotionPlusData(codec.encode_motion_plus(value))
    assert data.rates == value[:3]
    assert data.slow == value[3:6]
    assert (data.extension_connected, data.motion_plus, data.invalid) == (value.extension, 1, 0)


@given(st.builds(codec.NunchukData, byte, byte, counts, flag, flag), flag)
def test_nunchuk_data_of_the_codec(value, plugged):
    data = NunchukData(codec.encode_nunchuk(value))
    assert (data.stick_x, data.stick_y, data.acceleration) == value[:3]
    assert (not data.c_up, not data.z_up) == value[3:]
    data = PassThroughNunchukData(codec.encode_nunchuk_pass_through(value, plugged))
    assert (data.stick_x, data.stick_y) == value[:2]
    assert data.acceleration == tuple(v & ~1 for v in value.accelerometer)
    assert (not data.c_up, not data.z_up) == value[3:]
    assert (data.extension_connected, data.motion_plus, data.zero) == (plugged, 0, 0)


@given(counts, counts, byte)
def test_accelerometer_calibration_of_the_codec(zero, one_g, volume):
    block = AccelerometerCalibration(
        codec.encode_accelerometer_calibration(codec.AccelerometerCalibration(zero, one_g, volume))
    )
    assert (block.point("zero"), block.point("one_g")) == (zero, one_g)
    assert block.motor << 7 | block.volume == volume
    assert block.checksum_ok


triple = st.tuples(byte, byte, byte)
words = st.tuples(*[st.integers(0, 0xFFFF)] * 3)


@given(counts, counts, triple, triple)
def test_nunchuk_calibration_of_the_codec(zero, one_g, x, y):
    block = NunchukCalibration(
        codec.encode_nunchuk_calibration(codec.NunchukCalibration(zero, one_g, x, y))
    )
    assert (block.point("zero"), block.point("one_g")) == (zero, one_g)
    assert (block.stick_x_min, block.stick_x_center, block.stick_x_max) == x
    assert (block.stick_y_min, block.stick_y_center, block.stick_y_max) == y
    assert block.checksum_ok


@given(words, words, words, words, byte, byte, st.tuples(byte, byte))
def test_motion_plus_calibration_of_the_codec(zero, scale, zero_2, scale_2, by_6, by_6_2, uid):
    value = codec.MotionPlusCalibration(
        codec.MotionPlusRange(zero, scale, 6 * by_6),
        codec.MotionPlusRange(zero_2, scale_2, 6 * by_6_2),
        uid,
    )
    block = MotionPlusCalibration(codec.encode_motion_plus_calibration(value))
    for name, part, number in (("fast", value.fast, uid[0]), ("slow", value.slow, uid[1])):
        for kind in ("zero", "scale"):
            axes = ("yaw", "roll", "pitch")
            found = tuple(block.getfieldval(f"{name}_{axis}_{kind}") for axis in axes)
            assert found == getattr(part, kind)
        assert 6 * block.getfieldval(f"{name}_degrees_by_6") == part.degrees_s
        assert block.getfieldval(f"{name}_uid") == number
    assert block.checksum_ok


def test_both_read_the_worked_blocks_alike():
    value = codec.decode_motion_plus_calibration(MOTION_PLUS_BLOCK)
    block = MotionPlusCalibration(MOTION_PLUS_BLOCK)
    assert value.fast.zero == (block.fast_yaw_zero, block.fast_roll_zero, block.fast_pitch_zero)
    value = codec.decode_accelerometer_calibration(ACCELEROMETER)
    assert value.zero == AccelerometerCalibration(ACCELEROMETER).point("zero")


@given(st.sampled_from(sorted(layers.INPUT_LAYERS)), st.binary(max_size=24))
def test_both_refuse_the_same_lengths(report_id, rest):
    data = bytes([report_id]) + rest
    broken = isinstance(WiimoteInput(data), BrokenReport)
    assert broken == isinstance(codec.decode_input(data), codec.MalformedReport)
