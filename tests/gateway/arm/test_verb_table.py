"""Table of verbs: every object with verbs has these, and a new verb needs one entry and one
method."""

import inspect
import math
from types import SimpleNamespace

import pytest

from cardan.cli.verbs import SET_ONE, carry_out, offered
from cardan.errors import ConfigurationError, MotionRefusedError
from cardan.gateway.arm.interface import CartesianArm
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.arm.verb_table import (
    IN_PACKETS,
    LARGEST_INTEGER,
    NEW_MOTION,
    NOTHING,
    SEQUENCED,
    VERB_TABLE,
    number,
)
from cardan.gateway.arm.vocab import Parameter, State
from cardan.gateway.bus.commands import ACTIONS, SERVICES, TOPICS
from cardan.spatial import from_rotation_vector, rotate
from cardan.types import Frame, Pose, Quaternion, Vector3
from tests.gateway.arm.arms import World

HAS = {"open", "close", "source", SET_ONE}
"""Members of an arm that are not verbs."""


def test_an_arm_has_the_verbs_of_the_table_and_no_others():
    public = {name for name in vars(CartesianArm) if not name.startswith("_")}
    assert public - HAS == set(IN_PACKETS)


@pytest.mark.parametrize("name", sorted(VERB_TABLE.keys() - SEQUENCED - {"wait"}))
def test_each_verb_is_a_method_that_takes_what_the_table_says(name):
    """The verb `wait` is left out, because the verb server implements it."""
    verb = VERB_TABLE[name]
    named = [*inspect.signature(getattr(ArmVerbs, verb.name)).parameters][1:]
    assert ("source" in named) is (verb.changes or verb.name == "stop")
    assert len([name for name in named if name != "source"]) == (verb.takes is not NOTHING)


@pytest.mark.parametrize("name", IN_PACKETS)
def test_each_verb_of_programs_has_the_signature_of_its_argument(name):
    verb = VERB_TABLE[name]
    named = [*inspect.signature(getattr(CartesianArm, name)).parameters.values()][1:]
    needed = [each for each in named if each.default is inspect.Parameter.empty]
    assert len(needed) <= (verb.takes is not NOTHING)


def test_what_the_network_has_is_of_the_table():
    for command in (*TOPICS, *SERVICES, *ACTIONS):
        assert command.verb in IN_PACKETS
    assert {each.verb for each in ACTIONS} < NEW_MOTION


class Arm:
    """Records the requests made to it."""

    def __getattr__(self, name):
        def asked(*values):
            self.asked = (name, *values)
            return SimpleNamespace() if name == "stat" else None

        return asked


POSE = Pose(Vector3(0.4, 0.0, 0.3), Quaternion(0.0, 1.0, 0.0, 0.0), Frame.BASE)


@pytest.mark.parametrize(
    ("words", "asked"),
    [
        ("movl 0.4 0 0.3 3.14 0 0", ("movl", [0.4, 0.0, 0.3, 3.14, 0.0, 0.0])),
        ("movl 0.4 0 0.3 0 1 0 0", ("movl", POSE)),
        ("retract 0.05", ("retract", 0.05)),
        ("movv 0 0 0.01 0 0 0", ("movv", [0.0, 0.0, 0.01, 0.0, 0.0, 0.0])),
        ("rehearse_joints 0 1 2", ("rehearse_joints", [0.0, 1.0, 2.0])),
        ("wait", ("wait", 0.0)),
        ("wait 2.5", ("wait", 2.5)),
        ("stop", ("stop",)),
        ("act close", ("act", "accg")),
        ("hand_over device", ("hand_over", "device")),
        ("get_parameter gain", ("get_parameter", "gain")),
        (
            "set_parameter trajectoryRefSpeed 0.1",
            ("set_parameters", {Parameter.TRAJECTORY_SPEED: 0.1}),
        ),
        (
            "set_parameters trajectoryRefSpeed 0.1 cpsc twst",
            ("set_parameters", {Parameter.TRAJECTORY_SPEED: 0.1, Parameter.STREAM: "twst"}),
        ),
    ],
)
def test_the_words_of_a_command_line(words, asked):
    arm = Arm()
    verb, *rest = words.split()
    carry_out(arm, verb, rest, wait=False)
    assert arm.asked == asked


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("fly 1", "VERB: there is no 'fly'; allowed: .*movl, retract"),
        ("twist 0 0 0 0 0 0", "there is no 'twist'"),
        ("trajectory", "there is no 'trajectory'"),
        ("movl 1 2", "movl: takes x y z .* not 2 values: 1 2"),
        ("retract", "takes a distance .m., not 0 values"),
        ("movv 0 0 z 0 0 0", "movv: 'z' is not a number"),
        ("set_parameters gain", "takes parameters, each with its value, not 1 value"),
        ("set_parameter nothing 1", "nothing"),
    ],
)
def test_words_that_are_no_command(words, said):
    arm = Arm()
    verb, *rest = words.split()
    with pytest.raises(ConfigurationError, match=said):
        carry_out(arm, verb, rest, wait=False)
    assert "asked" not in vars(arm)


def test_streams_are_of_no_command_line():
    assert not SEQUENCED & set(offered())


def test_retract_goes_back_along_the_tools_axis():
    world = World()
    start = world.six()
    axis = rotate(from_rotation_vector(Vector3(*start[3:])), Vector3(0.0, 0.0, 1.0))
    motion = world.verbs.retract(0.02)
    assert (motion.verb, motion.ends) == ("retract", True)
    assert world.verbs.state is State.MOVL
    world.rest()
    assert motion.outcome.value == "done"
    moved = [b - a for a, b in zip(start, world.six(), strict=True)]
    assert moved[:3] == pytest.approx([-0.02 * each for each in axis], abs=1e-3)
    assert moved[3:] == pytest.approx([0.0] * 3, abs=1e-3)


@pytest.mark.parametrize("distance_m", [-0.01, math.nan, math.inf, "far", 1e6])
def test_retract_takes_a_distance_and_nothing_else(distance_m):
    world = World()
    with pytest.raises(MotionRefusedError, match=r"^retract"):
        world.verbs.retract(distance_m)
    assert world.verbs.state is State.NOT_CONTROLLING


def test_nan_is_no_number():
    with pytest.raises(MotionRefusedError, match=r"^movl: takes numbers, not nan$"):
        number("movl", math.nan)


@pytest.mark.parametrize("sign", [-1, 1])
def test_numbers_go_up_to_the_largest_exact_integer(sign):
    assert number("movj", sign * LARGEST_INTEGER) == sign * LARGEST_INTEGER
    with pytest.raises(MotionRefusedError, match="too large a number"):
        number("movj", sign * (LARGEST_INTEGER + 1))
