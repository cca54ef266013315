"""The remote's reports: worked bytes, round trips, and arbitrary bytes."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from cardan_wiimote.protocol import (
    BUTTON_MASK,
    BUTTONS,
    DATA_LAYOUTS,
    DATA_MODES,
    EEPROM,
    INPUT_SIZES,
    LONGEST_REPORT_BYTES,
    MODELS,
    OUTPUT_SIZES,
    SWITCH_IDS,
    WIIMOTE,
    WIIMOTE_TR,
    Ack,
    Data,
    DataMode,
    ErrorCode,
    Interleaved,
    Leds,
    MalformedReport,
    ReadData,
    ReadMemory,
    Rumble,
    SpeakerData,
    Status,
    StatusRequest,
    Switch,
    WriteMemory,
    button_labels,
    button_mask,
    decode_input,
    decode_output,
    encode_ack,
    encode_data,
    encode_interleaved,
    encode_output,
    encode_read_data,
    encode_status,
    join_halves,
    model_of,
    report_descriptor,
    rumble_of,
    with_rumble,
)

A, B, PLUS, HOME = (button_mask([label]) for label in ("a", "b", "plus", "home"))
FF18 = " ff" * 18

INPUTS = [
    ("20 00 08 12 00 00 c0", Status(A, False, True, False, False, 1, 0xC0)),
    ("20 00 00 f9 00 00 1a", Status(0, True, False, False, True, 15, 0x1A)),
    (
        "21 00 00 90 00 16 84 82 86 30 9f 9d 9f 02 40 2e 00 00 00 00 00 00",
        ReadData(0, 0, 0x16, bytes.fromhex("84 82 86 30 9f 9d 9f 02 40 2e")),
    ),
    ("21 00 00 f8 17 00" + " 00" * 16, ReadData(0, ErrorCode.INVALID_ADDRESS, 0x1700, b"")),
    ("21 00 00 f7 00 fa" + " 00" * 16, ReadData(0, ErrorCode.NO_DEVICE, 0xFA, b"")),
    ("22 00 00 16 00", Ack(0, 0x16, 0)),
    ("22 00 08 17 04", Ack(A, 0x17, ErrorCode.BUSY)),
    ("30 10 80", Data(0x30, PLUS | HOME, None, b"", b"")),
    ("31 60 48 91 82 9c", Data(0x31, A, (583, 520, 626), b"", b"")),
    ("31 70 e4 84 74 9c", Data(0x31, PLUS | HOME | B, (531, 466, 626), b"", b"")),
    ("31 60 4c 84 82 9f", Data(0x31, A | B, (531, 520, 638), b"", b"")),
    (
        "37 60 4c 84 82 9f bc 2c 68 c8 08 ff ff ff ff ff 80 c0 80 7f b5 e5",
        Data(
            0x37, A | B, (531, 520, 638),
            bytes.fromhex("bc 2c 68 c8 08 ff ff ff ff ff"), bytes.fromhex("80 c0 80 7f b5 e5"),
        ),
    ),
    ("3e 20 48 91" + FF18, Interleaved(0x3E, A, 0x91, 0b1001, b"\xff" * 18)),
    ("3f 00 68 82" + FF18, Interleaved(0x3F, A, 0x82, 0b1100, b"\xff" * 18)),
]  # fmt: skip

OUTPUTS = [
    ("10 00", Rumble(False)),
    ("10 01", Rumble(True)),
    ("11 21", Leds(0b0010, rumble=True)),
    ("11 10", Leds(0b0001)),
    ("12 04 31", DataMode(0x31)),
    ("12 05 31", DataMode(0x31, rumble=True)),
    ("12 00 30", DataMode(0x30, continuous=False)),
    ("13 06", Switch(0x13, True, ack=True)),
    ("1a 06", Switch(0x1A, True, ack=True)),
    ("15 00", StatusRequest()),
    ("16 04 a4 00 f0 01 55" + " 00" * 15, WriteMemory(0xA400F0, b"\x55")),
    ("17 00 00 00 16 00 0a", ReadMemory(0x16, 10, EEPROM)),
    ("17 00 00 17 00 00 10", ReadMemory(0x1700, 16, EEPROM)),
    ("17 04 a4 00 fa 00 06", ReadMemory(0xA400FA, 6)),
    ("18 10 c3 c3" + " 00" * 18, SpeakerData(b"\xc3\xc3")),
]

masks = st.sets(st.sampled_from([*BUTTONS])).map(sum)
counts = st.tuples(*[st.integers(0, 1023)] * 3)


@pytest.mark.judged(device="Wiimote", transport="input reports", by="worked bytes")
@pytest.mark.parametrize(("text", "value"), INPUTS)
def test_worked_input(text, value):
    decoded = decode_input(bytes.fromhex(text))
    assert decoded == value
    assert type(decoded) is type(value)


@pytest.mark.judged(device="Wiimote", transport="output reports", by="worked bytes")
@pytest.mark.parametrize(("text", "value"), OUTPUTS)
def test_worked_output(text, value):
    report = bytes.fromhex(text)
    assert decode_output(report) == value
    assert encode_output(value) == report


def test_worked_input_encodes_back():
    encoders = {Status: encode_status, ReadData: encode_read_data, Ack: encode_ack}
    for text, value in INPUTS:
        if isinstance(value, Data):
            assert encode_data(value) == bytes.fromhex(text)
        elif type(value) in encoders:
            assert encoders[type(value)](value) == bytes.fromhex(text)


def test_halves_of_the_worked_measurement_join():
    first, second = (decode_input(bytes.fromhex(text)) for text, _ in INPUTS[-2:])
    joined = join_halves(first, second)
    assert joined.accelerometer == (0x91 << 2, 0x82 << 2, 0x9C << 2)
    assert joined.buttons == A
    assert joined.ir == b"\xff" * 36
    with pytest.raises(ValueError, match="not 0x3e and 0x3f"):
        join_halves(second, first)


@given(masks, counts)
def test_halves_keep_eight_bits(mask, accelerometer):
    halves = [
        decode_input(encode_interleaved(mode, mask, accelerometer, bytes(18)))
        for mode in (0x3E, 0x3F)
    ]
    joined = join_halves(*halves)
    assert joined.accelerometer == tuple(count & ~3 for count in accelerometer)
    assert joined.buttons == mask


@given(masks, counts, st.sampled_from(sorted(DATA_LAYOUTS)), st.binary(min_size=40, max_size=40))
def test_data_reports_round_trip(mask, accelerometer, mode, filler):
    layout = DATA_LAYOUTS[mode]
    x, y, z = accelerometer
    value = Data(
        mode,
        mask if layout.buttons else None,
        (x, y & ~1, z & ~1) if layout.accelerometer else None,
        filler[: layout.ir_bytes],
        filler[: layout.extension_bytes],
    )
    report = encode_data(value)
    assert len(report) == 1 + layout.size
    assert decode_input(report) == value


@given(st.binary(max_size=30))
def test_nothing_raises(data):
    assert isinstance(
        decode_input(data), Status | ReadData | Ack | Data | Interleaved | MalformedReport
    )
    decode_output(data)
    rumble_of(data)


@given(st.sampled_from(sorted(INPUT_SIZES)), st.binary(max_size=40))
def test_only_whole_input_reports_count(report_id, body):
    value = decode_input(bytes((report_id,)) + body)
    if len(body) < INPUT_SIZES[report_id]:
        assert value == MalformedReport("too short", report_id)
    else:
        assert not isinstance(value, MalformedReport)
        assert value == decode_input(bytes((report_id,)) + body[: INPUT_SIZES[report_id]])


@given(st.sampled_from(sorted(OUTPUT_SIZES)), st.binary(min_size=21, max_size=21))
def test_outputs_round_trip_or_say_what_is_wrong(report_id, body):
    report = bytes((report_id,)) + body[: OUTPUT_SIZES[report_id]]
    value = decode_output(report)
    if isinstance(value, MalformedReport):
        assert value == MalformedReport("with an impossible value", report_id)
        with pytest.raises(ValueError, match="malformed"):
            encode_output(value)
    else:
        assert len(encode_output(value)) == 1 + OUTPUT_SIZES[report_id]
        assert decode_output(encode_output(value)) == value
    assert rumble_of(report) == bool(report[1] & 1)


@given(st.sampled_from([value for _, value in OUTPUTS]), st.booleans())
def test_the_motor_bit_is_set_in_any_report(value, on):
    report = with_rumble(encode_output(value), on)
    assert rumble_of(report) is on
    assert decode_output(report) == value._replace(rumble=on)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "empty"),
        ("2f 00 00", "of an unknown id"),
        ("21 00 00", "too short"),
    ],
)
def test_malformed_inputs_say_why(text, reason):
    assert decode_input(bytes.fromhex(text)).reason == reason


@pytest.mark.parametrize(
    "text",
    [
        "12 04 38",  # no such data mode
        "16 04 a4 00 f0 00" + " 00" * 16,  # no data, or too much
        "16 04 a4 00 f0 11" + " 00" * 16,  # more than there is room for
        "17 04 a4 00 fa 00 00",
        "18 00" + " 00" * 20,
    ],
)
def test_impossible_outputs(text):
    report = bytes.fromhex(text)
    assert decode_output(report) == MalformedReport("with an impossible value", report[0])


def test_padding_of_a_write_may_be_garbage():
    report = bytes.fromhex("16 04 a4 00 fb 02 00 01") + b"\xa5" * 14
    assert decode_output(report) == WriteMemory(0xA400FB, b"\x00\x01")


@pytest.mark.parametrize(
    "value",
    [
        Leds(16),
        DataMode(0x38),
        Switch(0x15, True),
        WriteMemory(0x1000000, b"\x00"),
        WriteMemory(0, b""),
        WriteMemory(0, bytes(17)),
        WriteMemory(0, b"\x00", space=4),
        ReadMemory(0, 0),
        ReadMemory(0, 0x10000),
        SpeakerData(bytes(21)),
    ],
)
def test_outputs_that_do_not_fit(value):
    with pytest.raises(ValueError, match=r"not|beyond"):
        encode_output(value)


@pytest.mark.parametrize(
    "value",
    [
        Data(0x38, 0, None, b"", b""),
        Data(0x30, None, None, b"", b""),
        Data(0x30, 0, (0, 0, 0), b"", b""),
        Data(0x31, 0, (0, 0, 1024), b"", b""),
        Data(0x31, 0x2000, (0, 0, 0), b"", b""),
        Data(0x32, 0, None, b"", bytes(7)),
    ],
)
def test_data_that_does_not_fit(value):
    with pytest.raises(ValueError, match=r"mode|counts|mask"):
        encode_data(value)


def test_answers_that_do_not_fit():
    with pytest.raises(ValueError, match="0 bytes"):
        encode_read_data(ReadData(0, 0, 0, b""))
    with pytest.raises(ValueError, match="battery 256"):
        encode_status(Status(0, False, False, False, False, 0, 256))
    with pytest.raises(ValueError, match="neither 0x3e nor 0x3f"):
        encode_interleaved(0x30, 0, (0, 0, 0), bytes(18))
    with pytest.raises(ValueError, match="17 bytes"):
        encode_interleaved(0x3E, 0, (0, 0, 0), bytes(17))


@given(masks)
def test_buttons_by_name(mask):
    assert button_mask(button_labels(mask)) == mask
    assert button_labels(mask | 0xFFFF & ~BUTTON_MASK) == button_labels(mask)


def test_button_that_does_not_exist():
    with pytest.raises(ValueError, match="no button 'x'; there are: left"):
        button_mask(["x"])


def test_data_modes():
    assert sorted(DATA_MODES) == [*range(0x30, 0x38), 0x3D, 0x3E, 0x3F]
    assert all(DATA_LAYOUTS[mode].size == INPUT_SIZES[mode] for mode in DATA_LAYOUTS)
    assert max(*INPUT_SIZES.values(), *OUTPUT_SIZES.values()) + 1 == LONGEST_REPORT_BYTES
    assert set(OUTPUT_SIZES) > SWITCH_IDS


def test_models():
    assert model_of("Nintendo RVL-CNT-01", 0x0306) is WIIMOTE
    assert model_of("Nintendo RVL-CNT-01-TR", 0x0330) is WIIMOTE_TR
    assert model_of("Nintendo RVL-WBC-01", 0x0306).key == "balance-board"
    assert model_of("", 0x0330) is WIIMOTE_TR  # a system that provides no names
    assert model_of("", 0x2009) is None
    assert len({model.key for model in MODELS}) == len(MODELS)


def test_descriptor():
    descriptor = report_descriptor()
    assert len(descriptor) == 217
    assert descriptor.startswith(
        bytes.fromhex(
            "05010905a101 8510 1500 26ff00 7508 9501 0600ff 0901 9100 8511 9501 0901 9100"
        )
    )
    assert descriptor.endswith(bytes.fromhex("853e 9515 0901 8100 853f 9515 0901 8100 c0"))
