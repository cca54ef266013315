"""Automatic choice of homes and of ignored pairs of bodies."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from cardan.errors import ConfigurationError
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.collision import CollisionModel
from cardan.robots import arm_names, load_arm, parse_urdf
from cardan.robots.arm_choices import bent_home, touching_shapes

OURS = tuple(arm_names())


def conditioned(arm, q):
    return ArmKinematics(arm).smallest_singular_value(np.array(q), arm.task.weights)


def nearest(arm, q):
    return min(CollisionModel(ArmKinematics(arm)).at(np.array(q)), default=math.inf)


@pytest.mark.parametrize("name", OURS)
def test_a_chosen_home_is_bent_and_free(name):
    arm = load_arm(name)
    home = bent_home(arm)
    assert home == bent_home(arm)
    assert arm.holds(home)
    middle = [0.0 if low == -math.inf else 0.5 * (low + high) for low, high in ranges(arm)]
    assert conditioned(arm, home) > 0.06
    assert nearest(arm, home) > 0.005
    if nearest(arm, middle) > 0.02:
        assert conditioned(arm, home) >= 0.9 * conditioned(arm, middle)
    for value, center, (low, high) in zip(home, middle, ranges(arm), strict=True):
        assert abs(value - center) <= min(0.25 * (high - low), math.pi / 2) + math.radians(0.5)
        assert math.degrees(value) == pytest.approx(round(math.degrees(value)), abs=1e-9)


def ranges(arm):
    return list(zip(arm.lower, arm.upper, strict=True))


def test_a_file_without_a_home_has_a_chosen_one_and_keeps_it(tmp_path, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path / "cache"))
    ur5 = load_arm("ur5")
    path = tmp_path / "ur5.urdf"
    path.write_text(ur5.urdf, encoding="utf-8")
    home = load_arm(str(path)).home
    load_arm.cache_clear()
    monkeypatch.setattr("cardan.robots.arm_loader._build", None)
    assert load_arm(str(path)).home == home
    assert conditioned(ur5, home) > 0.15 > conditioned(ur5, [0.0] * 6)


LINK = (
    '<link name="{name}"><inertial><origin xyz="0 0 -0.3"/><mass value="{mass}"/></inertial>'
    '<collision><origin xyz="{at}"/><geometry><sphere radius="0.1"/></geometry></collision></link>'
)
JOINT = (
    '<joint name="{name}" type="revolute"><parent link="{a}"/><child link="{b}"/>'
    '<origin xyz="{at}"/><axis xyz="0 1 0"/>'
    '<limit lower="{low}" upper="2" velocity="1" effort="9"/></joint>'
)


def test_of_postures_bent_alike_the_lightest_near_the_middle_is_home():
    pendulum = [
        '<link name="a"/>',
        LINK.format(name="b", mass=2, at="0 0 0"),
        JOINT.format(name="j", a="a", b="b", at="0 0 1", low=-1),
    ]
    (home,) = parse_urdf(f'<robot name="r">{"".join(pendulum)}</robot>').home
    assert 0.0 <= home < 0.06
    weightless = "".join(pendulum).replace('<mass value="2"/>', '<mass value="0"/>')
    assert parse_urdf(f'<robot name="r">{weightless}</robot>').home == (0.5,)


def fist(at="0 0 0"):
    """Return an arm of five links: c turns about its own middle, which is in a; e swings by b."""
    links = [("a", "0 0 0"), ("b", "0 0 0.4"), ("c", at), ("d", "0 0 0"), ("e", "0.3 0 0")]
    text = "".join(LINK.format(name=name, mass=1, at=at) for name, at in links)
    places = ["0 0 0.1", "0 0 0", "0.5 0 0", "0.3 0 0"]
    for (one, _), (other, _), place in zip(links, links[1:], places, strict=False):
        text += JOINT.format(name=f"to_{other}", a=one, b=other, at=place, low=-2)
    return f'<robot name="fist">{text}</robot>'


def watched(arm):
    return set(CollisionModel(ArmKinematics(arm)).pairs)


def test_bodies_that_touch_in_every_posture_are_left_out():
    arm = parse_urdf(fist())
    assert arm.touching_names() == [("a", "c")]
    assert watched(arm) == {("a", "d"), ("a", "e"), ("b", "d"), ("b", "e"), ("c", "e")}
    assert nearest(arm, arm.home) > 0.0
    separated = parse_urdf(fist("0 0 0.25"))
    assert separated.touching_names() == []
    assert ("a", "c") in watched(separated)


@pytest.fixture
def file(tmp_path):
    (tmp_path / "fist.urdf").write_text(fist(), encoding="utf-8")

    def write(toml, srdf=None):
        if srdf is not None:
            (tmp_path / "fist.srdf").write_text(srdf, encoding="utf-8")
            toml = f'srdf = "fist.srdf"\n{toml}'
        load_arm.cache_clear()
        path = tmp_path / "fist.toml"
        path.write_text(f'urdf = "fist.urdf"\n{toml}', encoding="utf-8")
        return load_arm(str(path))

    return write


PAIR = '<disable_collisions link1="{}" link2="{}" reason="Never"/>'


def test_an_srdf_says_which_pairs_are_left_out(file):
    given = file("", f'<robot name="fist">{PAIR.format("e", "b")}{PAIR.format("a", "no")}</robot>')
    assert given.disabled_shapes == {(1, 4)}
    assert given.touching_shapes == frozenset()
    assert watched(given) == {("a", "c"), ("a", "d"), ("a", "e"), ("b", "d"), ("c", "e")}
    other = file("", f'<robot name="fist">{PAIR.format("a", "c")}</robot>')
    assert watched(other) == {("a", "d"), ("a", "e"), ("b", "d"), ("b", "e"), ("c", "e")}


def test_a_pair_of_links_is_all_their_shapes_and_only_theirs(file):
    toml = '[[collision.shape]]\nname = "{}"\nlink = "{}"\ncapsule = [[0,0,0],[0,0,0.1],0.1]\n'
    pair = f'<robot name="fist">{PAIR.format("c", "a")}</robot>'
    arm = file("".join(toml.format(*each) for each in [("c1", "c"), ("c2", "c"), ("d", "d")]), pair)
    names = [shape.name for shape in arm.shapes]
    left_out = {(names[one], names[other]) for one, other in arm.disabled_shapes}
    assert left_out == {("a", "c1"), ("a", "c2")}


@pytest.mark.parametrize(
    ("srdf", "words"),
    [
        ("<robot>", "fist.srdf: the arm's SRDF is not XML"),
        ("<semantics/>", "fist.srdf: the arm's SRDF is a <semantics>"),
        ('<robot><disable_collisions link1="a"/></robot>', "fist.srdf: .*lacks its link1 or link2"),
    ],
)
def test_an_srdf_that_is_none_is_named(file, srdf, words):
    with pytest.raises(ConfigurationError, match=words):
        file("", srdf)


def test_an_srdf_that_is_not_there_is_named(file):
    with pytest.raises(ConfigurationError, match=r"no\.srdf"):
        file('srdf = "no.srdf"')


def test_ignored_pairs_name_links_or_shapes(file):
    toml = '[[collision.shape]]\nname = "hub"\nlink = "c"\ncapsule = [[0,0,0],[0,0,0],0.1]\n'
    for name in ("hub", "c"):
        arm = file(f'[collision]\nignore = [["{name}", "a"]]\n{toml}')
        assert arm.ignored_pairs == {(0, 2)}
        assert arm.touching_shapes == frozenset()


@pytest.mark.parametrize("name", OURS)
def test_no_pair_of_ours_that_counts_is_left_out(name):
    arm = load_arm(name)
    assert touching_shapes(arm) == arm.touching_shapes == arm.disabled_shapes == frozenset()


def test_names_of_pairs_are_said_once():
    text = re.sub(r"(<collision>.*?</collision>)", r"\1\1", fist())
    arm = parse_urdf(text)
    assert len(arm.touching_shapes) == 4
    assert arm.touching_names() == [("a", "c")]


def test_a_link_of_several_shapes_touches_if_any_of_them_does(file):
    """Each of the four ends of the cross c clears the ring's bar once per turn."""
    toml = (
        'home_deg = [0, 0, 0, 0]\n[[collision.shape]]\nlink = "c"\n'
        "capsule = [[0.3, 0, -0.3], [0.3, 0, 0.3], 0.04]\n"
        '[[collision.shape]]\nlink = "c"\ncapsule = [[0.3, 0, 0.3], [-0.3, 0, 0.3], 0.04]\n'
        '[[collision.shape]]\nlink = "c"\ncapsule = [[-0.3, 0, 0.3], [-0.3, 0, -0.3], 0.04]\n'
        '[[collision.shape]]\nlink = "c"\ncapsule = [[-0.3, 0, -0.3], [0.3, 0, -0.3], 0.04]\n'
        '[[collision.shape]]\nlink = "a"\nbox = [[-0.05, -0.1, 0.1], [0.05, 0.1, 0.9]]\n'
    )
    arm = file(toml)
    names = [shape.name for shape in arm.shapes]
    assert arm.touching_names() == [("c", "a")]
    assert sum({names[one], names[other]} == {"a", "c"} for one, other in arm.touching_shapes) == 4
