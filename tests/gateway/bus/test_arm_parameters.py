"""The parameter services of an arm's node."""

import pytest

from cardan.gateway.arm.parameters import RULES
from cardan.gateway.arm.vocab import Parameter
from cardan.gateway.bus.arm_parameters import MAX_SET, PARAMETERS
from cardan.protocols.ros2.messages import default_message
from tests.gateway.bus.bench import NODE, Bench

PAPER = (
    "preset_streaming_cmd", "frame", "gain", "trajectory_duration", "trajectory_reference_speed",
    "trajectory_reference_acceleration", "cmc_period", "wait_period",
)  # fmt: skip


@pytest.fixture
def bench():
    return Bench()


def value_of(value):
    if isinstance(value, bool):
        return {"type": 1, "bool_value": value}
    if isinstance(value, str):
        return {"type": 4, "string_value": value}
    if isinstance(value, float):
        return {"type": 3, "double_value": value}
    return {"type": 2, "integer_value": value}


def given(*pairs):
    return {"parameters": [{"name": name, "value": value_of(value)} for name, value in pairs]}


def values(bench, *names):
    answer = bench.call("/get_parameters", {"names": list(names)}).answer
    return [
        each["string_value"]
        if each["type"] == 4
        else each["bool_value"]
        if each["type"] == 1
        else each["double_value"]
        if each["type"]
        else None
        for each in answer["values"]
    ]


def set_each(bench, *pairs):
    answer = bench.call("/set_parameters", given(*pairs)).answer
    return [each["reason"] for each in answer["results"]]


def set_all(bench, *pairs):
    return bench.call("/set_parameters_atomically", given(*pairs)).answer["result"]


def test_every_parameter_of_the_interface_is_there_those_of_the_paper_first(bench):
    listed = bench.call("/list_parameters").answer["result"]["names"]
    assert tuple(listed[: len(PAPER)]) == PAPER
    assert {each.key for each in PARAMETERS} == {rule.key for rule in RULES}
    assert listed[len(RULES) :] == ["use_sim_time"]


def test_simulated_time_is_refused_with_the_reason(bench):
    assert values(bench, "use_sim_time") == [False]
    assert "must not stand still" in set_each(bench, ("use_sim_time", True))[0]
    refused = set_all(bench, ("gain", 1.0), ("use_sim_time", True))
    assert not refused["successful"]
    assert "can only be read" in refused["reason"]
    assert values(bench, "use_sim_time") == [False]


def test_values_are_those_of_the_arm(bench):
    verbs = bench.world.verbs
    assert values(bench, "preset_streaming_cmd", "frame", "nope", "wait_period") == [
        "none", "base", None, verbs.get_parameter("waitPeriodMs"),
    ]  # fmt: skip
    verbs.set_parameter("cpf", "cpft")
    assert values(bench, "frame") == ["tcp"]


def test_descriptors_say_what_is_accepted(bench):
    names = [each.name for each in PARAMETERS]
    answer = bench.call("/describe_parameters", {"names": names}).answer
    for each in answer["descriptors"]:
        assert each["description"]
        assert bool(each["floating_point_range"]) == (each["type"] == 3)
        assert each["type"] == 3 or "one of" in each["additional_constraints"]
    types = bench.call("/get_parameter_types", {"names": names}).answer["types"]
    assert list(types) == [each["type"] for each in answer["descriptors"]]


def test_the_ends_of_every_range_are_what_the_arm_accepts(bench):
    answer = bench.call(
        "/describe_parameters", {"names": [each.name for each in PARAMETERS]}
    ).answer
    for each in answer["descriptors"]:
        for ends in each["floating_point_range"]:
            for end in (ends["from_value"], ends["to_value"]):
                assert set_each(bench, (each["name"], end)) == [""], each["name"]
                assert values(bench, each["name"]) == [end]
            assert "allowed" in set_each(bench, (each["name"], ends["to_value"] * 1.01 + 1.0))[0]


@pytest.mark.parametrize("text", ["pose", "twist", "joint", "none"])
def test_a_stream_is_chosen(bench, text):
    assert set_each(bench, ("preset_streaming_cmd", text)) == [""]
    assert values(bench, "preset_streaming_cmd") == [text]


def test_each_is_set_for_itself(bench):
    reasons = set_each(
        bench, ("frame", "tcp"), ("frame", "world"), ("gain", 0.1), ("gain", 99.0), ("gain", 1),
        ("nope", 1.0), ("wait_period", 10.0),
    )  # fmt: skip
    assert [not reason for reason in reasons] == [True, False, True, False, False, False, True]
    assert reasons[1] == "frame: allowed are base, tcp, not 'world'"
    assert reasons[4] == "gain: it is a double, not integer: write 1.0"
    assert values(bench, "frame", "gain", "wait_period") == ["tcp", 0.1, 10.0]


