"""Arm taken from a tree: a mobile base, a torso, two arms with grippers, a head."""

from __future__ import annotations

import math
import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.session.cautions import arm_cautions as cautions
from cardan.robots import OrientedBox, limits_in, load_arm
from cardan.robots.arm_chain import chain_of
from cardan.robots.arm_file import ArmFile
from cardan.robots.arm_reader import build_arm
from cardan.robots.urdf import read_tree

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


def complete(urdf):
    """Complete a URDF for Pinocchio's parser: if one product of inertia is missing, it reads no
    moments, and no shapes of that link."""
    return re.sub(r'(<inertia ixx="\S+") (iyy=)', r'\1 ixy="0" ixz="0" iyz="0" \2', urdf)


WHOLE = complete(TREE)

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
    """Return Pinocchio's model of the whole tree, and its configuration with held joints at their
    values."""
    model = pin.buildModelFromXML(WHOLE)
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


def gripper(side, opened=0.01):
    return {f"{side}/z_finger": opened, f"{side}/a_finger": 0.5 * opened + 0.001}


AT_REST = {"lift": 0.05, **gripper("l"), **gripper("r"), "r/elbow": -0.2}
"""Default positions of held joints: nearest to 0; mimicking joints follow their leader."""


def chain_postures(arm, count=20):
    random = np.random.default_rng(5)
    return random.uniform(
        np.maximum(arm.lower, -7), np.minimum(arm.upper, 7), (count, len(arm.home))
    )


def assert_same_places(arm, base, tcp, held):
    model, q = full_tree(**held)
    for values in chain_postures(arm):
        for name, value in zip(arm.joint_names, values, strict=True):
            put(model, q, name, value)
        here = as_se3(arm._replace(home=tuple(values)).home_tcp)
        there = place(model, q, base, tcp)
        np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-9)
    assert_own_urdf(arm, tcp)


def assert_own_urdf(arm, tcp):
    """Assert that only the arm's joints move in its URDF, and that its root is the base."""
    model = pin.buildModelFromXML(complete(arm.urdf))
    assert sorted(model.names) == sorted(["universe", *arm.joint_names])
    root = next(frame.name for frame in model.frames if frame.type == pin.BODY)
    q = pin.neutral(model)
    for values in chain_postures(arm, 3):
        for name, value in zip(arm.joint_names, values, strict=True):
            put(model, q, name, value)
        here = as_se3(arm._replace(home=tuple(values)).home_tcp)
        there = place(model, q, root, tcp)
        np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-9)
    assert limits_in(arm.urdf, arm.joint_names) == arm.limits


@pytest.mark.parametrize(
    ("toml", "joints", "base", "held"),
    [
        # The planar joint and the lift are before the base: the arm begins with the lift.
        ('tcp = "l/tcp"', ("lift", *CHAIN), "base_link", {}),
        ('tcp = "l/tcp"\nbase = "world"', ("lift", *CHAIN), "world", {}),
        ('tcp = "l/tcp"\nbase = "torso"', CHAIN, "torso", {}),
        ('tcp = "l/tcp"\nbase = "l/mount"', CHAIN, "l/mount", {}),
        # Joints beside the chain that are not the arm's are held.
        ('tcp = "l/tcp"\nbase = "r/fore"', CHAIN, "r/fore", {}),
        (
            'tcp = "l/tcp"\nbase = "head"\nhold.pan = 30',
            CHAIN,
            "head",
            {"pan": math.radians(30)},
        ),
        (
            f'tcp = "l/tcp"\njoints = {list(reversed(CHAIN))}\nbase = "base_link"\nhold.lift = 0.2',
            CHAIN,
            "base_link",
            {"lift": 0.2},
        ),
        (f'tcp = "l/tcp"\njoints = {list(CHAIN)}', CHAIN, "l/mount", {}),
        # A base in the middle.
        (
            'tcp = "l/tcp"\nbase = "torso"\njoints = ["l/shoulder", "l/roll"]\n'
            '[hold]\n"l/elbow" = -40',
            ("l/shoulder", "l/roll"),
            "torso",
            {"l/elbow": math.radians(-40)},
        ),
    ],
)
def test_the_arm_is_where_the_whole_tree_has_it(arm_of, toml, joints, base, held):
    arm = arm_of(toml)
    assert arm.joint_names == joints
    assert_same_places(arm, base, "l/tcp", {**AT_REST, **held})


