"""Arms described in MJCF, compared with results of MuJoCo 4.0.0."""

from __future__ import annotations

import math
import re
import time

import numpy as np
import pinocchio as pin
import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.own_arm.added import add, toml_beside
from cardan.robots import Capsule, OrientedBox, load_arm, parse_urdf
from cardan.robots.mjcf import urdf_of
from cardan.robots.urdf import read_tree

TRIAL = """<mujoco model="trial">
  <compiler angle="degree" eulerseq="zyx"/>
  <default>
    <joint damping="1" range="-170 170"/>
    <geom density="500"/>
    <motor ctrlrange="-40 40"/>
    <default class="big">
      <joint axis="0 1 0"/>
      <geom type="capsule" size="0.05 0.1"/>
      <default class="wide"><joint range="-90 80"/></default>
    </default>
    <default class="visual">
      <geom contype="0" conaffinity="0" type="box" size="0.1 0.1 0.1" mass="0"/>
    </default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 .1"/>
    <body name="base" pos="0.1 0.2 0.3" euler="10 20 30">
      <geom size="0.1"/>
      <geom class="visual"/>
      <body name="turret" pos="0 0 0.2" childclass="big">
        <joint name="turn" axis="0 0 1" ref="15"/>
        <geom fromto="0 0 0 0.1 0 0.3"/>
        <frame pos="0.1 0 0.3" axisangle="0 1 1 40">
        <body name="upper" quat="0.9 0.1 0.2 0.3">
          <joint name="shoulder" class="wide" pos="0.02 0.03 0.04"/>
          <geom type="box" size="0.1 0.05 0.02" pos="0.1 0 0" euler="0 30 0"/>
          <geom type="cylinder" size="0.03 0.1" pos="0.2 0 0.1" zaxis="1 0 1"/>
          <inertial pos="0.1 0 0" mass="2" diaginertia="0.01 0.02 0.015" quat="0.7 0.7 0 0"/>
          <body name="slider" pos="0.3 0 0" zaxis="1 1 0">
            <joint name="lift" type="slide" range="-0.1 0.4" ref="0.05" axis="1 2 3"/>
            <joint name="roll" limited="false" axis="1 0 0.5" pos="0 0.1 0"/>
            <geom type="ellipsoid" size="0.1 0.2 0.05" euler="40 50 60"/>
            <geom type="box" fromto="0 0 0 0.1 0.2 0.15" size="0.02"/>
            <body name="wrist" pos="0 0 0.2" xyaxes="0 1 0 1 0 1">
              <joint name="bend"/>
              <geom type="cylinder" fromto="0 0 0 0 -0.1 0.1" size="0.02"/>
              <site name="tip" pos="0 0 0.1" euler="0 90 0"/>
              <body name="finger">
                <joint name="grip" type="slide" range="0 0.04"/>
                <geom size="0.01"/>
              </body>
            </body>
          </body>
        </body>
        </frame>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="turn" gear="2"/>
    <position joint="shoulder" forcerange="-30 30"/>
  </actuator>
  <keyframe><key name="home" qpos="0.1 0.2 0.1 0.3 0.4 0"/></keyframe>
</mujoco>
"""
"""Model with every feature: all kinds of orientations, a body of two joints, frames, defaults."""

MUJOCO = {
    (0.2618, 0.0, 0.05, 0.0, 0.0): (
        (0.289141489803, 0.41913636681, 0.669574457682),
        (0.177559486048, -0.573138972921, -0.799990216586),
        (0.247534497978, 0.812782315846, -0.527362853601),
        (0.952470105161, -0.104386899404, 0.286188878204),
    ),
    (0.1, 0.2, 0.1, 0.3, 0.4): (
        (0.216694419591, 0.391922411847, 0.642943272487),
        (0.685622783972, -0.562632111483, -0.461916123583),
        (0.583983001123, 0.803942762926, -0.112427257988),
        (0.434609310183, -0.192668474501, 0.879769064264),
    ),
    (-1.2, -0.7, 0.35, 2.5, -1.1): (
        (0.618787645184, 0.215667320611, 0.298320791903),
        (0.174730855691, 0.261887614172, 0.949149095566),
        (-0.983374763773, 0.09480893846, 0.154872008971),
        (-0.04942875726, -0.960430186287, 0.274099717665),
    ),
}
"""Position of the site, m, and rows of its matrix, by posture."""

