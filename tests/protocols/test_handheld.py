"""Messages of pages about handheld devices: bytes, orientations, motions."""

import itertools
import json
import math

import pytest
from hypothesis import assume, example, given, strategies as st

from cardan.protocols.handheld.frames import (
    BodyPart,
    JogJoints,
    JogTwist,
    MalformedFrame,
    OperatorFrame,
    PhoneFrame,
    XrFrame,
    decode_frame,
    encode_frame,
)
from cardan.protocols.handheld.motion import (
    Held,
    PoseSample,
    Yaw,
    drag_on_screen,
    elsewhere,
    jump,
)
from cardan.protocols.handheld.orientation import (
    from_angles,
    heading_rad,
    orientation_from_xr,
    orientation_to_xr,
    position_from_xr,
    position_to_xr,
    to_angles,
)
from cardan.protocols.handheld.teleop import TeleopLog, TeleopPose, decode_teleop
from cardan.spatial import (
    from_rotation_vector,
    multiply,
    norm,
    rotate,
    rotation_between,
    subtract,
)
from cardan.types import IDENTITY, Quaternion, Vector3
from tests.protocols.handheld_vectors import FILE, FRAMES, REFUSED, text

X, Y, Z = Vector3(1.0, 0.0, 0.0), Vector3(0.0, 1.0, 0.0), Vector3(0.0, 0.0, 1.0)


def about(axis, degrees):
    half = math.radians(0.5 * degrees)
    sine = math.sin(half)
    return Quaternion(math.cos(half), axis.x * sine, axis.y * sine, axis.z * sine)


def near(a, b, allowed=1e-9):
    return norm(rotation_between(a, b)) <= allowed


turns = st.builds(
    lambda x, y, z: from_rotation_vector(Vector3(x, y, z)),
    *(st.floats(-1.7, 1.7) for _ in range(3)),
)


# -- frames ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", FRAMES)
def test_a_frame_comes_back_as_it_was(name):
    assert decode_frame(encode_frame(FRAMES[name])) == FRAMES[name]


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_frame_is_refused(name):
    assert isinstance(decode_frame(bytes.fromhex(REFUSED[name])), MalformedFrame)


def test_the_vectors_of_the_page_are_those_of_this_codec():
    assert FILE.read_text("utf-8") == text(), "run python -m tests.protocols.handheld_vectors"
    for each in json.loads(text())["frames"]:
        frame = decode_frame(bytes.fromhex(each["bytes"]))
        assert (frame.hold, frame.sequence) == (each["frame"]["hold"], each["frame"]["sequence"])


@given(st.binary(max_size=100))
def test_no_bytes_raise(data):
    decode_frame(data)


@given(st.sampled_from(list(FRAMES.values())), st.data())
def test_a_frame_with_a_wrong_byte_is_refused_or_fine(frame, data):
    changed = bytearray(encode_frame(frame))
    at = data.draw(st.integers(0, len(changed) - 1))
    changed[at] = data.draw(st.integers(0, 255))
    found = decode_frame(bytes(changed))
    if isinstance(found, OperatorFrame) and isinstance(found.body, JogTwist):
        assert all(map(math.isfinite, (*found.body.linear, *found.body.angular)))


@given(st.sampled_from(list(FRAMES.values())), st.integers(0, 90))
@example(OperatorFrame(JogJoints((0.5,)), True, True, True, 0, 0, 0), 16)
def test_a_frame_that_is_cut_is_refused(frame, length):
    data = encode_frame(frame)
    assume(length < len(data))
    assert isinstance(decode_frame(data[:length]), MalformedFrame)


def test_buttons_have_the_names_of_their_bits():
    assert FRAMES["phone, all there is"].held_buttons == ("a", "align")
    assert FRAMES["gamepad"].held_buttons == ("left-shoulder", "guide")
    assert FRAMES["jog rests"].held_buttons == ()


# -- orientation ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        ((0, 90, 0), (0.707107, 0.707107, 0, 0)),
        ((90, 0, 0), (0.707107, 0, 0, 0.707107)),
        ((0, 0, 45), (0.923880, 0, 0.382683, 0)),
        ((10, 20, 30), (0.943714, 0.144878, 0.268536, 0.127679)),
        ((350, -45, 20), (-0.900590, 0.361453, -0.192666, 0.145498)),
    ],
)
def test_check_values_of_the_phones_angles(angles, expected):
    assert from_angles(*angles) == pytest.approx(expected, abs=1e-6)


@given(st.floats(0, 359.99), st.floats(-180, 179.99), st.floats(-90, 89.99))
def test_the_quaternion_is_that_of_three_turns(alpha, beta, gamma):
    wanted = multiply(multiply(about(Z, alpha), about(X, beta)), about(Y, gamma))
    assert near(from_angles(alpha, beta, gamma), wanted, 1e-7)