def test_an_arm_may_end_before_the_tree_does(arm_of):
    arm = arm_of('tcp = "l/fore"\nbase = "torso"\nflange = "l/fore"')
    assert arm.joint_names == CHAIN[:2]
    assert_same_places(arm, "torso", "l/fore", AT_REST)
    # Links at its end move with it.
    assert {"l/hand", "l/left_finger"} <= {shape.name for shape in arm.shapes if shape.body == 2}


def test_what_hangs_on_the_chain_weighs(arm_of):
    arm = arm_of('tcp = "l/tcp"\nbase = "torso"\n[hold]\n"l/z_finger" = 0.03')
    model, q = full_tree(**{**AT_REST, **gripper("l", 0.03)})
    own, places = ArmKinematics(arm).model, model.createData()
    indexes = [model.joints[model.getJointId(name)].idx_v for name in CHAIN]
    for values in chain_postures(arm):
        for name, value in zip(CHAIN, values, strict=True):
            put(model, q, name, value)
        whole = pin.computeGeneralizedGravity(model, places, q)[indexes]
        ours = pin.computeGeneralizedGravity(own, own.createData(), values)
        np.testing.assert_allclose(ours, whole, atol=1e-9)
        inertia = pin.crba(model, places, q, pin.Convention.LOCAL)[np.ix_(indexes, indexes)]
        here = pin.crba(own, own.createData(), values, pin.Convention.LOCAL)
        np.testing.assert_allclose(np.triu(here), np.triu(inertia), atol=1e-9)


def test_every_body_is_where_the_whole_tree_has_it(arm_of):
    """Bodies fixed to the arm move with it; all others are obstacles in the base frame."""
    arm = arm_of('tcp = "l/tcp"\nbase = "torso"\nhold.pan = -20')
    model, q = full_tree(**AT_REST, pan=math.radians(-20))
    for name, value in zip(CHAIN, (0.7, -1.1, 2.0), strict=True):
        put(model, q, name, value)
    geometry = pin.buildGeomFromUrdfString(model, WHOLE, pin.GeometryType.COLLISION)
    data, solids = model.createData(), geometry.createData()
    pin.updateGeometryPlacements(model, data, geometry, solids, q)
    base = pin.updateFramePlacement(model, data, model.getFrameId("torso", pin.BODY))
    there = {
        each.name: base.actInv(solids.oMg[number])
        for number, each in enumerate(geometry.geometryObjects)
    }
    bodies = [pin.SE3.Identity()]
    for joint, value in zip(arm.joints, (0.7, -1.1, 2.0), strict=True):
        turned = pin.SE3(pin.exp3(value * np.array(joint.axis)), np.zeros(3))
        bodies.append(bodies[-1] * as_se3(joint.placement) * turned)
    moved = {"l/upper": 1, "l/fore": 2, "l/hand": 3, "l/left_finger": 3, "l/right_finger": 3}
    assert {shape.name: shape.body for shape in arm.shapes if shape.body} == moved
    assert {f"{shape.name}_0" for shape in arm.shapes} == there.keys()
    for shape in arm.shapes:
        body, center = bodies[shape.body], there[f"{shape.name}_0"]
        if isinstance(shape.shape, OrientedBox):
            here = body * as_se3(shape.shape.pose)
            np.testing.assert_allclose(here.homogeneous, center.homogeneous, atol=1e-9)
        else:
            start, end = (body.act(np.array(point)) for point in shape.shape[:2])
            np.testing.assert_allclose(0.5 * (start + end), center.translation, atol=1e-9)
            along = np.cross(end - start, center.rotation[:, 2])
            np.testing.assert_allclose(along, 0.0, atol=1e-9)