WEIGHTS = (4.3883201856, -1.3309732166, 10.9000179604, -1.5542132231, 0.0383444546)
"""Load of gravity on the joints at home, N·m and N."""

SPEEDS = """
[velocity_deg_s]
turn = 60.0
shoulder = 60.0
lift = 0.2
roll = 60.0
bend = 60.0
"""


def mjcf(body="", head="", more="", joint='<joint name="j" range="-60 80"/>'):
    """Return an arm of one joint with a site at its end."""
    return (
        f'<mujoco model="m">{head}<worldbody><body name="a"><body name="b" pos="0.1 0 0.2">'
        f'{joint}<geom size="0.05"/>{body}<site name="tip" pos="0 0 0.3"/></body></body>'
        f"</worldbody>{more}</mujoco>"
    )


@pytest.fixture
def loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def load(text, toml="[velocity_deg_s]\nj = 60.0", tcp="tip"):
        (tmp_path / "arm.xml").write_text(text, encoding="utf-8")
        (tmp_path / "arm.toml").write_text(
            f'urdf = "arm.xml"\ntcp = "{tcp}"\n{toml}', encoding="utf-8"
        )
        load_arm.cache_clear()
        return load_arm(str(tmp_path / "arm.toml"))

    return load


def origin_of(text, joint):
    """Return the placement of a joint's origin in the translated URDF."""
    element = read_tree(urdf_of(text)).joints[joint].element.find("origin")
    xyz, rpy = ([float(each) for each in element.get(key).split()] for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


# -- Comparison with MuJoCo -------------------------------------------------------------------


@pytest.fixture
def trial(loaded):
    return loaded(TRIAL, SPEEDS)


def test_forward_kinematics_are_those_of_mujoco(trial):
    kinematics = ArmKinematics(trial)
    for q, (place, *rows) in MUJOCO.items():
        tcp = kinematics.forward(np.array(q))
        assert np.abs(tcp.translation - place).max() < 1e-9
        assert np.abs(tcp.rotation - rows).max() < 1e-9


def test_masses_given_and_of_geoms_weigh_what_they_do_in_mujoco(trial):
    arm = ArmKinematics(trial)
    torques = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), np.array(trial.home))
    assert torques == pytest.approx(WEIGHTS, abs=1e-9)


def test_limits(trial):
    turn, shoulder, lift, roll, bend = trial.joints
    assert (turn.lower, turn.upper) == pytest.approx((math.radians(-170), math.radians(170)))
    assert (shoulder.lower, shoulder.upper) == pytest.approx((-math.pi / 2, math.radians(80)))
    assert (lift.lower, lift.upper) == (-0.1, 0.4)
    assert (roll.lower, roll.upper) == (-math.inf, math.inf)
    assert (turn.effort, shoulder.effort, bend.effort) == (80.0, 30.0, math.inf)


def test_home_is_that_of_the_keyframe(trial, loaded):
    assert trial.home == (0.1, 0.2, 0.1, 0.3, 0.4)
    narrowed = loaded(TRIAL, f"{SPEEDS}[upper_deg]\nlift = 0.05\n")
    assert narrowed.home[2] <= 0.05
    assert narrowed.home != trial.home
    for qpos in ("0 0 0", "0 0 0 0 0 nan"):
        with pytest.raises(ConfigurationError, match=r"qpos of the keyframe 'home': .* 6 numbers"):
            urdf_of(TRIAL.replace("0.1 0.2 0.1 0.3 0.4 0", qpos))


def test_a_rounded_home_is_within_its_limits(loaded):
    key = '<keyframe><key name="home" qpos="1.0473"/></keyframe>'
    assert loaded(mjcf(more=key, joint='<joint name="j" range="0 60"/>')).home == (math.pi / 3,)