@given(turns)
def test_angles_are_in_the_ranges_of_browsers_and_come_back(q):
    alpha, beta, gamma = to_angles(q)
    assert 0 <= alpha < 360
    assert -180 <= beta <= 180
    assert -90 <= gamma <= 90
    assert near(from_angles(alpha, beta, gamma), q, 1e-5)


@given(turns, st.sampled_from([X, Y, Z]), st.floats(-0.02, 0.02))
def test_a_small_turn_is_a_small_turn_wherever_the_phone_is(q, axis, angle):
    """Browser angles may jump by 180 degrees or be singular: the orientation does not."""
    turned = multiply(q, from_rotation_vector(Vector3(*(angle * each for each in axis))))
    before, after = from_angles(*to_angles(q)), from_angles(*to_angles(turned))
    assert norm(rotation_between(before, after)) == pytest.approx(abs(angle), abs=1e-5)


@pytest.mark.parametrize("beta", [90.0, -90.0])
def test_an_upright_phone_turns_steadily_though_its_angles_do_not(beta):
    start = from_angles(30, beta, 0)
    held, before = Held(PoseSample(0.0, start)), None
    for step in range(-40, 41):
        # Through the singular pose, about the phone's transverse and then its long axis.
        q = multiply(multiply(start, about(X, 0.5 * step)), about(Y, 0.25 * step))
        turn = held.turn(PoseSample(0.0, from_angles(*to_angles(q))))
        if before is not None:
            assert norm(subtract(turn, before)) < math.radians(0.8)
        before = turn


@pytest.mark.parametrize("side", [90.0, -90.0])
def test_a_phone_on_its_edge_turns_steadily_though_alpha_and_beta_jump(side):
    start = from_angles(200, 15, math.copysign(85.0, side))
    held = Held(PoseSample(0.0, start))
    angles, turned = [], []
    for step in range(21):
        q = multiply(start, about(Y, math.copysign(0.5 * step, side)))
        angles.append(to_angles(q))
        turned.append(norm(held.turn(PoseSample(0.0, from_angles(*angles[-1])))))
    assert max(abs(b[0] - a[0]) for a, b in itertools.pairwise(angles)) > 100
    assert turned == pytest.approx([math.radians(0.5 * step) for step in range(21)], abs=1e-6)


def test_where_a_phone_points():
    assert heading_rad(IDENTITY) == pytest.approx(math.pi / 2)  # flat: heading of its top edge, y
    assert heading_rad(from_angles(0, 90, 0)) == pytest.approx(math.pi / 2)  # upright: of its back
    assert heading_rad(from_angles(90, 30, 0)) == pytest.approx(math.pi)
    # A phone on its side counts as upright from 60 degrees on.
    assert heading_rad(from_angles(0, 55, 60)) == pytest.approx(math.pi / 2)
    assert heading_rad(from_angles(0, 65, 60)) == pytest.approx(
        math.atan2(0.5 * math.sin(math.radians(65)), -math.sin(math.radians(60)))
    )


@given(st.floats(-3, 3), st.floats(-80, 80))
def test_aligned_a_turn_is_along_the_robots_axes_wherever_north_is(north, tilt):
    """The operator tilts the phone's top edge up, facing along the robot's x axis."""
    turned = from_rotation_vector(Vector3(0.0, 0.0, north))
    rest, tipped = (multiply(turned, from_angles(0, tilt + each, 0)) for each in (0, 5))
    yaw = Yaw.of_phone(multiply(turned, IDENTITY))
    turn = yaw.vector(Held(PoseSample(0.0, rest)).turn(PoseSample(0.0, tipped)))
    # Nose up is the negative rotation about y, which points left.
    assert turn == pytest.approx((0.0, -math.radians(5), 0.0), abs=1e-9)


def test_a_drag_goes_as_it_is_seen_however_the_screen_is_turned():
    assert drag_on_screen(1.0, 0.0, 0) == (1.0, 0.0, 0.0)
    # Rotated to the left, the phone's right side is up.
    assert drag_on_screen(0.0, 1.0, 1) == (1.0, 0.0, 0.0)
    assert drag_on_screen(1.0, 0.0, 1) == (0.0, -1.0, 0.0)
    assert drag_on_screen(0.0, 1.0, 2) == (0.0, -1.0, 0.0)
    assert drag_on_screen(0.0, 1.0, 3) == (-1.0, 0.0, 0.0)


# -- WebXR ----------------------------------------------------------------------------------------


def test_axes_of_webxr():
    assert position_from_xr(Vector3(0, 0, -1)) == (1, 0, 0)  # forward
    assert position_from_xr(Vector3(1, 0, 0)) == (0, -1, 0)  # right
    assert position_from_xr(Vector3(0, 1, 0)) == (0, 0, 1)  # up


