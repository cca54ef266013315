"""Codes and parameters of the Cartesian interface."""

import math

import pytest

from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.arm import parameters, vocab as codes
from cardan.gateway.arm.vocab import FrameCode, Parameter, Stream, vocab, vocab_text

REQUESTS = {
    "stat": 1952543859, "inv": 7761513, "movj": 1786146669, "relj": 1785488754,
    "movl": 1819701101, "movv": 1987473261, "gcmp": 1886217063, "forc": 1668444006,
    "stop": 1886352499, "wait": 1953063287, "tool": 1819242356, "act": 7627617,
}  # fmt: skip
"""Codes that the tests also look up by name."""
INTEGERS = {
    "ok": 27503, "fail": 1818845542, "set": 7628147, "get": 7628135, "nset": 1952805742,
    "pose": 1702063984, "twst": 1953724276, "wrnc": 1668182647,
    "ccnc": 1668178787, "ccjc": 1667916643, "cclc": 1668047715, "ccvc": 1668703075,
    "ccgc": 1667720035, "ccfc": 1667654499,
    "acn": 7234401, "accg": 1734566753, "acog": 1735353185, "acsg": 1735615329, "acg": 6775649,
    "prms": 1936552560, "cpcg": 1734570083, "cptd": 1685352547, "cpts": 1937010787,
    "cpta": 1635020899, "cpcp": 1885565027, "cpwp": 1886875747, "cpf": 6713443,
    "cpsc": 1668509795, "cpfb": 1650880611, "cpft": 1952870499,
}  # fmt: skip


def test_every_code_of_the_field_has_its_integer():
    members = {
        int(member)
        for group in vars(codes).values()
        if isinstance(group, type) and issubclass(group, codes.enum.IntEnum)
        for member in group
    }
    for text, integer in (REQUESTS | INTEGERS).items():
        assert vocab(text) == integer
        assert vocab_text(integer) == text
    assert members >= {*INTEGERS.values()}


@pytest.mark.parametrize("text", ["", "fives"])
def test_a_code_has_one_to_four_characters(text):
    with pytest.raises(ValueError, match="code"):
        vocab(text)


@pytest.mark.parametrize("code", [0, -1, 1 << 32])
def test_an_integer_may_be_no_code(code):
    with pytest.raises(ValueError, match="code"):
        vocab_text(code)


def test_defaults_are_those_of_the_field():
    found = {rule.name: rule.default for rule in parameters.RULES}
    assert found["controllerGain"] == 0.05
    assert found["trajectoryDuration"] == 0.0
    assert found["trajectoryRefSpeed"] == 0.05
    assert found["trajectoryRefAccel"] == 0.02
    assert found["cmcPeriodMs"] == 50.0
    assert found["waitPeriodMs"] == 30.0
    assert found["referenceFrame"] == FrameCode.BASE
    assert found["streamingCommand"] == Stream.NONE


def test_a_parameter_has_a_code_and_a_name():
    for key in ("cpts", int(Parameter.TRAJECTORY_SPEED), Parameter.TRAJECTORY_SPEED):
        assert parameters.find_rule(key).name == "trajectoryRefSpeed"
    for key in ("prms", "nonsense", 5, ""):
        with pytest.raises(ConfigurationError, match="no such parameter; allowed: controllerGain"):
            parameters.find_rule(key)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("cpcg", -0.1), ("cpcg", math.nan), ("cptd", -1), ("cptd", math.inf), ("cpts", 0.0),
        ("cpta", -1.0), ("cpcp", 0), ("cpwp", 0), ("cpf", "cpfx"), ("cpf", 3), ("cpf", 1e400),
        ("cpsc", "movj"), ("cpsc", math.nan), ("cpjs", 1.5), ("cpjs", 0.0), ("cpts", True),
        ("cpts", "fast"), ("cpst", 0.6), ("cpts", 6.0), ("cptj", 1e300), ("cpda", 0.05),
        ("cpf", 1650880611.5), ("cppf", "tooo long"),
    ],
)  # fmt: skip
def test_a_value_that_is_not_accepted_is_named(key, value):
    with pytest.raises(OptionError, match="must be"):
        parameters.checked_value(parameters.find_rule(key), value)


@pytest.mark.parametrize("value", ["cpft", FrameCode.TCP, 1952870499, 1952870499.0])
def test_a_code_is_taken_as_text_integer_or_double(value):
    assert parameters.checked_value(parameters.find_rule("cpf"), value) == 1952870499.0


def test_a_parameter_is_given_once():
    with pytest.raises(ConfigurationError, match="twice"):
        parameters.checked_group({"cpts": 1.0, "trajectoryRefSpeed": 2.0})


def test_feedback_gain():
    assert parameters.feedback_gain_1_s(0.05, 50.0) * 0.01 == pytest.approx(0.01)