def test_bodies(trial):
    by_link = {}
    for shape in trial.shapes:
        by_link.setdefault(shape.name, []).append(shape.shape)
    floor, base = by_link["world"][0], by_link["base"]
    assert isinstance(floor, OrientedBox)
    assert floor.pose.position.z + floor.size_m.z / 2 == pytest.approx(0.0)
    assert len(base) == 1, "geoms without contacts are left out"
    turret = by_link["turret"][0]
    assert isinstance(turret, Capsule)
    assert turret.radius_m == 0.05
    assert [len(by_link[link]) for link in ("upper", "slider", "wrist", "finger")] == [2, 2, 1, 1]


def test_an_arm_of_a_hand_made_urdf(loaded):
    text = """<mujoco><compiler angle="radian"/><worldbody>
      <body name="column" pos="0 0 0.4"><joint name="turn" range="-2 2"/>
        <body name="carriage" pos="0.1 0 0" euler="0 0.5 0">
          <joint name="lift" type="slide" axis="1 0 0" range="0 0.3"/>
          <body name="hand" pos="0 0.2 0" axisangle="1 0 0 -1.1">
            <joint name="roll" axis="0 1 0" range="-3 3"/><site name="tip" pos="0 0 0.1"/>
    </body></body></body></worldbody></mujoco>"""

    def joint(name, kind, links, xyz, rpy, axis, limit):
        return (
            f'<joint name="{name}" type="{kind}"><parent link="{links[0]}"/><child '
            f'link="{links[1]}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
            f'<limit {limit} velocity="1" effort="1"/></joint>'
        )

    links = "".join(f'<link name="{each}"/>' for each in "abcde")
    urdf = parse_urdf(
        f'<robot name="r">{links}'
        + joint("turn", "revolute", "ab", "0 0 0.4", "0 0 0", "0 0 1", 'lower="-2" upper="2"')
        + joint("lift", "prismatic", "bc", "0.1 0 0", "0 0.5 0", "1 0 0", 'lower="0" upper="0.3"')
        + joint("roll", "revolute", "cd", "0 0.2 0", "-1.1 0 0", "0 1 0", 'lower="-3" upper="3"')
        + '<joint name="f" type="fixed"><parent link="d"/><child link="e"/>'
        '<origin xyz="0 0 0.1"/></joint></robot>'
    )
    arm = loaded(text, "[velocity_deg_s]\nturn = 57.0\nlift = 1.0\nroll = 57.0")
    assert (arm.lower, arm.upper) == (urdf.lower, urdf.upper)
    theirs, ours = ArmKinematics(urdf), ArmKinematics(arm)
    for q in np.random.default_rng(1).uniform(arm.lower, arm.upper, (20, 3)):
        difference = theirs.forward(q).homogeneous - ours.forward(q).homogeneous
        assert np.abs(difference).max() < 1e-9


# -- Joints -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("head", "joint", "expected"),
    [
        ("", 'range="-60 80"', (math.radians(-60), math.radians(80))),
        ('<compiler angle="radian"/>', 'range="-1 2"', (-1.0, 2.0)),
        ("", 'type="slide" range="-0.2 0.3"', (-0.2, 0.3)),
        ("", 'range="-60 80" limited="false"', (-math.inf, math.inf)),
        ("", "", (-math.inf, math.inf)),
        ("", 'range="-60 80" ref="30"', (math.radians(-60), math.radians(80))),
        ('<compiler autolimits="false"/>', 'range="0 90" limited="true"', (0.0, math.pi / 2)),
        ('<default><joint range="0 90"/></default>', "", (0.0, math.pi / 2)),
    ],
)
def test_ranges(loaded, head, joint, expected):
    toml = "[velocity_deg_s]\nj = 0.1"
    arm = loaded(mjcf(head=head, joint=f'<joint name="j" {joint}/>'), toml)
    assert (arm.lower[0], arm.upper[0]) == pytest.approx(expected)


