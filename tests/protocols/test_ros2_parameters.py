"""Parameter services of ROS 2, without a bus."""

import pytest

from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.messages import completed
from cardan.protocols.ros2.parameters import (
    Declared,
    ParameterError,
    ParameterKind,
    ParameterServer,
)

DECLARED = (
    Declared("gain", ParameterKind.DOUBLE, "A gain", 0.0, 2.0, constraints="no more is stable"),
    Declared("frame", ParameterKind.STRING, "A frame", choices=("base", "tcp")),
    Declared("limits.count", ParameterKind.INTEGER, "A count", 1, 5),
    Declared("limits.speed.fast", ParameterKind.BOOL, "Fast"),
    Declared("model", ParameterKind.STRING, "The arm", read_only=True),
    Declared("free", ParameterKind.DOUBLE, "Any"),
)
VALUES = {
    "gain": 0.5, "frame": "base", "limits.count": 3, "limits.speed.fast": True, "model": "ur5",
}  # fmt: skip
FIELDS = {bool: ("bool_value", 1), int: ("integer_value", 2), float: ("double_value", 3),
          str: ("string_value", 4)}  # fmt: skip


@pytest.fixture
def server():
    return ParameterServer(DECLARED)


def parameter(name, value=None):
    given = {}
    if value is not None:
        field, kind = FIELDS[type(value)]
        given = {"type": kind, field: value}
    return completed("rcl_interfaces/msg/Parameter", {"name": name, "value": given})


def carried(kind, response):
    """Return the response encoded and decoded."""
    codec = codec_of(f"rcl_interfaces/srv/{kind}_Response")
    return codec.decode(codec.encode(response))


def test_values_keep_their_places_and_unknown_names_are_not_set(server):
    response = carried(
        "GetParameters",
        server.get({"names": ["frame", "nope", "limits.count", "gain", "free"]}, VALUES),
    )
    assert [value["type"] for value in response["values"]] == [4, 0, 2, 3, 0]
    assert response["values"][0]["string_value"] == "base"
    assert response["values"][2]["integer_value"] == 3
    assert response["values"][3]["double_value"] == 0.5


def test_types_of_all_and_of_none(server):
    response = carried("GetParameterTypes", server.get_types({"names": ["gain", "nope", "frame"]}))
    assert response["types"] == b"\3\0\4"
    assert carried("GetParameterTypes", server.get_types({"names": []}))["types"] == b""


def test_descriptors_have_ranges_choices_and_reasons(server):
    names = ["gain", "frame", "limits.count", "model", "nope"]
    response = carried("DescribeParameters", server.describe({"names": names}))
    gain, frame, count, model, nope = response["descriptors"]
    assert gain["floating_point_range"] == [{"from_value": 0.0, "to_value": 2.0, "step": 0.0}]
    assert gain["additional_constraints"] == "no more is stable"
    assert frame["additional_constraints"] == "one of base, tcp"
    assert count["integer_range"] == [{"from_value": 1, "to_value": 5, "step": 0}]
    assert model["read_only"]
    assert not gain["read_only"]
    assert (nope["name"], nope["type"]) == ("nope", 0)
    assert not any(each["dynamic_typing"] for each in response["descriptors"])


@pytest.mark.parametrize(
    ("prefixes", "depth", "expected"),
    [
        ([], 0, [*(each.name for each in DECLARED), "use_sim_time"]),
        ([], 1, ["gain", "frame", "model", "free", "use_sim_time"]),
        ([], 2, ["gain", "frame", "limits.count", "model", "free", "use_sim_time"]),
        (["limits"], 0, ["limits.count", "limits.speed.fast"]),
        (["limits"], 1, ["limits.count"]),
        (["gain"], 1, ["gain"]),
        (["gai", "limit"], 0, []),
        (["limits.speed"], 0, ["limits.speed.fast"]),
        (["limits", "gain"], 0, ["gain", "limits.count", "limits.speed.fast"]),
    ],
)
def test_lists_by_prefix_and_depth(server, prefixes, depth, expected):
    response = carried("ListParameters", server.list_names({"prefixes": prefixes, "depth": depth}))
    assert response["result"]["names"] == expected


def test_prefixes_of_what_is_listed(server):
    result = server.list_names({"prefixes": [], "depth": 0})["result"]
    assert result["prefixes"] == ["limits", "limits.speed"]


@pytest.mark.parametrize(
    ("name", "value"),
    [("gain", 2.0), ("frame", "tcp"), ("limits.count", 1), ("limits.speed.fast", False),
     ("free", -1e300)],
)  # fmt: skip
def test_what_is_allowed_is_taken(server, name, value):
    assert server.checked(parameter(name, value)) == (name, value)


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("gain", 2.5, "gain: allowed are 0 to 2, not 2.5"),
        ("gain", float("nan"), "not a finite number"),
        ("free", float("inf"), "not a finite number"),
        ("gain", 1, r"gain: it is a double, not integer: write 1\.0"),
        ("gain", "fast", "gain: it is a double, not string"),
        ("gain", None, "not set: it cannot be deleted"),
        ("frame", "world", "frame: allowed are base, tcp, not 'world'"),
        ("frame", 1.0, "frame: it is a string, not double"),
        ("limits.count", 6, "allowed are 1 to 5, not 6"),
        ("limits.count", True, "not bool"),
        ("model", "gofa", "model: it can only be read"),
        ("use_sim_time", True, "use_sim_time: it can only be read: all times are of this comp"),
        ("nope", 1.0, "there is no parameter 'nope'; there are gain, frame"),
    ],
)
def test_what_is_not_is_refused_with_the_reason(server, name, value, words):
    with pytest.raises(ParameterError, match=words):
        server.checked(parameter(name, value))


def test_a_type_that_does_not_exist_is_refused(server):
    strange = parameter("gain", 1.0)
    strange["value"]["type"] = 77
    with pytest.raises(ParameterError, match="not type 77"):
        server.checked(strange)


def test_a_group_is_all_or_nothing(server):
    good = [parameter("gain", 1.0), parameter("frame", "tcp")]
    assert server.checked_group(good) == {"gain": 1.0, "frame": "tcp"}
    with pytest.raises(ParameterError, match="gain: it is given twice"):
        server.checked_group([*good, parameter("gain", 0.5)])
    with pytest.raises(ParameterError, match="allowed are 0 to 2"):
        server.checked_group([*good[1:], parameter("gain", 9.0)])


def test_events_tell_of_what_is_new_and_of_what_changed(server):
    name = "rcl_interfaces/msg/ParameterEvent"
    first = server.event("/arm", VALUES, 3_000_000_004)
    assert codec_of(name).decode(codec_of(name).encode(first)) == first
    assert first["stamp"] == {"sec": 3, "nanosec": 4}
    assert first["node"] == "/arm"
    assert {each["name"] for each in first["new_parameters"]} == {*VALUES, "use_sim_time"}
    assert server.event("/arm", dict(VALUES), 0) is None
    second = server.event("/arm", VALUES | {"gain": 0.7}, 0)
    assert [each["name"] for each in second["changed_parameters"]] == ["gain"]
    assert second["changed_parameters"][0]["value"]["double_value"] == 0.7
    assert second["new_parameters"] == second["deleted_parameters"] == []