def test_what_else_is_in_the_file_stays(arm_of):
    other = '<link name="arm_base"/><joint name="arm_base_" type="fixed"><parent link="head"/>'
    other += '<child link="arm_base"/></joint><gazebo><sensor:camera sensor:fps="3">&lt;x&gt;'
    text = TREE.replace("</robot>", f"{other}</sensor:camera></gazebo></robot>")
    arm = arm_of('tcp = "l/tcp"\nbase = "torso"', text)
    assert '<gazebo><sensor:camera sensor:fps="3">&lt;x&gt;</sensor:camera></gazebo>' in arm.urdf
    assert '<mesh filename="package://nowhere/fore.stl"' in arm.urdf
    assert read_tree(arm.urdf).root == "arm_base__"
    assert_own_urdf(arm, "l/tcp")


def test_two_arms_of_one_tree_have_each_other_s_bodies(arm_of):
    for side, other in ("lr", "rl"):
        arm = arm_of(f'tcp = "{side}/tcp"\nbase = "torso"')
        fixed = {shape.name for shape in arm.shapes if shape.body == 0}
        assert {f"{other}/upper", f"{other}/hand", "head", "torso", "base_link"} <= fixed
        assert not any(name.startswith(f"{side}/") for name in fixed)


@pytest.mark.parametrize("base", ["torso", "base_link"])
def test_the_other_arm_is_said_to_be_held(arm_of, base):
    for side, other in ("lr", "rl"):
        arm = arm_of(f'tcp = "{side}/tcp"\nbase = "{base}"')
        assert arm.held_rows == ((f"{other}/shoulder", f"{other}/z_finger"),)
        assert any(f"held: {other}/shoulder to {other}/z_finger" in each for each in cautions(arm))


def test_heads_wheels_and_what_the_arm_holds_are_no_other_arm(arm_of):
    alone = TREE.replace(ARM.format(side="r", y=-0.2), "")
    arm = arm_of('tcp = "l/upper"\nbase = "torso"', alone)
    assert arm.held_rows == ()
    assert not any("held" in each for each in cautions(arm))


def test_limits_are_those_of_the_file(arm_of):
    arm = arm_of('tcp = "l/tcp"\nbase = "torso"')
    assert arm.lower == (-2.0, -2.5, -math.inf)
    assert arm.velocity == (1.5, 2.0, 3.0)
    assert [joint.effort for joint in arm.joints] == [80.0, 40.0, 10.0]


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ("", r"arm\.toml: tcp: link 'base_link' branches: name the link .* ends at, wheel, "),
        ('tcp = "paw"', r"arm\.toml:\d:1: tcp: there is no link 'paw'; allowed: world, "),
        ('tcp = "l/tcp"\nbase = "paw"', r"arm\.toml:\d:1: base: there is no link 'paw'"),
        (
            'tcp = "l/tcp"\nbase = "l/hand"',
            r"arm\.toml:\d:1: base: no joint moves between 'l/hand' and 'l/tcp'",
        ),
        (
            'tcp = "l/tcp"\njoints = ["pan"]',
            r"joints: the arm has no moving joint 'pan'; allowed: lift, l/shoulder, l/elbow",
        ),
        (
            'tcp = "l/tcp"\njoints = ["l/shuolder"]',
            r"joints: the arm has no moving joint 'l/shuolder'; .*; did you mean 'l/shoulder'",
        ),
        ('tcp = "l/tpc"', r"tcp: there is no link 'l/tpc'; .*; did you mean 'l/tcp'"),
        (
            'tcp = "l/tcp"\nhold.lift = 0.2',
            r"arm\.toml:\d:1: hold\.lift: there is no such joint to hold; allowed: wheel, pan, ",
        ),
        ('tcp = "l/tcp"\nhold.slam = 0', r"hold\.slam: there is no such joint"),
        ('tcp = "l/tcp"\nhold.pan = 60', r"hold\.pan: 60 is outside -57.* to 57"),
        ('tcp = "l/tcp"\nhold.pan = nan', r"hold.*: .*nan.*-1000000 to 1000000"),
        ('tcp = "l/tcp"\nflange = "torso"', "flange: link 'torso' is not moved by the last joint"),
    ],
)
def test_errors_name_the_key(arm_of, toml, words):
    with pytest.raises(ConfigurationError, match=words):
        arm_of(toml)


