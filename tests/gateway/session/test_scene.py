"""Scene published by a session."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from cardan.gateway.bus.arm_topics import ArmNames
from cardan.gateway.bus.options import NetworkOptions
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.reach import tcp_range_m
from cardan.gateway.session.arm_assembly import make_neighbor_bodies
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.network import SessionNetwork
from cardan.gateway.session.scene import scene_of
from cardan.robots import load_arm
from cardan.robots.arm_bodies import to_se3
from cardan.types import IDENTITY_POSE, Pose, Quaternion, Vector3
from tests.gateway.bus.bench import FakeNode

TABLES = {
    "robot": {"driver": "sim_arm", "robot": "ur5"},
    "arm": {"model": "ur5", "safety_distance_m": 0.02},
    "limits": {"workspace_x_m": [-0.5, 0.5], "workspace_z_m": [0.0, 0.8]},
    "obstacles": [
        {"name": "table", "box": [[0.2, -0.5, -0.1], [1.0, 0.5, 0.0]]},
        {"name": "pole", "capsule": [[0.4, 0.0, 0.0], [0.4, 0.0, 0.6], 0.05]},
        {"name": "floor", "plane": [[0.0, 0.0, 2.0], -0.2]},
    ],
}


def reported(tables):
    """Return the scene of a session with these tables."""
    return json.loads(scene_of(parse_config(tables)))


def test_obstacles_workspace_and_what_is_kept_to_them():
    around = reported(TABLES)
    assert around["workspace_m"] == [[-0.5, 0.5], None, [0.0, 0.8]]
    table, pole, floor = around["obstacles"]
    assert table["name"] == "table"
    assert table["box"]["position"] == pytest.approx([0.6, 0.0, -0.05])
    assert table["box"]["size_m"] == pytest.approx([0.8, 1.0, 0.1])
    assert table["box"]["orientation"] == [0.0, 0.0, 0.0, 1.0]
    assert pole["capsule"] == {"start": [0.4, 0, 0], "end": [0.4, 0, 0.6], "radius_m": 0.05}
    assert floor["plane"] == {"normal": [0.0, 0.0, 1.0], "offset_m": -0.2}
    assert around["obstacle_m"] == 0.02
    assert 0.0 < around["own_body_m"] < 0.02


def test_the_shapes_are_those_of_the_collision_model_each_after_its_joint():
    model = load_arm("teo_right_arm")
    tables = {
        "robot": {"driver": "sim_arm", "robot": "teo_right_arm"},
        "arm": {"model": "teo_right_arm"},
    }
    around = reported(tables)
    assert [each["name"] for each in around["shapes"]] == [each.name for each in model.shapes]
    assert {each["joint"] for each in around["shapes"]} <= {"", *model.joint_names}
    for each, shape in zip(around["shapes"], model.shapes, strict=True):
        assert (each["joint"] == "") == (shape.body == 0)
    assert around["home"] == list(model.home)
    assert all(math.isfinite(each) for each in around["home"])
    assert around["reach_m"] == [list(each) for each in tcp_range_m(ArmKinematics(model))]


def test_neighbors_are_reported_with_all_that_places_their_bodies():
    """The JSON's joints alone give the places at which the session avoids the bodies."""
    neighbor = {
        "name": "right",
        "model": "teo_right_arm",
        "topic": "right/joint_states",
        "base_xyz_m": [1.4, 0.1, 0.2],
        "base_rpy_deg": [10.0, 20.0, 30.0],
        "max_age_s": 0.2,
    }
    tables = {**TABLES, "network": {"namespace": "cell"}, "neighbors": [neighbor]}
    config = parse_config(tables)
    (bodies,) = make_neighbor_bodies(config)
    (reported,) = json.loads(scene_of(config))["neighbors"]
    assert (reported["name"], reported["topic"]) == ("right", "/cell/right/joint_states")
    assert reported["max_age_s"] == 0.2
    assert [each["name"] for each in reported["joints"]] == list(bodies.names)
    assert [each["name"] for each in reported["shapes"]] == [each.name for each in bodies.shapes]

    def placed(at):
        x, y, z, w = at["orientation"]
        return to_se3(Pose(Vector3(*at["position"]), Quaternion(w, x, y, z)))

    q = np.linspace(-0.4, 0.7, len(bodies.names))
    frames = {"": placed(reported["base"])}
    at = frames[""]
    for joint, value in zip(reported["joints"], q, strict=True):
        assert not joint["slides"]
        turned = pin.SE3(pin.exp3(np.array(joint["axis"]) * value), np.zeros(3))
        frames[joint["name"]] = at = at * placed(joint) * turned
    for shape, frame in zip(reported["shapes"], bodies.frames(q.tolist()), strict=True):
        there = frames[shape["joint"]]
        np.testing.assert_allclose(there.homogeneous, frame.homogeneous, atol=1e-9)


def test_without_a_model_there_is_the_workspace_alone():
    tables = {**TABLES, "robot": {"driver": "sim_abb"}}
    del tables["arm"], tables["obstacles"]
    around = reported(tables)
    assert around["workspace_m"][0] == [-0.5, 0.5]
    assert around["shapes"] == around["obstacles"] == []
    assert around["home"] is around["obstacle_m"] is around["own_body_m"] is None
    assert around["reach_m"] is None


def test_where_collisions_are_not_avoided_no_distance_is_kept():
    around = reported({**TABLES, "arm": {"model": "ur5", "collisions": False}, "obstacles": []})
    assert around["obstacle_m"] is around["own_body_m"] is None


def test_a_session_tells_it_as_it_opens():
    network = SessionNetwork(
        NetworkOptions(), ArmNames(("joint_1",)), "", IDENTITY_POSE, print, bool, {}, "one"
    )
    network._node = node = FakeNode()
    node.join = node.open = lambda: None
    part = SimpleNamespace(capabilities=None, raw_packet_callback=None)
    network.open(part, part, None)
    (topic,) = (name for name in node.publishers if name.endswith("/scene"))
    assert [each["data"] for each in node.publishers[topic].messages] == ["one"]
