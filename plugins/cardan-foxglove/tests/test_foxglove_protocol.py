"""Frames of the Foxglove protocol: decoding, and parameters in both directions."""

from __future__ import annotations

import json
import math
import struct

import pytest
from hypothesis import given, strategies as st

from cardan.protocols.rate import RateLimit
from cardan.protocols.ros2.parameters import content_of, value_of
from cardan_foxglove.protocol import (
    MOST_NAMES,
    GetParameters,
    Given,
    SetParameters,
    Subscribe,
    Subscription,
    Unsubscribe,
    client_name,
    given_value,
    is_time,
    network_name,
    parameter_entry,
    parameter_values,
    parse_operation,
    published_channel,
    status,
    subscription_of,
)


@pytest.mark.parametrize(
    ("said", "read"),
    [
        (
            {"op": "subscribe", "subscriptions": [{"id": 0, "channelId": 4_294_967_295}]},
            Subscribe((Subscription(0, 4_294_967_295),)),
        ),
        ({"op": "unsubscribe", "subscriptionIds": [1, 2]}, Unsubscribe((1, 2))),
        (
            {"op": "getParameters", "parameterNames": ["/a.b"], "id": "x"},
            GetParameters(("/a.b",), "x"),
        ),
        ({"op": "getParameters", "parameterNames": []}, GetParameters((), None)),
        (
            {
                "op": "setParameters",
                "parameters": [{"name": "/a.b", "value": 1, "type": "x"}],
            },
            SetParameters((Given("/a.b", 1, "x"),), None),
        ),
        (
            {"op": "setParameters", "parameters": [{"name": "/a.b"}]},
            SetParameters((Given("/a.b", None, ""),), None),
        ),
    ],
)
def test_what_is_read_of_a_client(said, read):
    assert parse_operation(json.dumps(said)) == read


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[" * 100_000,
        "{}",
        '{"op": 7}',
        '{"op": "advertise", "channels": []}',
        '{"op": "subscribe"}',
        '{"op": "subscribe", "subscriptions": {}}',
        '{"op": "subscribe", "subscriptions": [7]}',
        '{"op": "subscribe", "subscriptions": [{"id": true, "channelId": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
        '{"op": "unsubscribe", "subscriptionIds": [4294967296]}',
        '{"op": "getParameters", "parameterNames": [7]}',
        '{"op": "getParameters", "parameterNames": [], "id": 7}',
        '{"op": "setParameters", "parameters": [{"name": 7}]}',
        json.dumps({"op": "getParameters", "parameterNames": ["a"] * (MOST_NAMES + 1)}),
    ],
)
def test_what_is_not_ours_or_malformed_is_the_sdks(text):
    assert parse_operation(text) is None


LEAVES = st.none() | st.booleans() | st.integers() | st.text()


@given(st.recursive(LEAVES, st.lists).map(json.dumps))
def test_no_text_is_too_much(value):
    for op in ("subscribe", "unsubscribe", "getParameters", "setParameters"):
        for key in ("subscriptions", "subscriptionIds", "parameterNames", "parameters"):
            parse_operation(f'{{"op": "{op}", "{key}": {value}}}')


def test_binary_frames():
    message = struct.pack("<BIQ", 1, 7, 123) + b"data"
    assert subscription_of(message) == published_channel(message) == 7
    assert subscription_of(message[:12]) is None
    assert published_channel(b"\x01\x07\x00\x00") is None
    assert published_channel(b"\x02" + message) is None
    assert is_time(struct.pack("<BQ", 2, 123))
    assert not is_time(b"")
    assert not is_time(message)


@given(st.binary(max_size=20))
def test_no_binary_frame_is_too_much(frame):
    for read in (subscription_of, published_channel, is_time):
        read(frame)


def test_names_are_those_of_foxgloves_bridges():
    assert network_name("/cardan/arm.limits.speed") == "/cardan/arm:limits.speed"
    assert client_name("/cardan/arm", "limits.speed") == "/cardan/arm.limits.speed"


@pytest.mark.parametrize(
    ("kind", "content", "entry"),
    [
        (1, True, {"value": True}),
        (2, 7, {"value": 7}),
        (3, 1.0, {"value": 1.0, "type": "float64"}),
        (4, "x", {"value": "x"}),
        (5, b"abc", {"value": "YWJj", "type": "byte_array"}),
        (6, [True], {"value": [True]}),
        (7, [1, 2], {"value": [1, 2]}),
        (8, [1.0, 2.5], {"value": [1.0, 2.5], "type": "float64_array"}),
        (9, ["a"], {"value": ["a"]}),
    ],
)
def test_parameters_both_ways(kind, content, entry):
    value = value_of(content, kind)
    assert value["type"] == kind
    said = parameter_entry("/a.b", value)
    assert said == {"name": "/a.b", **entry}
    text = json.loads(parameter_values([said], "x"))
    assert text == {"op": "parameterValues", "parameters": [said], "id": "x"}
    again = given_value(Given("/a.b", entry["value"], entry.get("type", "")), kind)
    assert content_of(again) == content_of(value)


@pytest.mark.parametrize("content", [math.nan, math.inf, [1.0, math.nan]])
def test_numbers_that_json_has_not_are_left_out(content):
    assert parameter_entry("/a.b", value_of(content, 0)) is None
    assert parameter_entry("/a.b", {"type": 0}) is None


@pytest.mark.parametrize(
    ("value", "kind", "made"),
    [(1, "float64", 1.0), ([1, 2], "float64_array", [1.0, 2.0]), ([], "float64_array", [])],
)
def test_whole_numbers_are_floats_where_the_client_says_so(value, kind, made):
    assert list(map(float, _listed(content_of(given_value(Given("/a.b", value, kind), 0))))) == (
        made if isinstance(made, list) else [made]
    )


def _listed(content):
    return [content] if isinstance(content, float) else content


@pytest.mark.parametrize(
    ("value", "kind"),
    [({"a": 1}, ""), ("?", "byte_array"), (7, "byte_array"), ([1, "a"], ""), ([[1]], "")],
)
def test_what_is_no_value(value, kind):
    with pytest.raises(ValueError, match="is no"):
        given_value(Given("/a.b", value, kind), 0)


def test_without_a_value_a_parameter_is_to_be_deleted():
    assert given_value(Given("/a.b", None, ""), 3)["type"] == 0


def test_a_status_is_text():
    said = json.loads(status(2, 'no "x"', "publish"))
    assert said == {"op": "status", "level": 2, "message": 'no "x"', "id": "publish"}


def test_so_many_in_a_second():
    limit = RateLimit(2)
    assert [limit.exceeded(each) for each in (5.0, 5.1, 5.9, 6.0, 6.5, 6.9)] == [
        *(False, False, True),
        *(False, False, True),
    ]