NUMBERS = st.floats(-1.5, 1.5, allow_subnormal=False)
POSES = st.tuples(*[NUMBERS] * 6)
KINDS = st.sampled_from(["revolute", "continuous", "prismatic", "fixed"])


@st.composite
def trees(draw):
    """Draw a tree: each link except the root has a parent, a joint and a held position."""
    joints = []
    for number in range(1, draw(st.integers(2, 9))):
        parent = draw(st.integers(0, number - 1))
        x, y, z, roll, pitch, yaw = draw(POSES)
        # Pinocchio has separate joint types for aligned axes.
        axis = draw(
            st.sampled_from([(1, 0, 0), (0, -1, 0), (0, 0, 2)])
            | st.tuples(NUMBERS, NUMBERS, st.floats(0.1, 1))
        )
        lower = draw(st.floats(-1, 0.5))
        # Names are not in the tree's order: Pinocchio sorts by them.
        joints.append(
            f'<joint name="{draw(st.sampled_from("azm"))}{number}" type="{draw(KINDS)}">'
            f'<parent link="l{parent}"/><child link="l{number}"/>'
            f'<origin xyz="{x} {y} {z}" rpy="{roll} {pitch} {yaw}"/>'
            f'<axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
            f'<limit lower="{lower}" upper="{lower + 1}" velocity="1" effort="1"/></joint>'
        )
    links = [
        f'<link name="l{number}"><inertial><origin xyz="0.1 {number} 0"/><mass value="{number}"/>'
        '<inertia ixx="1" ixy="0.1" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
        for number in range(len(joints) + 1)
    ]
    return f'<robot name="any">{"".join(draw(st.permutations(links + joints)))}</robot>'


@given(trees(), st.data())
def test_any_arm_of_any_tree_is_where_pinocchio_has_it(text, data):
    tree = read_tree(text)
    names = st.sampled_from(list(tree.links))
    file = ArmFile(urdf="", tcp=data.draw(names), base=data.draw(names | st.just("")))
    beside = tree.path(file.base or tree.root)
    if all(joint.kind == "fixed" or joint in beside for joint in tree.path(file.tcp)):
        with pytest.raises(ConfigurationError, match=r"no joint moves between|no moving joint"):
            chain_of(tree, file)
        return
    chain = chain_of(tree, file)
    arm = build_arm(tree, file, {})
    whole = pin.buildModelFromXML(text)
    q = pin.neutral(whole)
    values = tuple(data.draw(st.floats(-3, 3)) for _ in arm.joints)
    for name, value in (*chain.held.items(), *zip(arm.joint_names, values, strict=True)):
        put(whole, q, name, value)
    there = place(whole, q, chain.base, chain.tcp)
    here = as_se3(arm._replace(home=values).home_tcp)
    np.testing.assert_allclose(here.homogeneous, there.homogeneous, atol=1e-9)
    # Each link adds its mass to one body, or to the base.
    moved = sum(each.mass_kg for each in arm.inertias)
    still = sum(
        number
        for number in range(len(tree.links))
        if not {joint.name for joint in tree.path(f"l{number}")} & set(arm.joint_names)
    )
    assert moved + still == pytest.approx(sum(range(len(tree.links))))
    assert sorted(pin.buildModelFromXML(arm.urdf).names) == sorted(["universe", *arm.joint_names])
    again = build_arm(read_tree(arm.urdf), ArmFile(urdf="", tcp=chain.tcp), {})
    np.testing.assert_allclose(
        as_se3(again.home_tcp).homogeneous, as_se3(arm.home_tcp).homogeneous, atol=1e-9
    )