@given(turns, st.tuples(*(st.floats(-3, 3) for _ in range(3))))
def test_turning_in_webxr_is_turning_here(q, numbers):
    v = Vector3(*numbers)
    ours = rotate(orientation_from_xr(q), position_from_xr(v))
    assert ours == pytest.approx(position_from_xr(rotate(q, v)), abs=1e-9)
    assert position_to_xr(position_from_xr(v)) == v
    assert orientation_to_xr(orientation_from_xr(q)) == q
    # Rounding of a browser's unit quaternion is accepted.
    long = XrFrame(BodyPart.VIEWER, v, Quaternion(*(1.005 * each for each in q)), 0, 0, 0, 0, 0, 0)
    frame = decode_frame(encode_frame(OperatorFrame(long, True, True, True, 0, 0, 0)))
    assert frame.body.orientation == pytest.approx(q, abs=1e-6)


def test_a_hand_that_points_along_the_robot_is_its_x_axis():
    left = about(Z, 90)
    assert Yaw.of_xr(left).vector(Y) == pytest.approx(X, abs=1e-12)


# -- motion ---------------------------------------------------------------------------------------


def test_a_turn_goes_on_beyond_half_a_turn():
    held = Held(PoseSample(0.0, IDENTITY))
    angles = [held.turn(PoseSample(0.0, about(Z, degrees))).z for degrees in range(0, 300, 10)]
    assert angles == pytest.approx([math.radians(each) for each in range(0, 300, 10)])


def test_the_way_since_it_was_held():
    held = Held(PoseSample(0.0, IDENTITY, X))
    assert held.way(PoseSample(1.0, IDENTITY, Y)) == (-1.0, 1.0, 0.0)
    assert held.way(PoseSample(1.0, IDENTITY)) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("dt_s", "way_m", "angle_deg", "jumps"),
    [
        (0.016, 0.04, 0, False),
        (0.016, 0.06, 0, True),
        (0.1, 0.2, 0, False),  # Frames were lost, but the speed is plausible.
        (0.1, 0.4, 0, True),
        (0.016, 0.0, 30, False),
        (0.016, 0.0, 40, True),
        (0.1, 0.0, 90, False),
        (0.1, 0.0, 150, True),
        (-1.0, 0.06, 0, True),
    ],
)
def test_jumps(dt_s, way_m, angle_deg, jumps):
    before = PoseSample(5.0, IDENTITY, Vector3(0, 0, 0))
    now = PoseSample(5.0 + dt_s, about(X, angle_deg), Vector3(way_m, 0, 0))
    assert bool(jump(before, now)) is jumps
    # Independent of the time between; an unknown position counts as unchanged.
    assert elsewhere(before, now) is (way_m > 0.05 or angle_deg > 35)
    assert elsewhere(before._replace(position=None), now) is (angle_deg > 35)
    assert elsewhere(before, now._replace(position=None)) is (angle_deg > 35)


# -- teleop ---------------------------------------------------------------------------------------

TELEOP = {
    "type": "pose",
    "data": {
        "position": {"x": 0.1, "y": 1.2, "z": -0.3},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        "move": True,
        "scale": 0.5,
        "reservedButtonA": False,
        "reservedButtonB": True,
    },
}


def test_a_message_of_teleop_is_a_frame_of_the_viewer():
    pose = decode_teleop(json.dumps(TELEOP))
    assert pose == TeleopPose(Vector3(0.1, 1.2, -0.3), IDENTITY, True, False, True, 0.5)
    frame = pose.frame(7, 1000, 2)
    assert frame.body == XrFrame(BodyPart.VIEWER, Vector3(0.1, 1.2, -0.3), IDENTITY, 1 << 5)
    assert (frame.hold, frame.held_buttons, frame.sequence) == (True, ("b",), 7)
    assert decode_frame(encode_frame(frame)).held_buttons == ("b",)


def test_teleops_log_is_nothing_and_other_text_is_not_teleops():
    assert decode_teleop('{"type": "log", "data": "hello"}') == TeleopLog()
    for other in ("", "{", '{"op": "publish", "type": "pose"}', '{"type": "x"}', '[{"type": 1}]'):
        assert decode_teleop(other) is None


@pytest.mark.parametrize(
    "change",
    [
        {"position": {"x": 0, "y": 0}},
        {"position": {"x": 0, "y": 0, "z": "1"}},
        {"position": {"x": 0, "y": 0, "z": 1e300}},
        {"orientation": {"x": 0, "y": 0, "z": 0, "w": 0}},
        {"orientation": {"x": 0, "y": 0, "z": 0, "w": 1.011}},
        {"orientation": {"x": 0, "y": 0, "z": 0, "w": 0.989}},
        {"orientation": None},
        {"scale": True},
    ],
)
def test_a_message_of_teleop_that_is_none_is_refused(change):
    message = {"type": "pose", "data": {**TELEOP["data"], **change}}
    assert isinstance(decode_teleop(json.dumps(message)), MalformedFrame)


def test_only_true_holds():
    message = {"type": "pose", "data": {**TELEOP["data"], "move": "yes"}}
    assert decode_teleop(json.dumps(message)).move is False


def test_a_phone_without_sensors_has_no_angles():
    assert (
        decode_frame(encode_frame(OperatorFrame(PhoneFrame(None), False))).body.angles_deg is None
    )
