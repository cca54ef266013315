"""Packets of requests and replies: decoding inverts encoding, and no bytes raise."""

import contextlib
import json
import math

import pytest
from hypothesis import given, strategies as st

from cardan import errors
from cardan.errors import CardanError, ConfigurationError, MotionRefusedError
from cardan.gateway.arm.requests import (
    MAX_REQUEST_BYTES,
    MotionNote,
    PacketError,
    Reply,
    Request,
    decode_answer,
    decode_request,
    encode_error,
    encode_note,
    encode_reply,
    encode_request,
    result_of,
)
from cardan.gateway.arm.status import AuthorityState
from cardan.gateway.arm.verb_results import ControllerStatus, Motion, Outcome, Stat
from cardan.gateway.arm.verb_table import IN_PACKETS
from cardan.gateway.arm.vocab import Action, Begins, Parameter, State, Stream
from cardan.gateway.servo.status import ServoStatus
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor_heartbeat import BEAT
from cardan.types import Frame, Pose, Quaternion, Twist, Vector3, Wrench

POSE = Pose(Vector3(0.4, 0.1, 0.3), Quaternion(0.5, 0.5, 0.5, 0.5))
SIX = [0.1, 0.0, -0.1, 0.0, 0.2, 0.0]


def arrived(verb, value=None, sequence=None):
    """Encode and decode a request; return its value, and its sequence if it has one."""
    packet = encode_request(Request(7, "pendant", verb, value, sequence))
    assert len(packet) < MAX_REQUEST_BYTES
    assert packet != BEAT
    request = decode_request(packet)
    assert request[:3] == (7, "pendant", verb)
    return request.value if sequence is None else (request.value, request.sequence)


VALUES = {
    "inv": (POSE, POSE),
    "rehearse_line": (POSE, POSE),
    "rehearse_joints": ((0.1,) * 7, [0.1] * 7),
    "movj": (POSE, POSE),
    "relj": (POSE, POSE),
    "movl": (POSE, POSE),
    "retract": (0.1, 0.1),
    "movv": (SIX, SIX),
    "forc": (tuple(SIX), SIX),
    "wait": (2, 2.0),
    "tool": (POSE, POSE),
    "act": (Action.CLOSE, int(Action.CLOSE)),
    "pose": (POSE, POSE),
    "jog": (POSE, POSE),
    "twist": (SIX, SIX),
    "wrench": (SIX, SIX),
    "joints": ((0.1,) * 7, [0.1] * 7),
    "hand_over": ("device", "device"),
    "get_parameter": ("poseDamping", int(Parameter.DAMPING)),
    "set_parameters": (
        {"cpsc": "twst", "trajectoryRefSpeed": 0.1},
        {Parameter.STREAM: float(Stream.TWIST), Parameter.TRAJECTORY_SPEED: 0.1},
    ),
}


@pytest.mark.parametrize("verb", IN_PACKETS)
def test_every_verb_travels(verb):
    sent, expected = VALUES.get(verb, (None, None))
    assert arrived(verb, sent) == expected


@pytest.mark.parametrize(
    "request_",
    [
        Request(7, "page", "twist", Twist(Vector3(0.1, 0, 0), Vector3(0, 0, 1), Frame.MIXED), 3),
        Request(7, "page", "twist", SIX, 3, stamp_s=1234.5, begins=Begins.NEW),
        Request(7, "page", "joints", [0.1] * 7, 4, stamp_s=0.25, begins=Begins.GOING_ON),
        Request(7, "page", "joints", [0.0] * 7, begins=Begins.REST),
        Request(7, "page", "wrench", Wrench(Vector3(1, 2, 3), Vector3(0, 0, 0), Frame.TOOL)),
    ],
)
def test_a_streamed_command_travels_with_all_that_it_has(request_):
    assert decode_request(encode_request(request_)) == request_


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"begins": "now"}, "allowed: new, going on, rest"),
        ({"begins": None}, "allowed"),
        ({"stamp": "1"}, "takes numbers"),
        ({"stamp": None}, "takes numbers"),
        ({"frame": "world"}, "allowed: base, tool, mixed"),
        ({"frame": ["base"]}, "allowed"),
    ],
)
def test_what_a_streamed_command_cannot_have_is_refused(more, words):
    packet = {"id": 1, "source": "page", "verb": "twist", "value": SIX, **more}
    with pytest.raises(PacketError, match=words):
        decode_request(json.dumps(packet).encode())
    with pytest.raises(PacketError, match="takes no"):
        decode_request(json.dumps({**packet, "verb": "movv", "frame": "base"}).encode())