def test_a_group_is_set_whole_or_not_at_all(bench):
    before = values(bench, "frame", "gain")
    refused = set_all(bench, ("frame", "tcp"), ("gain", 99.0))
    assert not refused["successful"]
    assert refused["reason"] == "gain: allowed are 0 to 10, not 99.0"
    assert values(bench, "frame", "gain") == before
    assert set_all(bench, ("frame", "tcp"), ("gain", 0.2))["successful"]
    assert values(bench, "frame", "gain") == ["tcp", 0.2]


def test_what_the_arm_refuses_for_now_is_answered(bench):
    assert bench.world.verbs.movv([0, 0, -0.02, 0, 0, 0], source="ros2")
    bench.world.tick(10)
    reason = set_each(bench, ("frame", "tcp"))[0]
    assert "refused while in ccvc" in reason
    assert not set_all(bench, ("frame", "tcp"), ("gain", 0.2))["successful"]
    assert values(bench, "frame") == ["base"]


def test_who_has_no_authority_sets_nothing(bench):
    bench.world.verbs.set_parameter("cpf", "cpfb", source="somebody")
    bench.world.verbs.movv([0, 0, -0.02, 0, 0, 0], source="somebody")
    bench.world.verbs.stop()
    bench.world.rest()
    assert "somebody" in set_each(bench, ("frame", "tcp"))[0]


def test_a_session_that_takes_no_commands_sets_nothing(bench):
    before = values(bench, "frame", "gain")
    bench.server.inhibited = "another node has the name /arm"
    assert "another node has the name" in set_each(bench, ("frame", "tcp"))[0]
    refused = set_all(bench, ("gain", 0.2))
    assert not refused["successful"]
    assert "another node has the name" in refused["reason"]
    assert values(bench, "frame", "gain") == before


def test_torque_streams_need_a_robot_that_takes_torque():
    from cardan.types import CommandKind

    bench = Bench(commands=frozenset({CommandKind.JOINT}))
    assert "torque" in set_each(bench, ("preset_streaming_cmd", "wrench"))[0]


def test_too_many_at_once_are_refused(bench):
    pairs = [("frame", "tcp")] * (MAX_SET + 1)
    reasons = set_each(bench, *pairs)
    assert len(reasons) == MAX_SET + 1
    assert all("at most 64" in reason for reason in reasons)
    assert not set_all(bench, *pairs)["successful"]
    assert values(bench, "frame") == ["base"]


def test_nothing_to_set_is_set(bench):
    assert set_each(bench) == []
    assert set_all(bench)["successful"]


@pytest.mark.parametrize(
    "service",
    ["get_parameters", "set_parameters", "set_parameters_atomically", "list_parameters",
     "describe_parameters", "get_parameter_types", "get_type_description"],
)  # fmt: skip
def test_what_is_no_request_is_refused(bench, service):
    answer = bench.call(f"/{service}", data=b"\0\1\0\0\1").answer
    if service == "set_parameters":
        (result,) = answer["results"]
        assert not result["successful"]
        assert service in result["reason"]
    elif service == "set_parameters_atomically":
        assert not answer["result"]["successful"]
        assert service in answer["result"]["reason"]
    elif service == "get_type_description":
        assert not answer["successful"]
        assert service in answer["failure_reason"]
    else:
        kind = bench.node.types[f"{NODE}/{service}"]
        assert answer == default_message(f"{kind}_Response")
    assert bench.server.refused == bench.malformed == 1


def test_types_are_described(bench):
    answer = bench.call("/get_type_description", {"type_name": "geometry_msgs/msg/Pose"}).answer
    assert answer["successful"]


def test_changes_of_each_client_are_published(bench):
    verbs, parameters = bench.world.verbs, bench.server.parameters

    def events():
        heard = bench.heard("/parameter_events")
        return [[p["name"] for p in each["changed_parameters"]] for each in heard]

    parameters.observe(verbs.get_parameters(), 5)
    (first,) = bench.heard("/parameter_events")
    assert first["node"] == "/arm"
    assert len(first["new_parameters"]) == len(RULES) + 1
    verbs.set_parameter(Parameter.FRAME, "cpft", source="ros2")
    parameters.observe(verbs.get_parameters(), 6)
    parameters.observe(verbs.get_parameters(), 7)
    set_each(bench, ("gain", 0.3), ("preset_streaming_cmd", "twist"))
    parameters.observe(verbs.get_parameters(), 8)
    assert events()[1:] == [["frame"], ["preset_streaming_cmd", "gain"]]
