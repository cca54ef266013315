"""The simulated hand: all fields are present and consistent."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import pytest
from hypothesis import given, settings, strategies as st

from cardan.types import Vector3
from cardan_leap.peer import HandModel, HandPosture, rotation_rows
from cardan_leap.peer.hand_model import as_version, frame_document
from cardan_leap.protocol import hand_orientation, pitch_yaw_roll
from tests.examples import examples

HAND_FIELDS = {
    *("id", "type", "palmPosition", "stabilizedPalmPosition", "palmVelocity", "palmNormal"),
    *("direction", "grabStrength", "pinchStrength", "confidence", "palmWidth", "armWidth"),
    *("timeVisible", "elbow", "wrist", "armBasis", "sphereCenter", "sphereRadius", "r", "s", "t"),
}
FINGER_FIELDS = {
    *("id", "handId", "type", "tool", "extended", "length", "width", "direction", "tipPosition"),
    *("stabilizedTipPosition", "tipVelocity", "carpPosition", "mcpPosition", "pipPosition"),
    *("dipPosition", "btipPosition", "bases", "timeVisible", "touchDistance", "touchZone"),
}
angles = st.floats(-1.4, 1.4)
shares = st.floats(0.0, 1.0)
sides = st.sampled_from(["left", "right"])


def posture(pitch=0.0, yaw=0.0, roll=0.0, grab=0.0, pinch=0.0, palm=(10.0, 200.0, -30.0)):
    return HandPosture(palm, rotation_rows(pitch, yaw, roll), grab, pinch, 1.0)


def distance(a, b):
    return math.dist(a, b)


def determinant(rows):
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


@settings(max_examples=examples(40))
@given(sides, angles, angles, angles, shares, shares)
def test_bones_fingers_and_bases_fit_together(side, pitch, yaw, roll, grab, pinch):
    hand, fingers = HandModel(7, side, 0.0).measure(posture(pitch, yaw, roll, grab, pinch), 1.0)
    assert set(hand) == HAND_FIELDS
    assert len(fingers) == 5
    handed = 1.0 if side == "right" else -1.0
    assert determinant(hand["armBasis"]) == pytest.approx(handed, abs=1e-3)
    for kind, finger in enumerate(fingers):
        assert set(finger) == FINGER_FIELDS
        assert (finger["type"], finger["id"], finger["handId"]) == (kind, 70 + kind, 7)
        joints = [finger[f"{name}Position"] for name in ("carp", "mcp", "pip", "dip", "btip")]
        lengths = [distance(a, b) for a, b in pairwise(joints)]
        assert sum(lengths[1:]) == pytest.approx(finger["length"], abs=0.01)
        assert lengths[0] == pytest.approx(0.0 if kind == 0 else 65.0, abs=15.0)
        assert distance(finger["tipPosition"], joints[-1]) < 5.0
        for basis, a, b, length in zip(finger["bases"], joints, joints[1:], lengths, strict=False):
            assert determinant(basis) == pytest.approx(handed, abs=1e-3)
            along = [-length * value for value in basis[2]]
            assert [v - u for u, v in zip(a, b, strict=True)] == pytest.approx(along, abs=0.01)
        assert finger["direction"] == [-value for value in finger["bases"][2][2]]
        assert distance(finger["tipPosition"], hand["palmPosition"]) < 160.0
    assert json.dumps([hand, fingers], allow_nan=False)


@given(sides, angles, angles, angles)
def test_the_attitude_is_that_of_the_posture(side, pitch, yaw, roll):
    hand, _ = HandModel(1, side, 0.0).measure(posture(pitch, yaw, roll), 0.0)
    direction, normal = Vector3(*hand["direction"]), Vector3(*hand["palmNormal"])
    assert hand_orientation(direction, normal) is not None
    assert direction.y == pytest.approx(math.sin(pitch), abs=1e-5)
    assert pitch_yaw_roll(direction, normal)[1] == pytest.approx(yaw, abs=1e-4)
    assert hand["r"][0] == pytest.approx(
        [hand["armBasis"][k][0] * (-1 if side == "left" and k == 0 else 1) for k in range(3)],
        abs=1e-5,
    )


def test_left_is_the_mirror_image_of_right():
    palm = (0.0, 200.0, 0.0)
    right = HandModel(1, "right", 0.0).measure(posture(palm=palm, grab=0.4), 0.0)[1]
    left = HandModel(1, "left", 0.0).measure(posture(palm=palm, grab=0.4), 0.0)[1]
    for a, b in zip(right, left, strict=True):
        x, y, z = b["tipPosition"]
        assert a["tipPosition"] == pytest.approx([-x, y, z])
    assert right[0]["tipPosition"][0] < 0.0 < left[0]["tipPosition"][0]  # the thumbs


def test_a_fist_is_smaller_and_a_pinch_meets():
    def tips(**fields):
        fingers = HandModel(1, "right", 0.0).measure(posture(**fields), 0.0)[1]
        return [finger["tipPosition"] for finger in fingers], [f["extended"] for f in fingers]

    palm = posture().palm_mm
    opened, extended = tips()
    assert all(extended)
    closed, extended = tips(grab=1.0)
    assert not any(extended)
    for a, b in zip(opened[1:], closed[1:], strict=True):
        assert distance(b, palm) < 0.7 * distance(a, palm)
    pinched, extended = tips(pinch=1.0)
    assert extended == [False, False, True, True, True]
    assert distance(pinched[0], pinched[1]) < 0.5 * distance(opened[0], opened[1])


def test_velocities_are_differences_and_stabilized_positions_lag():
    hand = HandModel(1, "right", 0.0)
    for step in range(50):
        reported, fingers = hand.measure(posture(palm=(2.0 * step, 200.0, 0.0)), step * 0.01)
    assert reported["palmVelocity"] == pytest.approx([200.0, 0.0, 0.0])
    assert fingers[2]["tipVelocity"] == pytest.approx([200.0, 0.0, 0.0], rel=1e-3)
    assert 2.0 < reported["palmPosition"][0] - reported["stabilizedPalmPosition"][0] < 40.0
    assert reported["timeVisible"] == 0.49


def test_frames_of_older_versions_know_no_skeleton():
    document = frame_document(1, 1000, 110.0, [HandModel(1, "right", 0.0).measure(posture(), 0.0)])
    assert as_version(document, 6) is document
    old = as_version(document, 5)
    assert set(old["hands"][0]).isdisjoint({"type", "grabStrength", "confidence", "armBasis"})
    assert set(old["pointables"][0]).isdisjoint({"extended", "bases", "dipPosition"})
    assert old["hands"][0]["palmPosition"] == document["hands"][0]["palmPosition"]
    assert "type" in document["hands"][0]
    empty = frame_document(1, 1000, 110.0, [])
    assert (empty["hands"], empty["pointables"], empty["s"]) == ([], [], 1.0)