def test_ref_is_where_the_joint_is_as_it_is_drawn():
    turned = origin_of(mjcf(joint='<joint name="j" range="-60 80" ref="30"/>'), "j")
    assert turned.translation == pytest.approx([0.1, 0.0, 0.2])
    assert pin.log3(turned.rotation) == pytest.approx([0.0, 0.0, math.radians(-30)])
    slid = origin_of(mjcf(joint='<joint name="j" type="slide" axis="0 2 0" ref="0.05"/>'), "j")
    assert slid.translation == pytest.approx([0.1, -0.05, 0.2])


def test_classes():
    head = """<default><joint axis="1 0 0" range="0 10"/>
      <default class="one"><joint range="0 20"/><default class="two"><joint ref="5"/></default>
      </default></default>"""
    inner = """<body childclass="one"><joint name="k"/>
      <body><joint name="l" class="two" range="0 30"/></body>
      <frame childclass="two"><body><joint name="m"/></body></frame></body>"""
    joints = read_tree(urdf_of(mjcf(head=head, body=inner, joint='<joint name="j"/>'))).joints
    limits = {name: joints[name].element.find("limit").get("upper") for name in "jklm"}
    upper = {name: math.degrees(float(value)) for name, value in limits.items()}
    assert upper == pytest.approx({"j": 10.0, "k": 20.0, "l": 30.0, "m": 20.0})
    assert {joints[name].element.find("axis").get("xyz") for name in "jklm"} == {"1.0 0.0 0.0"}


@pytest.mark.parametrize(
    "given",
    [
        'quat="1 0 1 0"',
        'euler="0 90 0"',
        'axisangle="0 2 0 90"',
        'xyaxes="0 0 -1 0 1 0"',
        'zaxis="3 0 0"',
    ],
)
def test_orientations(given):
    head = '<default><site euler="10 20 30"/></default>'
    text = mjcf(f'<site name="s" {given}/>', head)
    expected = pin.rpy.rpyToMatrix(0.0, math.pi / 2, 0.0)
    assert origin_of(text, "s_fixed").rotation == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("sequence", "order"), [("xyz", "xyz"), ("ZYX", "xyz"), ("XYZ", "zyx")])
def test_euler_sequences(sequence, order):
    angles = dict(zip(sequence.lower(), (0.3, -0.7, 1.1), strict=True))
    text = mjcf(
        '<site name="s" euler="0.3 -0.7 1.1"/>',
        f'<compiler angle="radian" eulerseq="{sequence}"/>',
    )
    expected = np.eye(3)
    for letter in order:
        axis = np.eye(3)["xyz".index(letter)]
        expected = expected @ pin.exp3(axis * angles[letter])
    assert origin_of(text, "s_fixed").rotation == pytest.approx(expected, abs=1e-12)


def test_efforts_are_those_of_the_weakest():
    def effort(actuator, joint="", head=""):
        text = mjcf(
            head=head,
            joint=f'<joint name="j" {joint}/>',
            more=f"<actuator>{actuator}</actuator>",
        )
        return read_tree(urdf_of(text)).joints["j"].element.find("limit").get("effort")

    assert effort('<motor joint="j" ctrlrange="-5 4" gear="10"/>') == "40.0"
    assert effort('<position joint="j" ctrlrange="-5 4"/>') is None
    assert effort('<position joint="j" forcerange="-5 4"/>') == "4.0"
    assert effort('<general joint="j" forcerange="-5 4" forcelimited="false"/>') is None
    assert effort('<motor joint="j" forcerange="-9 9"/>', 'actuatorfrcrange="-3 3"') == "3.0"
    weak = '<default><default class="weak"><general forcerange="-2 2"/></default></default>'
    assert effort('<velocity class="weak" joint="j"/>', head=weak) == "2.0"


# -- Coupled joints ---------------------------------------------------------------------------

FINGERS = """<body name="f"><joint name="k" type="slide" range="0 0.04" ref="0.01"/>
  <geom size="0.01"/></body><body name="g"><joint name="l" type="slide" range="0 0.04"/>
  <geom size="0.01"/><site name="pad"/></body>"""


