"""Values: conversions compared with the libraries themselves, equality, and JSON."""

import copy
import enum
import inspect
import json
import math
import pickle
from types import UnionType
from typing import Union, get_args, get_origin

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

import cardan
from cardan import ConfigurationError, from_json, spatial, to_json, types
from cardan.common import value_json
from cardan.types import (
    IDENTITY,
    IDENTITY_POSE,
    NEVER_S,
    ZERO3,
    ZERO_TWIST,
    Frame,
    Pose,
    Quaternion,
    RobotCommand,
    Twist,
    Vector3,
    Wrench,
)

components = st.floats(-10.0, 10.0)
vectors = st.builds(Vector3, components, components, components)
quaternions = st.builds(spatial.from_rotation_vector, vectors)
poses = st.builds(Pose, vectors, quaternions, st.sampled_from(Frame))

TURN = Quaternion(0.5, 0.1, -0.7, math.sqrt(0.25))
POSE = Pose(Vector3(0.4, -0.2, 0.6), spatial.normalized(TURN))

# -- other libraries ------------------------------------------------------------------------------


def test_a_quaternion_names_its_order():
    q = Quaternion(w=1.0, x=2.0, y=3.0, z=4.0)
    assert q.wxyz() == (1.0, 2.0, 3.0, 4.0)
    assert q.xyzw() == (2.0, 3.0, 4.0, 1.0)
    assert Quaternion.from_wxyz(np.array(q.wxyz())) == Quaternion.from_xyzw([*q.xyzw()]) == q
    with pytest.raises(ValueError, match="unpack"):
        Quaternion.from_xyzw([1.0, 2.0, 3.0])


@given(quaternions, vectors)
def test_scipy_turns_as_we_do(q, v):
    turned = q.as_scipy()
    assert isinstance(turned, Rotation)
    assert turned.apply(v) == pytest.approx(spatial.rotate(q, v), abs=1e-9)
    back = Quaternion.from_xyzw(turned.as_quat())
    assert spatial.norm(spatial.rotation_between(q, back)) < 1e-7


@given(poses, vectors)
def test_a_matrix_moves_points_as_we_do(pose, point):
    matrix = pose.matrix()
    assert matrix.shape == (4, 4)
    assert matrix.dtype == np.float64
    moved = spatial.transform(pose, point)
    assert matrix @ [*point, 1.0] == pytest.approx([*moved, 1.0], abs=1e-9)


@given(poses)
def test_pinocchio_has_the_same_matrix(pose):
    se3 = pose.as_se3()
    assert isinstance(se3, pin.SE3)
    assert se3.homogeneous == pytest.approx(pose.matrix(), abs=1e-12)
    seven = pin.SE3ToXYZQUAT(se3)
    near = spatial.same_hemisphere(Quaternion.from_xyzw(seven[3:]), pose.orientation)
    assert [*seven[:3], *near.xyzw()] == pytest.approx([*pose.position, *pose.orientation.xyzw()])


@given(poses)
def test_a_matrix_is_the_pose_again(pose):
    for matrix in (pose.matrix(), pose.matrix().tolist(), pose.as_se3().homogeneous):
        back = Pose.from_matrix(matrix, pose.frame)
        assert back.position == pose.position
        assert back.frame is pose.frame
        near = spatial.same_hemisphere(back.orientation, pose.orientation)
        assert [*near] == pytest.approx([*pose.orientation], abs=1e-9)


def test_a_matrix_of_single_precision_is_taken():
    back = Pose.from_matrix(POSE.matrix().astype(np.float32))
    assert [*back.orientation] == pytest.approx([*POSE.orientation], abs=1e-6)