def test_a_wrench_has_no_mixed_frame():
    packet = {"id": 1, "source": "page", "verb": "wrench", "value": SIX, "frame": "mixed"}
    with pytest.raises(PacketError, match="allowed: base, tool"):
        decode_request(json.dumps(packet).encode())


def test_all_parameters_fit_into_a_packet():
    values = dict.fromkeys(Parameter, 0.123456789012345)
    pairs = [[int(key), value] for key, value in values.items()]
    packet = json.dumps({"id": 1, "source": "x" * 64, "verb": "set_parameters", "value": pairs})
    assert 4 * len(packet) < MAX_REQUEST_BYTES * 3


def test_streams_have_numbers():
    assert arrived("twist", SIX, 5) == (SIX, 5)


@pytest.mark.parametrize(
    ("verb", "value", "words"),
    [
        ("movj", [0.0, math.nan, 0.0, 0.0, 0.0, 0.0], "number 2 of 6 is nan"),
        ("movl", [0.0] * 5, "six numbers, not 5"),
        ("twist", "fast", "twist takes six numbers"),
        ("joints", [math.inf], "number 1 of 1 is inf"),
        ("joints", 3, "takes numbers"),
        ("wait", -1.0, "a timeout is a number >= 0"),
        ("hand_over", "", "a name of 1 to 64"),
    ],
)
def test_arguments_that_a_verb_does_not_take_are_refused_before_they_leave(verb, value, words):
    with pytest.raises(MotionRefusedError, match=words):
        encode_request(Request(1, "verbs", verb, value))


def test_parameters_that_do_not_exist_are_refused_before_they_leave():
    for verb, value in (("get_parameter", "speed"), ("set_parameters", {"speed": 1.0})):
        with pytest.raises(ConfigurationError, match="no such parameter"):
            encode_request(Request(1, "verbs", verb, value))


@pytest.mark.parametrize(
    ("packet", "words", "number"),
    [
        (b"", "not JSON", None),
        (b"beat ", "not JSON", None),
        (b"[]", "not an object", None),
        (b"[" * 4000, "not JSON", None),
        (b'{"id":1}' + b" " * MAX_REQUEST_BYTES, "at most 4096 bytes", None),
        (b'{"id":true}', "id: True", None),
        (b'{"id":-1}', "id: -1", None),
        (b'{"id":1e999}', "not JSON", None),
        (b'{"id":NaN}', "not JSON", None),
        (b'{"id":1}', "source", 1),
        (b'{"id":1,"source":"device","verb":"stop"}', "operator device", 1),
        (b'{"id":1,"source":"a","verb":"fly"}', "there is no 'fly'; allowed: stat, inv", 1),
        (b'{"id":1,"source":"a","verb":[]}', "there is no", 1),
        (b'{"id":1,"source":"a","verb":"stop","value":1}', "takes no 'value'", 1),
        (b'{"id":1,"source":"a","verb":"movj"}', "takes a list of numbers, not None", 1),
        (b'{"id":1,"source":"a","verb":"movj","value":[1,2]}', "6 or 7 numbers, not 2", 1),
        (b'{"id":1,"source":"a","verb":"movv","value":[1,2,3,4,5,true]}', "not True", 1),
        (
            b'{"id":1,"source":"a","verb":"movv","value":[1,2,3,4,5,1' + b"0" * 400 + b"]}",
            "too large",
            1,
        ),
        (b'{"id":1,"source":"a","verb":"twist","value":[0,0,0,0,0,0],"sequence":0.5}', "0.5", 1),
        (b'{"id":1,"source":"a","verb":"set_parameters","value":[[1]]}', "pairs", 1),
        (b'{"id":1,"source":"a","verb":"set_parameters","value":[["cpts",1],["cpts",2]]}', "tw", 1),
        (b'{"id":1,"source":"a","verb":"set_parameters","value":[["nil",1]]}', "no such par", 1),
    ],
)
def test_what_is_no_request_says_why_and_for_whom(packet, words, number):
    with pytest.raises(PacketError, match=words.replace("[", r"\[")) as refused:
        decode_request(packet)
    assert refused.value.request == number


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=80),
    lambda each: st.lists(each, max_size=8) | st.dictionaries(st.text(max_size=8), each),
    max_leaves=12,
)
requests = st.fixed_dictionaries(
    {"id": st.integers(0, 9), "source": st.just("a"), "verb": st.sampled_from(IN_PACKETS)},
    optional={"value": json_values, "sequence": json_values, "more": json_values},
)