def test_an_equality_of_joints_is_a_mimic():
    equal = '<equality><joint joint1="k" joint2="l" polycoef="0.005 2"/></equality>'
    tree = read_tree(urdf_of(mjcf(FINGERS, more=equal)))
    leader, factor, offset = tree.leader("k")
    assert (leader.name, factor) == ("l", 2.0)
    assert offset == pytest.approx(0.015)
    switched_off = equal.replace("joint1", 'active="false" joint1')
    assert read_tree(urdf_of(mjcf(FINGERS, more=switched_off))).joints["k"].mimic is None


@pytest.mark.parametrize(
    ("coupled", "words"),
    [
        ('<equality><joint joint1="l" joint2="k" polycoef="0 0 1"/></equality>', "'joint'"),
        ('<equality><connect name="loop" body1="g" body2="f"/></equality>', "'loop'"),
        ('<equality><connect name="pin" site1="pad" site2="tip"/></equality>', "'pin'"),
        ('<tendon><fixed name="t" range="0 1"><joint joint="l"/></fixed></tendon>', "'t'"),
        (
            '<tendon><spatial name="s" limited="true"><site site="pad"/><site site="tip"/>'
            "</spatial></tendon>",
            "'s'",
        ),
    ],
)
def test_joints_that_are_coupled_otherwise_are_held_and_none_of_an_arm(loaded, coupled, words):
    assert loaded(mjcf(FINGERS, more=coupled)).joint_names == ("j",)
    speeds = "[velocity_deg_s]\nj = 60.0\nl = 0.1"
    with pytest.raises(ConfigurationError, match=f"joint '[jl]' mimics .*{words}"):
        loaded(mjcf(FINGERS, more=coupled), speeds, "g")


def test_an_arm_whose_hand_is_welded_to_the_world_has_no_joints(loaded):
    welded = '<equality><weld name="held" body1="b"/></equality>'
    with pytest.raises(ConfigurationError, match=r"joint 'j' mimics .*'held'"):
        loaded(mjcf(more=welded))


def test_free_and_ball_joints_are_held(loaded):
    text = mjcf('<body name="c"><joint name="b" type="ball"/><geom size="0.01"/></body>')
    text = text.replace('<body name="a">', '<body name="a"><freejoint name="f"/>')
    assert loaded(text).joint_names == ("j",)
    with pytest.raises(ConfigurationError, match="joint 'b' is 'floating'"):
        loaded(text, tcp="c")


# -- Files ------------------------------------------------------------------------------------


def test_meshes_are_found(loaded, tmp_path):
    head = """<compiler meshdir="parts"/><default><mesh scale="0.1 0.1 0.1"/></default>
      <asset><mesh file="sub/tube.obj"/></asset>"""
    corners = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 2))
    faces = "f 1 2 3\nf 4 3 2\nf 5 6 7\nf 8 7 6\nf 1 5 2\nf 6 2 5\nf 3 4 7\nf 8 7 4\n"
    (tmp_path / "parts" / "sub").mkdir(parents=True)
    (tmp_path / "parts/sub/tube.obj").write_text(corners + faces, encoding="utf-8")
    arm = loaded(mjcf('<geom type="mesh" mesh="tube" pos="0 0 0.1"/>', head))
    assert arm.missing_meshes == ()
    assert any(isinstance(each.shape, OrientedBox) for each in arm.shapes)


def test_a_body_that_is_only_seen_is_one_that_is_not_known(loaded):
    seen = '<geom size="0.05" contype="0" conaffinity="0"/>'
    assert loaded(mjcf().replace('<geom size="0.05"/>', seen)).bare_links == ("b",)


def test_it_is_added_with_its_home(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "arm.xml").write_text(TRIAL, encoding="utf-8")
    path = toml_beside("arm.xml")
    assert path.name == "arm.toml"
    with pytest.raises(ConfigurationError, match=r"--tcp tip +#"):
        add("arm.xml", path)
    added = add("arm.xml", path, "tip")
    assert {each.key for each in added.proposals} == {"velocity_deg_s"}
    assert dict(added.report())["home"].endswith(
        "the file's own, its smallest singular value is 0.017"
    )
    assert added.write().home == pytest.approx((0.1, 0.2, 0.1, 0.3, 0.4))