MATRIX = POSE.matrix()


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (MATRIX[:3], "four rows"),
        (MATRIX[:3, :3], "four rows"),
        (MATRIX.T, "last row"),
        (MATRIX * [[1.0], [1.0], [1.0], [2.0]], "last row"),
        (MATRIX * [1.1, 1.1, 1.1, 1.0], "not a rotation"),
        (MATRIX * [-1.0, 1.0, 1.0, 1.0], "not a rotation"),
        (MATRIX + np.eye(4, k=1) * [0.0, 0.01, 0.0, 0.0], "not a rotation"),
        (MATRIX * [0.0, 0.0, 0.0, 1.0], "not a rotation"),
        ([*MATRIX[:2], [math.nan, 0.0, 1.0, 0.0], MATRIX[3]], "no direction|not a rotation"),
        ([*MATRIX[:2], [*MATRIX[2, :3], math.inf], MATRIX[3]], "not finite"),
    ],
)
def test_what_is_no_rigid_motion_is_refused(matrix, words):
    with pytest.raises(ValueError, match=words):
        Pose.from_matrix(matrix)


@pytest.mark.parametrize("turns", range(4))
def test_half_turns_have_an_exact_matrix(turns):
    q = Quaternion(*(float(i == turns) for i in range(4)))
    assert spatial.from_rows(spatial.to_rows(q)) == q


PARTS = {
    "Pose": {"position": "Point", "orientation": "Quaternion"},
    "Twist": {"linear": "Vector3", "angular": "Vector3"},
    "Wrench": {"force": "Vector3", "torque": "Vector3"},
}
"""Types of the parts of ROS messages."""


def test_rosbags_writes_and_reads_our_messages():
    store = get_typestore(Stores.ROS2_HUMBLE)

    def message(name, table):
        kind = store.types[f"geometry_msgs/msg/{name}"]
        parts = {
            key: message(PARTS[name][key], each) if isinstance(each, dict) else each
            for key, each in table.items()
        }
        return kind(**parts)

    for value in (POSE, Twist(Vector3(1, 2, 3), Vector3(4, 5, 6)), Wrench(ZERO3, Vector3(1, 2, 3))):
        name = type(value).__name__
        full = f"geometry_msgs/msg/{name}"
        packet = store.serialize_cdr(message(name, value.to_ros()), full)
        read = store.deserialize_cdr(packet, full)
        for part, numbers in value.to_ros().items():
            assert vars(getattr(read, part)).items() >= numbers.items()
    assert read.torque.z == 3.0


def test_a_pose_of_ros_is_the_pose_again():
    assert POSE.to_ros()["orientation"] == dict(zip("xyzw", POSE.orientation.xyzw(), strict=True))
    assert Pose.from_ros(POSE.to_ros()) == POSE


# -- equality -------------------------------------------------------------------------------------


def test_a_twist_is_no_wrench():
    twist, wrench = Twist(ZERO3, ZERO3), Wrench(ZERO3, ZERO3)
    assert not twist == wrench  # noqa: SIM201
    assert not wrench == twist  # noqa: SIM201
    assert twist != wrench
    assert wrench != twist
    assert {twist: 1, wrench: 2} == {wrench: 2, twist: 1}
    assert len({twist, wrench}) == 2
    assert types.TwistCommand(twist) != types.TwistCommand(wrench)


@pytest.mark.parametrize("kind", [Twist, Wrench])
def test_equal_values_are_equal_and_have_one_hash(kind):
    value, same = kind(Vector3(1, 2, 3), ZERO3), kind(Vector3(1, 2, 3), ZERO3)
    assert value == same
    assert not value != same  # noqa: SIM202
    assert hash(value) == hash(same)
    assert value != kind(Vector3(1, 2, 3), ZERO3, Frame.TOOL)
    assert value == tuple(value)
    assert tuple(value) == value
    assert value != 0
    for copied in (pickle.loads(pickle.dumps(value)), copy.deepcopy(value)):
        assert copied == value
        assert type(copied) is kind


# -- JSON -----------------------------------------------------------------------------------------