@given(st.binary(max_size=300) | requests.map(lambda table: json.dumps(table).encode()))
def test_no_bytes_raise_anything_else(packet):
    for decode in (decode_request, decode_answer):
        with contextlib.suppress(PacketError):
            decode(packet)


@given(
    st.sampled_from([b'{"reply":', b'{"motion":']),
    json_values.map(json.dumps) | st.text(max_size=20),
    st.sampled_from(["", ',"error":{"kind":"JointLimitError"}', ',"error":3', ',"result":1e999']),
)
def test_no_reply_raises_anything_else(start, text, more):
    with contextlib.suppress(PacketError):
        decode_answer(start + f"{text}{more}}}".encode())


# -- replies --------------------------------------------------------------------------------------


def result(verb, value):
    reply = decode_answer(encode_reply(3, value))
    assert reply.id == 3
    assert reply.error is None
    return result_of(verb, reply.result)


def test_results_come_as_they_were():
    stat = Stat((0.1, 0.2, 0.3, 0.0, 0.0, 3.0), State.MOVL, 12.5)
    assert result("stat", stat) == stat
    stat = stat._replace(joints=(0.1, -0.2), target=stat.pose, twist=(0.1, 0, 0, 0, 0, 0.2))
    assert result("stat", stat) == stat
    stat = stat._replace(heard=False)
    assert result("stat", stat) == stat
    assert result("inv", (0.1, 0.2)) == (0.1, 0.2)
    assert result("wait", True) is True
    assert result("twist", "why not") == "why not"
    assert result("get_parameters", {"cpts": 0.1}) == {"cpts": 0.1}
    servo = ServoStatus(
        1.0, 0.2, 0.0, ("elbow",), math.inf, ("a", "b"), 0, 0.0, 0.0, 0.0, 0.0, 1, 7, True, "inf"
    )  # fmt: skip
    status = ControllerStatus(
        State.NOT_CONTROLLING, Stream.TWIST, True, False, False, False, False, "", "pendant",
        math.inf, 1, 2, 0.01, "elbow", 3, 4, "no", None, servo,
        AuthorityState("", -math.inf, ""),
    )  # fmt: skip
    back = result("status", status)
    assert back == status
    assert isinstance(back.state, State)
    assert isinstance(back.servo, ServoStatus)


@pytest.mark.parametrize(
    "error",
    [
        errors.OutOfReachError("far", 0.5, 0.1),
        errors.JointLimitError("bent", "elbow", 3.0, 2.5),
        errors.CollisionError("bump", ("hand", "table"), 0.4),
        errors.MotionRefusedError("no"),
        errors.MotionLoopError("ended"),
        errors.ConfigurationError("speed", "no such parameter"),
        PacketError("no JSON"),
    ],
)
def test_errors_come_as_themselves(error):
    back = decode_answer(encode_error(None, error)).error
    assert type(back) is type(error)
    assert str(back) == str(error)
    reported = {key: value for key, value in vars(error).items() if key != "request"}
    assert {key: getattr(back, key) for key in reported} == reported


def test_an_option_that_is_refused_comes_as_the_configuration_error_that_it_is():
    error = errors.OptionError("cpts", 9.0, "0.0001 to 5 m/s")
    back = decode_answer(encode_error(1, error)).error
    assert type(back) is errors.ConfigurationError
    assert (str(back), back.key) == (str(error), "cpts")


def test_an_error_of_another_kind_is_at_least_one_of_ours():
    back = decode_answer(encode_error(1, errors.CommandError("no outputs"))).error
    assert type(back) is CardanError


def test_a_motions_note_makes_it_again():
    note = MotionNote(4, "movl", "pendant", True, Outcome.ABORTED, "stopped", "slow", math.inf)
    back = decode_answer(encode_note(note))
    assert back == note
    motion = Motion("movl", True)
    back.update(motion)
    assert (motion.outcome, motion.reason, motion.note) == (Outcome.ABORTED, "stopped", "slow")
    assert result("movl", note) == note


def test_a_snapshot_is_no_answer():
    assert decode_answer(Snapshot().to_bytes()) is None
    assert decode_answer(encode_reply(1, None)) == Reply(1, None, None)
