"""Telescope: slides in a row that follow a leading one act as one joint of an arm."""

from __future__ import annotations

import re

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.robots import Capsule, OrientedBox, load_arm, parse_urdf
from cardan.robots.arm_bodies import to_se3
from cardan.robots.telescope import Sweep, swept
from cardan.types import Pose, Quaternion, Vector3

FACTORS = {"s1": 1.0, "s2": 0.5, "s3": 2.0}
OFFSETS = {"s1": 0.0, "s2": 0.01, "s3": 0.0}
SHAPE = '<box size="0.1 0.2 0.3"/>'


def slide(name, parent, child, rpy="0 0 0", axis="1 0 0", limit="", mimic="", kind="prismatic"):
    return f"""<joint name="{name}" type="{kind}"><parent link="{parent}"/>
      <child link="{child}"/><origin xyz="0.05 0.02 0.01" rpy="{rpy}"/><axis xyz="{axis}"/>
      <limit lower="0" upper="0.2" velocity="0.4" effort="70"{limit}/>{mimic}</joint>"""


def follow(name, leader="s1"):
    return f'<mimic joint="{leader}" multiplier="{FACTORS[name]}" offset="{OFFSETS[name]}"/>'


def arm(second=None, third=None, shape=SHAPE, first=None):
    """Return an arm of a rotation, three slides along one line with rotated frames, and a wrist."""
    collision = (
        '<collision><origin xyz="0.02 0.01 0.03" rpy="0.1 0.2 0.3"/>'
        f"<geometry>{shape}</geometry></collision>"
    )
    links = "".join(f'<link name="{each}">{collision}</link>' for each in ("a", "b", "c", "side"))
    frames = "".join(f'<link name="{each}"/>' for each in ("root", "base", "weld", "tip", "hand"))
    second = second or slide("s2", "weld", "b", axis="0 0 -1", mimic=follow("s2"))
    third = third or slide("s3", "b", "tip", axis="0 0 -2", mimic=follow("s3"))
    return f"""<robot name="r">{links}{frames}
      {slide("turn", "root", "base", "0.1 0 0", "0 0 1", kind="continuous")}
      {first or slide("s1", "base", "a", "0 0 0.4")}
      <joint name="w" type="fixed"><parent link="a"/><child link="weld"/>
        <origin xyz="0 0.1 0" rpy="0 -1.5707963267948966 0"/></joint>
      {second}{third}
      <joint name="x" type="fixed"><parent link="b"/><child link="side"/>
        <origin xyz="0 0.1 0" rpy="0.3 0.2 0.1"/></joint>
      {slide("wrist", "tip", "c", "0.2 0.3 0", "0 1 0", kind="revolute")}
      <joint name="y" type="fixed"><parent link="c"/><child link="hand"/></joint></robot>"""


@pytest.fixture
def loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def load(text, toml=""):
        (tmp_path / "r.urdf").write_text(text, encoding="utf-8")
        (tmp_path / "r.toml").write_text(f'urdf = "r.urdf"\ntcp = "hand"\n{toml}', "utf-8")
        load_arm.cache_clear()
        return load_arm(str(tmp_path / "r.toml"))

    return load


def whole():
    """Return Pinocchio's model of all joints, and its positions for those of the arm."""
    model = pin.buildModelFromXML(arm().replace(follow("s2"), "").replace(follow("s3"), ""))

    def positions(turn, way, wrist):
        lead = (way - sum(OFFSETS.values())) / sum(FACTORS.values())
        q = pin.neutral(model)
        at = {name: FACTORS[name] * lead + OFFSETS[name] for name in FACTORS}
        for name, value in {**at, "wrist": wrist}.items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        start = model.joints[model.getJointId("turn")].idx_q
        q[start : start + 2] = np.cos(turn), np.sin(turn)
        return q

    return model, positions


def test_it_is_one_slide_that_is_as_long_as_all(loaded):
    model = loaded(arm())
    assert model.joint_names == ("turn", "s1", "wrist")
    joint = model.joints[1]
    # The third slide reaches its end first: at 0.1 m of the first one.
    assert (joint.lower, joint.upper) == pytest.approx((0.01, 0.36))
    assert joint.velocity == pytest.approx(0.2 * 3.5)
    assert joint.effort == pytest.approx(70 / 3.5)
    theirs, positions = whole()
    data, ours = theirs.createData(), ArmKinematics(model)
    for q in np.random.default_rng(1).uniform((-3, 0.01, 0), (3, 0.36, 0.2), (20, 3)):
        pin.framesForwardKinematics(theirs, data, positions(*q))
        tip = data.oMf[theirs.getFrameId("hand")]
        assert np.abs(tip.homogeneous - ours.forward(q).homogeneous).max() < 1e-9


@pytest.mark.parametrize("last", [2.0, 0.5], ids=["with the base", "with the end"])
@pytest.mark.parametrize(
    "shape",
    [
        SHAPE,
        '<sphere radius="0.1"/>',
        '<capsule radius="0.05" length="0.3"/>',
    ],
)
def test_bodies_between_are_where_they_truly_are_and_more(loaded, shape, last, monkeypatch):
    monkeypatch.setitem(FACTORS, "s3", last)
    text = arm(shape=shape).replace('<robot name="r">', '<robot name="r" version="1.1">')
    model, (theirs, positions) = loaded(text), whole()
    ours, data = ArmKinematics(model), theirs.createData()
    bare = {each.name: each.shape for each in parse_urdf(alone(shape)).shapes}["l"]
    rng = np.random.default_rng(2)
    for q in rng.uniform((-3, 0.01, 0), (3, model.upper[1], 0.2), (20, 3)):
        pin.framesForwardKinematics(theirs, data, positions(*q))
        mine = ours.model.createData()
        pin.forwardKinematics(ours.model, mine, q)
        for each in model.shapes:
            place = data.oMf[theirs.getFrameId(each.name)]
            there = [place.act(point) for point in points(bare, rng)]
            local = [mine.oMi[each.body].actInv(point) for point in there]
            assert all(contains(each.shape, point) for point in local), each.name
    names = [each.name for each in model.shapes]
    assert sorted(names) == ["a", "b", "c", "side"]


