"""An arm out of a tree: a mobile base, a torso, two arms with grippers, a head."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

from cardan.robots import load_arm

PLATFORM = """
  <link name="world"/>
  <link name="base_footprint"/>
  <link name="base_link">
    <inertial><mass value="50"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>
    </inertial>
    <collision><origin xyz="0 0 0.1"/><geometry><box size="0.5 0.4 0.2"/></geometry></collision>
  </link>
  <link name="wheel"/>
  <link name="torso">
    <collision><origin xyz="0 0 0.2"/><geometry><cylinder radius="0.1" length="0.4"/></geometry>
    </collision>
  </link>
  <link name="head"><collision><geometry><sphere radius="0.12"/></geometry></collision></link>
  <joint name="slam" type="planar">
    <parent link="world"/><child link="base_footprint"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="base" type="fixed">
    <parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.05"/>
  </joint>
  <joint name="wheel" type="continuous">
    <parent link="base_link"/><child link="wheel"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="lift" type="prismatic">
    <parent link="base_link"/><child link="torso"/><origin xyz="-0.1 0 0.3" rpy="0 0 0.2"/>
    <axis xyz="0 0 1"/><limit lower="0.05" upper="0.35" velocity="0.1" effort="2000"/>
  </joint>
  <joint name="pan" type="revolute">
    <parent link="torso"/><child link="head"/><origin xyz="0 0 0.5"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" velocity="1" effort="3"/>
  </joint>
"""

ARM = """
  <link name="{side}/mount"/>
  <link name="{side}/upper">
    <inertial><origin xyz="0.1 0 0" rpy="0.1 0.2 0.3"/><mass value="3"/>
      <inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="-0.001" izz="0.04"/></inertial>
    <collision><origin xyz="0.15 0 0" rpy="0 1.5708 0"/>
      <geometry><cylinder radius="0.05" length="0.3"/></geometry></collision>
  </link>
  <link name="{side}/fore">
    <inertial><origin xyz="0.1 0 0"/><mass value="2"/><inertia ixx="0.02" iyy="0.03" izz="0.04"/>
    </inertial>
    <visual><geometry><mesh filename="package://nowhere/fore.stl"/></geometry></visual>
    <collision><origin xyz="0.1 0 0"/><geometry><box size="0.2 0.1 0.1"/></geometry></collision>
  </link>
  <link name="{side}/wrist"/>
  <link name="{side}/hand">
    <inertial><mass value="0.5"/><inertia ixx="0.001" iyy="0.001" izz="0.001"/></inertial>
    <collision><geometry><sphere radius="0.06"/></geometry></collision>
  </link>
  <link name="{side}/tcp"/>
  <link name="{side}/left_finger">
    <inertial><mass value="0.1"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5"/></inertial>
    <collision><origin xyz="0.02 0 0"/><geometry><box size="0.04 0.01 0.01"/></geometry></collision>
  </link>
  <link name="{side}/right_finger">
    <inertial><mass value="0.1"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5"/></inertial>
    <collision><origin xyz="0.02 0 0"/><geometry><box size="0.04 0.01 0.01"/></geometry></collision>
  </link>
  <joint name="{side}/mount" type="fixed">
    <parent link="torso"/><child link="{side}/mount"/>
    <origin xyz="0.05 {y} 0.4" rpy="0.3 -0.2 {y}"/>
  </joint>
  <joint name="{side}/shoulder" type="revolute">
    <parent link="{side}/mount"/><child link="{side}/upper"/><origin xyz="0 {y} 0" rpy="0 0 0.5"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" velocity="1.5" effort="80"/>
  </joint>
  <joint name="{side}/elbow" type="revolute">
    <parent link="{side}/upper"/><child link="{side}/fore"/><origin xyz="0.3 0 0" rpy="-1 0 0"/>
    <axis xyz="0 2 0"/><limit lower="-2.5" upper="-0.2" velocity="2" effort="40"/>
  </joint>
  <joint name="{side}/roll" type="continuous">
    <parent link="{side}/fore"/><child link="{side}/wrist"/><origin xyz="0.25 0 0.01"/>
    <axis xyz="1 0 1"/><limit velocity="3" effort="10"/>
  </joint>
  <joint name="{side}/weld" type="fixed">
    <parent link="{side}/wrist"/><child link="{side}/hand"/><origin xyz="0.05 0 0" rpy="0 1 0"/>
  </joint>
  <joint name="{side}/tcp" type="fixed">
    <parent link="{side}/hand"/><child link="{side}/tcp"/><origin xyz="0.1 0.01 0"/>
  </joint>
  <joint name="{side}/z_finger" type="prismatic">
    <parent link="{side}/hand"/><child link="{side}/left_finger"/><origin xyz="0.06 0 0"/>
    <axis xyz="0 1 0"/><limit lower="0.01" upper="0.04" velocity="0.1" effort="20"/>
  </joint>
  <joint name="{side}/a_finger" type="prismatic">
    <parent link="{side}/hand"/><child link="{side}/right_finger"/><origin xyz="0.06 0 0"/>
    <axis xyz="0 -1 0"/><limit lower="0" upper="0.04" velocity="0.1" effort="20"/>
    <mimic joint="{side}/z_finger" multiplier="0.5" offset="0.001"/>
  </joint>
"""

TREE = (
    f'<robot name="two arms">{PLATFORM}{ARM.format(side="l", y=0.2)}'
    f"{ARM.format(side='r', y=-0.2)}</robot>"
)
CHAIN = ("l/shoulder", "l/elbow", "l/roll")


@pytest.fixture
def arm_of(tmp_path):
    def load(toml, tree=TREE):
        (tmp_path / "tree.urdf").write_text(tree, encoding="utf-8")
        path = tmp_path / "arm.toml"
        path.write_text(f'urdf = "tree.urdf"\n{toml}', encoding="utf-8")
        load_arm.cache_clear()
        return load_arm(str(path))

    return load


def full_tree(**held):
    """Pinocchio's model of all of the tree, and the configuration with joints held at values."""
    model = pin.buildModelFromXML(TREE)
    q = pin.neutral(model)
    for name, value in held.items():
        put(model, q, name, value)
    return model, q


def put(model, q, name, value):
    joint = model.joints[model.getJointId(name)]
    q[joint.idx_q : joint.idx_q + joint.nq] = (
        [value] if joint.nq == 1 else [math.cos(value), math.sin(value)]
    )


def place(model, q, base, link):
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    start, end = (data.oMf[model.getFrameId(name, pin.BODY)] for name in (base, link))
    return start.actInv(end)


def as_se3(pose):
    w, x, y, z = pose.orientation
    return pin.SE3(pin.Quaternion(w, x, y, z), np.array(pose.position))


def test_the_arm_is_where_the_whole_tree_has_it(arm_of):
    arm = arm_of('tcp = "l/tcp"\nbase = "torso"')
    assert arm.joint_names == CHAIN
    model, q = full_tree()
    random = np.random.default_rng(5)
    for _ in range(30):
        values = random.uniform((-2, -2.5, -7), (2, -0.2, 7))
        for name, value in zip(CHAIN, values, strict=True):
            put(model, q, name, value)
        there = place(model, q, "torso", "l/tcp")
        here = as_se3(arm._replace(home=tuple(values)).home_tcp)
        np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-9)
