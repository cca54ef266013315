"""The 3Dconnexion layers: worked reports, in both directions, and damaged ones."""

import pytest
from hypothesis import given, strategies as st

from cardan_dissect.connexion import (
    V3DK,
    BatteryReport,
    BrokenReport,
    ButtonReport,
    CalibrateReport,
    ConnexionFeature,
    ConnexionInput,
    ConnexionOutput,
    KeysDownReport,
    LedReport,
    LongPressBitsReport,
    LongPressReport,
    MotionReport,
    RotationReport,
    TranslationReport,
    UnknownReport,
)
from tests.protocols import worked

KEY_SLOTS = [0] * 4

WORKED = [
    (ConnexionInput, worked.TRANSLATION, TranslationReport(x=120, y=-45, z=300)),
    (ConnexionInput, worked.ROTATION, RotationReport(rx=-350, ry=8, rz=64)),
    (ConnexionInput, worked.MOTION, MotionReport(x=-210, y=33, z=-1, rx=350, ry=-350, rz=128)),
    (
        ConnexionInput,
        worked.BUTTONS_PRO,
        ButtonReport(bits=(1 << 12 | 1 << 25).to_bytes(6, "little")),
    ),
    (ConnexionInput, worked.BUTTONS_TWO, ButtonReport(bits=b"\3\0")),
    (ConnexionInput, worked.KEYS_DOWN, KeysDownReport(slots=[13, 103, *KEY_SLOTS])),
    (ConnexionInput, b"\x1d" + worked.KEYS_DOWN[1:], LongPressReport(slots=[13, 103, *KEY_SLOTS])),
    (ConnexionInput, b"\x16\x01\x00\x00\x40", LongPressBitsReport(bits=1 | 1 << 30)),
    (ConnexionInput, worked.BATTERY, BatteryReport(percent=85)),
    (ConnexionInput, b"\x17\x64\x01", BatteryReport(percent=100, external_power=1)),
    (ConnexionOutput, worked.LED, LedReport(on=1)),
    (ConnexionOutput, b"\x04\x00", LedReport(on=0)),
    (ConnexionFeature, worked.CALIBRATE, CalibrateReport(value=0)),
    (ConnexionInput, b"\x2a\x01\x02", UnknownReport(id=0x2A, data=b"\x01\x02")),
    (ConnexionInput, b"\x01\x78\x00\xd3", BrokenReport(data=b"\x01\x78\x00\xd3")),
]


@pytest.mark.parametrize(("layer", "data", "report"), WORKED, ids=lambda v: repr(v)[:30])
def test_worked_reports_both_ways(layer, data, report):
    assert bytes(report) == data
    dissected = layer(data)
    assert type(dissected) is type(report)
    dissected.clear_cache()
    assert dissected == report
    assert bytes(dissected) == data


def test_mask_and_codes():
    assert ConnexionInput(worked.BUTTONS_PRO).mask == 0x02001000
    assert ConnexionInput(b"\x16\x02\0\0\x80").mask == 2  # the last bit is padding
    assert ConnexionInput(worked.KEYS_DOWN).codes == (13, 103)


def test_padding_is_kept_apart():
    padded = ConnexionInput(worked.MOTION + bytes(51))
    assert type(padded) is MotionReport
    assert padded.rz == 128
    assert bytes(padded) == worked.MOTION + bytes(51)
    assert ConnexionInput(worked.ROTATION + bytes(6)).rz == 64


@pytest.mark.parametrize(
    ("layer", "data", "least"),
    [
        (ConnexionInput, worked.MOTION, 13),
        (ConnexionInput, worked.ROTATION, 7),
        (ConnexionInput, worked.BUTTONS_PRO, 2),
        (ConnexionInput, worked.KEYS_DOWN, 13),
        (ConnexionInput, b"\x16\0\0\0\0", 5),
        (ConnexionInput, worked.BATTERY, 3),
        (ConnexionOutput, worked.LED, 2),
        (ConnexionFeature, worked.CALIBRATE, 2),
    ],
    ids=lambda v: repr(v)[:20],
)
def test_truncations(layer, data, least):
    for size in range(len(data)):
        cut = layer(data[:size])
        assert repr(cut)
        if layer is ConnexionInput and data[0] == 1 and size == 7:
            assert type(cut) is TranslationReport
        else:
            assert (type(cut) is BrokenReport) == (size < least)
    assert layer(b"").reason == "empty report"


@given(st.sampled_from([ConnexionInput, ConnexionOutput, ConnexionFeature]), st.binary(max_size=70))
def test_random_bytes_never_raise(layer, data):
    report = layer(data)
    assert repr(report)
    assert not data or bytes(report) == data


def test_key_numbers_of_the_vendor():
    expected = {1: "MENU", 12: "ISO2", 13: "1", 22: "10", 23: "ESC", 27: "ROTATE", 31: "MINUS"}
    expected |= {32: "SPIN_CW", 35: "TILT_CCW", 36: "ENTER", 37: "DELETE", 41: "F1", 52: "F12"}
    expected |= {77: "11", 103: "V1", 105: "V3", 139: "SAVE_V1", 176: "SPACE", 232: "NUMPAD_F4"}
    assert {code: V3DK[code] for code in expected} == expected
    assert 38 not in V3DK
