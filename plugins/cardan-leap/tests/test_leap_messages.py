"""Messages of the tracking service and of its clients."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from cardan.types import Vector3
from cardan_leap.protocol import (
    ClientOptions,
    DeviceEvent,
    Hand,
    Ignored,
    Malformed,
    TrackingFrame,
    Version,
    decode_options,
    decode_service,
    encode_device_event,
    encode_json,
    encode_options,
    encode_version,
    path_of,
    version_of,
)

VERSION = '{"serviceVersion":"2.3.1+33747","version":6}'
DEVICE = (
    '{"event":{"state":{"attached":true,"id":"LP1","streaming":false,"type":"peripheral"},'
    '"type":"deviceEvent"}}'
)
MINIMAL = """{"id":1,"timestamp":1000,"currentFrameRate":110.0,"hands":[{"id":7,"type":"right",
"palmPosition":[12.5,210.0,-30.0],"palmVelocity":[0,0,0],"palmNormal":[0,-1,0],
"direction":[0,0,-1],"grabStrength":0.0,"pinchStrength":0.0,"confidence":0.98}],"pointables":[],
"gestures":[],"interactionBox":{"center":[0,200,0],"size":[235.2,235.2,147.8]},
"r":[[1,0,0],[0,1,0],[0,0,1]],"s":1,"t":[0,0,0]}"""
# Hands of three public recordings: a V1, a V2 service, and a bridge of newer tracking software.
RECORDED_V1 = """{"currentFrameRate":112.46,"devices":[],"gestures":[],"hands":[{
"direction":[0.391462,0.492811,-0.777107],"id":104,"palmNormal":[0.49238,-0.825615,-0.275541],
"palmPosition":[-47.7327,239.387,39.1488],"palmVelocity":[30.4891,110.673,93.986],
"s":1.22235,"sphereRadius":128.175,"timeVisible":1.09306}],"id":174419}"""
RECORDED_V2 = """{"currentFrameRate":110.747,"hands":[{"confidence":1,
"direction":[0.490721,0.425143,-0.760557],"grabStrength":0,"id":1,
"palmNormal":[0.141838,-0.900216,-0.411695],"palmPosition":[47.033,113.621,102.153],
"palmWidth":92.4988,"pinchStrength":0,"timeVisible":810.321,"type":"right"}],"id":13319,
"pointables":[],"timestamp":810321011}"""
RECORDED_BRIDGE = """{"currentFrameRate":60.69957,"devices":[],"hands":[{"confidence":1,
"direction":[0.695266,0.560133,-0.450396],"grabAngle":1.847007,"grabStrength":0.017353,"id":281,
"palmNormal":[-0.219856,0.762338,0.608691],"palmPosition":[-137.440933,118.850044,137.773209],
"pinchDistance":57.203442,"pinchStrength":0.153614,"timeVisible":0.001606,"type":"left"}],
"id":920531,"pointables":[]}"""

numbers = st.floats(-1e4, 1e4)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner),
    max_leaves=10,
)


@pytest.mark.judged(device="Leap Motion", transport="WebSocket", by="worked bytes")
class TestWorkedMessages:
    def test_version(self):
        assert decode_service(VERSION) == Version(6, "2.3.1+33747")
        assert encode_version(Version(6, "2.3.1+33747")) == VERSION

    def test_device_event(self):
        event = DeviceEvent("LP1", "peripheral", attached=True, streaming=False)
        assert decode_service(DEVICE) == event
        assert encode_device_event(event, 6) == DEVICE

    def test_device_connect_of_older_versions(self):
        text = '{"event":{"state":false,"type":"deviceConnect"}}'
        assert decode_service(text) == DeviceEvent("", "", attached=False, streaming=False)
        assert encode_device_event(DeviceEvent("LP1", "peripheral", True, False), 4) == text

    def test_minimal_frame(self):
        hand = Hand(
            7,
            Vector3(12.5, 210.0, -30.0),
            Vector3(0.0, -1.0, 0.0),
            Vector3(0.0, 0.0, -1.0),
            "right",
            0.0,
            0.0,
            0.98,
        )
        assert decode_service(MINIMAL) == TrackingFrame(1, 1000, 110.0, (hand,))

    def test_recorded_frames(self):
        first, second, bridge = map(decode_service, (RECORDED_V1, RECORDED_V2, RECORDED_BRIDGE))
        assert isinstance(first, TrackingFrame)
        assert first.timestamp_us is None
        assert first.hands[0][4:] == ("", None, None, None, 1.09306)
        assert isinstance(second, TrackingFrame)
        assert second.hands[0].palm_position_mm == (47.033, 113.621, 102.153)
        assert second.hands[0][4:] == ("right", 0.0, 0.0, 1.0, 810.321)
        assert isinstance(bridge, TrackingFrame)
        assert bridge.hands[0][4:] == ("left", 0.017353, 0.153614, 1.0, 0.001606)

    def test_options_leave_as_single_objects_with_the_focus_last(self):
        options = ClientOptions(focused=True, background=True, optimize_hmd=False)
        assert encode_options(options) == (
            '{"background":true}',
            '{"optimizeHMD":false}',
            '{"focused":true}',
        )
        assert encode_options(ClientOptions(heartbeat=True)) == ('{"heartbeat":true}',)


def frame_with(**changes):
    document = json.loads(MINIMAL)
    document["hands"][0].update(changes)
    return decode_service(json.dumps(document))


@pytest.mark.parametrize(
    "changes",
    [
        {"palmPosition": None},
        {"palmPosition": [1.0, 2.0]},
        {"palmPosition": [1.0, 2.0, "3"]},
        {"palmPosition": [1.0, 2.0, float("nan")]},
        {"palmNormal": [0, float("inf"), 0]},
        {"direction": [0, 0, 10**400]},
        {"direction": [True, 0, 0]},
        {"id": "7"},
        {"id": None},
        {"confidence": 5.0},
        {"confidence": -0.1},
        {"confidence": "1"},
        {"confidence": True},
        {"confidence": None},
        {"confidence": float("nan")},
    ],
)
def test_a_hand_that_cannot_be_read_is_counted_and_left_out(changes):
    frame = frame_with(**changes)
    assert isinstance(frame, TrackingFrame)
    assert (frame.hands, frame.unreadable_hands) == ((), 1)


@pytest.mark.parametrize("changes", [{"grabStrength": "x"}, {"type": "middle"}])
def test_some_of_what_is_optional_may_be_nonsense(changes):
    frame = frame_with(**changes)
    assert isinstance(frame, TrackingFrame)
    assert len(frame.hands) == 1


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xfe",
        b"{",
        b"[]",
        b"7",
        '{"hands":{}}',
        '{"hands":7}',
        '{"version":"6"}',
        '{"event":7}',
        '{"event":{"type":"deviceEvent","state":true}}',
        '{"event":{"type":"deviceEvent","state":{"attached":1,"streaming":true}}}',
        '{"event":{"type":"deviceConnect","state":1}}',
        "[" * 100_000,
        '{"id":' + "9" * 5000 + "}",
    ],
)
def test_what_is_no_message_is_malformed(data):
    message = decode_service(data)
    assert isinstance(message, Malformed)
    assert message.reason


def test_unknown_messages_are_distinguished_from_malformed_ones():
    assert decode_service('{"policy":{"images":false}}') == Ignored(("policy",))
    assert isinstance(decode_service('{"event":{"type":"newEvent"}}'), Ignored)


def test_a_numeric_device_id_is_taken():
    text = '{"event":{"type":"deviceEvent","state":{"id":255,"attached":true,"streaming":true}}}'
    assert decode_service(text) == DeviceEvent("ff", "", attached=True, streaming=True)


def test_options_of_a_client():
    assert decode_options('{"focused":true}') == ClientOptions(focused=True)
    assert decode_options('{"background":1,"x":true}') == ClientOptions(unknown=("background", "x"))
    assert isinstance(decode_options("null"), Malformed)


@given(
    *[st.none() | st.booleans()] * 5,
)
def test_options_round_trip(focused, background, hmd, gestures, heartbeat):
    options = ClientOptions(focused, background, hmd, gestures, heartbeat)
    merged: dict[str, bool] = {}
    for text in encode_options(options):
        merged.update(json.loads(text))
    assert decode_options(json.dumps(merged)) == options


@given(st.integers(1, 6), st.text(max_size=20))
def test_version_round_trips(version, service):
    assert decode_service(encode_version(Version(version, service))) == Version(version, service)


@given(st.lists(st.tuples(st.integers(1, 2**31), *[numbers] * 9), max_size=3))
def test_frames_round_trip(hands):
    document = {
        "id": 5,
        "timestamp": 6,
        "hands": [
            {
                "id": hand[0],
                "palmPosition": hand[1:4],
                "palmNormal": hand[4:7],
                "direction": hand[7:10],
            }
            for hand in hands
        ],
    }
    frame = decode_service(encode_json(document))
    assert frame == TrackingFrame(
        5, 6, None, tuple(Hand(h[0], Vector3(*h[1:4]), h[4:7], h[7:10]) for h in hands)
    )


@given(st.binary(max_size=200))
def test_random_bytes_never_raise(data):
    decode_service(data)
    decode_options(data)


@given(st.dictionaries(st.sampled_from(["hands", "event", "version", "id", "x"]), json_values))
def test_random_objects_never_raise(document):
    decode_service(json.dumps(document))
    decode_options(json.dumps(document))


@given(st.lists(st.dictionaries(st.sampled_from(["id", "palmPosition", "type"]), json_values)))
def test_random_hands_never_raise(hands):
    frame = decode_service(json.dumps({"hands": hands}))
    assert isinstance(frame, TrackingFrame)
    assert len(frame.hands) + frame.unreadable_hands == len(hands)


def test_paths():
    assert [version_of(path_of(version)) for version in range(1, 8)] == list(range(1, 8))
    assert version_of("/") == 1
    for path in ("", "/v.json", "/v6", "/v06.json", "/v6.json/", "/x", "/v6.json\n"):
        assert version_of(path) is None


def test_encoding_refuses_what_json_has_not():
    with pytest.raises(ValueError, match="not JSON compliant"):
        encode_json({"x": float("nan")})


PAGE = Path(__file__).parents[1] / "README.md"
WORKED = re.findall(r"^\| `(.+?)` \| `(.+)` \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.judged(device="Leap Motion", transport="WebSocket", by="worked bytes")
@pytest.mark.parametrize(("text", "value"), [row for row in WORKED if row[0][0] in "{["])
def test_worked_bytes_of_the_page(text, value):
    kinds = (DeviceEvent, TrackingFrame, Hand, Ignored, Malformed, Vector3, Version)
    assert decode_service(text) == eval(value, {kind.__name__: kind for kind in kinds})


def test_the_page_has_worked_bytes():
    assert len([row for row in WORKED if row[0][0] in "{["]) == 8