def alone(shape):
    """Return the same body on its own link."""
    return f"""<robot name="r" version="1.1"><link name="a"/><link name="l"><collision>
      <origin xyz="0.02 0.01 0.03" rpy="0.1 0.2 0.3"/><geometry>{shape}</geometry></collision>
      </link>{slide("j", "a", "l")}</robot>"""


def points(shape, rng):
    """Return points on its surface, from Pinocchio."""
    for _ in range(20):
        out = rng.normal(size=3)
        out /= np.linalg.norm(out)
        if isinstance(shape, OrientedBox):
            at = 0.5 * out / np.abs(out).max() * np.array(shape.size_m)
            yield to_se3(shape.pose).act(at)
        else:
            middle = rng.uniform()
            start, end = np.array(shape.start), np.array(shape.end)
            yield start + middle * (end - start) + shape.radius_m * out


def contains(shape, point):
    if isinstance(shape, OrientedBox):
        local = to_se3(shape.pose).actInv(point)
        return bool((np.abs(local) <= 0.5 * np.array(shape.size_m) + 1e-9).all())
    start, axis = np.array(shape.start), np.array(shape.end) - np.array(shape.start)
    length = float(axis @ axis)
    share = np.clip((point - start) @ axis / length, 0.0, 1.0) if length else 0.0
    return bool(np.linalg.norm(point - start - share * axis) <= shape.radius_m + 1e-9)


units = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


@given(units, units, st.booleans(), st.floats(-0.5, 0.5), st.floats(0, 0.5), st.floats(0, 1))
def test_what_is_swept_contains_the_shape_all_along(direction, axis, is_box, low, longer, share):
    way = Vector3(*(np.array(direction) / np.linalg.norm(direction)).tolist())
    shape = Capsule(Vector3(0.1, 0.0, 0.2), Vector3(*axis), 0.05)
    if is_box:
        turned = pin.Quaternion(pin.exp3(np.array(axis))).coeffs().tolist()
        at = Pose(Vector3(0.1, 0.2, 0.3), Quaternion(turned[3], *turned[:3]))
        shape = OrientedBox(at, Vector3(0.1, 0.2, 0.3))
    larger = swept(shape, way, Sweep("j", low, low + longer))
    moved = (low + share * longer) * np.array(way)
    for point in points(shape, np.random.default_rng(3)):
        assert contains(larger, point + moved)


def test_along_its_axis_a_capsule_stays_one():
    shape = Capsule(Vector3(0.0, 0.0, 0.1), Vector3(0.0, 0.0, 0.3), 0.05)
    longer = swept(shape, Vector3(0.0, 0.0, -1.0), Sweep("j", -0.1, 0.2))
    assert isinstance(longer, Capsule)
    assert sorted((longer.start.z, longer.end.z)) == pytest.approx([-0.1, 0.4])


@pytest.mark.parametrize(
    "text",
    [
        arm(second=slide("s2", "weld", "b", axis="0 1 0", mimic=follow("s2"))),
        arm(second=slide("s2", "weld", "b", axis="0 0 1", mimic=follow("s2"))),
        arm(second=slide("s2", "weld", "b", axis="0 0 -1", kind="revolute", mimic=follow("s2"))),
        arm(second=slide("between", "weld", "b", axis="0 0 -1")),
        arm(
            second=slide("s2", "weld", "b", axis="0 0 -1", mimic=follow("s2").replace("0.5", "-1"))
        ),
    ],
    ids=["elsewhere", "back", "turns", "another between", "negative"],
)
def test_what_is_no_telescope_is_refused(loaded, text):
    with pytest.raises(
        ConfigurationError, match=r"joint 's\d' mimics 's1', and they are not a tele"
    ):
        loaded(text)


def test_what_is_no_telescope_is_held_by_the_line_that_is_proposed(loaded):
    text = arm(second=slide("s2", "weld", "b", axis="0 1 0", mimic=follow("s2")))
    with pytest.raises(ConfigurationError, match=r"write joints = .*, without 's1'") as refused:
        loaded(text)
    (line,) = re.findall(r"joints = \[[^]]*\]", str(refused.value))
    assert "s1" not in loaded(text, line).joint_names


def test_ranges_without_anything_in_common_are_refused(loaded):
    mimic = follow("s2").replace("0.01", "0.5")
    text = arm(second=slide("s2", "weld", "b", axis="0 0 -1", mimic=mimic))
    with pytest.raises(ConfigurationError, match="s1, s2, s3 move as one, but have no range"):
        loaded(text)


def test_the_leader_may_be_any_of_them(loaded):
    first = slide("s1", "base", "a", "0 0 0.4", mimic='<mimic joint="s2"/>')
    second = slide("s2", "weld", "b", axis="0 0 -1")
    third = slide("s3", "b", "tip", axis="0 0 -2", mimic='<mimic joint="s1"/>')
    model = loaded(arm(second, third, first=first))
    assert model.joint_names == ("turn", "s2", "wrist")
    assert model.joints[1].upper == pytest.approx(0.6)