KINDS = [
    kind for _, kind in inspect.getmembers(types, inspect.isclass)
    if issubclass(kind, tuple) and kind.__module__ == types.__name__
]  # fmt: skip
COMMANDS = RobotCommand.__args__
NO_UNIT = {"x", "y", "z", "w", "roll", "pitch", "yaw", "battery", "rumble", "utilization"}
"""Numbers without a unit: shares, deflections, and components whose field names it."""


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_number_has_its_unit_in_its_key(kind):
    units = ("_m", "_s", "_s2", "_rad", "_n", "_nm")
    for name, hint in value_json.hints(kind).items():
        key = value_json.key_of(kind, name)
        if "float" in str(hint) or "Vector3" in str(hint):
            assert key in NO_UNIT or key.endswith(units)
    assert value_json.UNITS.get(kind, {}).keys() <= {*kind._fields}


def example(hint, *, full):
    """Return a value that `hint` allows: with all optional parts, or with none."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return example(inner[0], full=True) if full else None
    if origin in (tuple, frozenset):
        return origin([example(inner[0], full=full)] if full else [])
    if hasattr(hint, "_fields"):
        fields = value_json.hints(hint).items()
        given = {name: example(each, full=full) for name, each in fields if name != "kind"}
        return hint(**given)
    if issubclass(hint, enum.Enum):
        return [*hint][-1 if full else 0]
    return {float: 0.1 if full else NEVER_S, int: 7, bool: full, str: "µ\0"}[hint]


@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_value_comes_back(kind, full):
    value = example(kind, full=full)
    text = json.dumps(to_json(value), allow_nan=False)
    back = from_json(kind, json.loads(text))
    assert back == value
    assert repr(back) == repr(value)
    assert hash(back) == hash(value)
    if kind in COMMANDS:
        assert from_json(RobotCommand, json.loads(text)) == value


@given(poses)
def test_numbers_come_back_to_the_last_bit(pose):
    assert from_json(Pose, json.loads(json.dumps(to_json(pose)))) == pose


def test_a_pose_is_readable():
    assert to_json(IDENTITY_POSE) == {
        "position_m": {"x": 0.0, "y": 0.0, "z": 0.0},
        "orientation": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0},
        "frame": "base",
    }
    assert to_json(Twist(ZERO3, ZERO3, Frame.MIXED)).keys() == {
        "linear_m_s", "angular_rad_s", "frame"
    }  # fmt: skip
    assert to_json(NEVER_S) == "-inf"


def wrong(table, **changes):
    return {**to_json(table), **changes}


@pytest.mark.parametrize(
    ("kind", "table", "words"),
    [
        (Pose, [1, 2], "must be an object"),
        (
            Pose,
            wrong(POSE, position={}),
            "position: a Pose has no such key; did you mean .position_m",
        ),
        (Pose, {"position_m": to_json(ZERO3)}, "orientation: a Pose needs it"),
        (Pose, wrong(POSE, frame="world"), "frame: 'world' is not allowed; it must be one of base"),
        (Pose, wrong(POSE, position_m={"x": 0, "y": "1", "z": 0}), "position_m.y: '1' is not"),
        (Pose, wrong(POSE, position_m={"x": 0, "y": True, "z": 0}), "position_m.y: True"),
        (Pose, wrong(POSE, orientation=[1, 0, 0, 0]), "orientation: .* must be an object"),
        (types.TorqueCommand, {"torques_nm_or_n": 3.0}, "torques_nm_or_n: 3.0 .* a list"),
        (types.TorqueCommand, {"torques_nm_or_n": [], "kind": "hold"}, "kind: 'hold'"),
        (RobotCommand, {}, "kind: None is not allowed; it must be one of hold"),
        (
            RobotCommand,
            {"kind": "twist", "twist": wrong(ZERO_TWIST, linear_m_s={"x": 1})},
            "twist.linear_m_s.y: a Vector3 needs",
        ),
    ],
)
def test_what_is_wrong_is_named(kind, table, words):
    with pytest.raises(ConfigurationError, match=words):
        from_json(kind, table)


def test_the_functions_are_cardans():
    assert {"to_json", "from_json"} <= {*cardan.__all__}
    assert IDENTITY.wxyz()[0] == 1.0