def test_speeds_are_asked_for(loaded):
    with pytest.raises(ConfigurationError, match="limits are missing: velocity of 'j'"):
        loaded(mjcf(), "")
    with pytest.raises(ConfigurationError, match="velocity of 'j'; lower of 'j'; upper of 'j'"):
        loaded(mjcf(joint='<joint name="j" type="slide"/>'), "")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot/>", "the arm's MJCF is a <robot>, not a <mujoco>"),
        ("<mujoco", "the arm's MJCF is not XML"),
        ('<!DOCTYPE m [<!ENTITY a "b">]><mujoco/>', "declares the entity 'a'"),
        ("<mujoco>" + "<body>" * 2000 + "</body>" * 2000 + "</mujoco>", "more than 100 others"),
        (mjcf('<include file="x.xml"/>'), "has <include>"),
        (mjcf('<attach model="x"/>'), "has <attach>"),
        (mjcf("<replicate/>"), "has <replicate>"),
        (mjcf("<composite/>"), "has <composite>"),
        (mjcf(head='<compiler angle="grad"/>'), "'grad' must be degree or radian"),
        (mjcf(head='<compiler eulerseq="xyw"/>'), "eulerseq of compiler: 'xyw'"),
        (mjcf(head='<compiler coordinate="global"/>'), "coordinate="),
        (mjcf(head='<compiler settotalmass="3"/>'), "settotalmass"),
        (mjcf(joint='<joint name="j" type="screw"/>'), "joint 'j' is 'screw'; allowed: hinge"),
        (mjcf(joint='<joint name="j" axis="0 0 0"/>'), "joint 'j' has a vector without a dir"),
        (mjcf(joint='<joint name="j" axis="0 1"/>'), "axis of joint 'j': '0 1' is not 3 numbers"),
        (mjcf(joint='<joint name="j" range="0 1e308"/>'), "range of joint 'j': .* at most 1e[+]06"),
        (mjcf(joint='<joint name="j" limited="no"/>'), "limited of joint 'j': 'no' must be true"),
        (
            mjcf(head='<compiler autolimits="false"/>'),
            "joint 'j' has a range: with autolimits=\"false\" say whether",
        ),
        (mjcf(joint='<joint name="j" class="x"/>'), "there is no default class 'x'"),
        (mjcf('<geom type="hfield"/>'), "a geom without a name is a hfield; allowed: sphere"),
        (mjcf('<geom name="g" type="mesh" mesh="x"/>'), "geom 'g': there is no mesh 'x'"),
        (
            mjcf('<geom name="g" type="mesh" mesh="x"/>', '<asset><mesh name="x"/></asset>'),
            "geom 'g': mesh 'x' has no file",
        ),
        (
            mjcf(head='<asset><mesh name="x" refpos="1 0 0"/></asset>'),
            "mesh 'x' has refpos",
        ),
        (mjcf('<geom name="g" size="0"/>'), "size of geom 'g': '0' is not a length"),
        (mjcf('<geom name="g" type="capsule" size="1"/>'), "size of geom 'g': '1' is not 2 numb"),
        (mjcf('<site name="s" quat="0 0 0 0"/>'), "quat of site 's' has no direction"),
        (mjcf('<site name="s" quat="1 0 0 0" euler="0 0 0"/>'), "site 's' has euler and quat"),
        (mjcf('<body name="a"/>'), "every link has a name of its own"),
        (mjcf("<body/>" * 1000), "1002 body elements are more than 1000"),
    ],
)
def test_what_cannot_be_translated_is_one_error_soon(loaded, text, words):
    start = time.thread_time()
    with pytest.raises(ConfigurationError, match=words) as caught:
        loaded(text)
    assert re.search(r"arm\.xml: ", str(caught.value))
    assert time.thread_time() - start < 5.0
