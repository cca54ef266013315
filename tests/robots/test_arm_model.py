"""Data of arm models."""

import contextlib
import math
import re
import shutil
from importlib.resources import files

import pytest
from hypothesis import given, strategies as st

from cardan.errors import ConfigurationError
from cardan.robots import arm_names, limits_in, load_arm, parse_urdf
from cardan.robots.arm_model import Task


def test_gofa():
    arm = load_arm("gofa_crb15000_5")
    assert arm.joint_names == tuple(f"joint_{i}" for i in range(1, 7))
    assert [round(math.degrees(q)) for q in arm.lower] == [-180, -180, -225, -180, -180, -180]
    assert [round(math.degrees(q)) for q in arm.upper] == [180, 180, 85, 180, 180, 180]
    assert [round(math.degrees(v)) for v in arm.velocity] == [125, 125, 140, 200, 200, 200]


@pytest.mark.parametrize("name", arm_names())
def test_every_arm_loads_under_its_own_name(name):
    arm = load_arm(name)
    assert arm.name == name
    assert all(low < high for low, high in zip(arm.lower, arm.upper, strict=True))


def test_an_unknown_arm_is_named():
    with pytest.raises(ConfigurationError, match=r"no arm 'gofer'; allowed: .*gofa_crb15000_5"):
        load_arm("gofer")


JOINT = '<joint name="{name}" type="{kind}"><parent link="{a}"/><child link="{b}"/>{limit}</joint>'
LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="0"/>'


def bare(*elements):
    return f'<robot name="r">{"".join(elements)}</robot>'


def urdf(*elements):
    """Return a URDF with the links that its joints name."""
    text = bare(*elements)
    named = dict.fromkeys(re.findall(r'<(?:parent|child) link="([^"]+)"', text))
    there = re.findall(r'<link name="([^"]*)"', text)
    return bare(*elements, *(link("", name) for name in named if name not in there))


def joint(name="j", kind="revolute", a="base", b="one", limit=LIMIT):
    return JOINT.format(name=name, kind=kind, a=a, b=b, limit=limit)


def test_order_is_from_base_to_tip_and_fixed_joints_do_not_count():
    arm = parse_urdf(
        urdf(
            joint("wrist", "continuous", "two", "three"),
            joint("weld", "fixed", "one", "two", ""),
            joint("shoulder"),
        )
    )
    assert arm.joint_names == ("shoulder", "wrist")
    assert arm.lower == (-1.0, -math.inf)


def limit(**changes):
    values = {"lower": "-1", "upper": "2", "velocity": "3", "effort": "0"} | changes
    given = " ".join(f'{key}="{value}"' for key, value in values.items() if value is not None)
    return f"<limit {given}/>"


def link(inside, name="one"):
    return f'<link name="{name}">{inside}</link>'


def collision(geometry, origin=""):
    return link(f"<collision>{origin}<geometry>{geometry}</geometry></collision>")


def inertial(mass='<mass value="1"/>', tensor="", origin=""):
    return link(f"<inertial>{origin}{mass}{tensor}</inertial>")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "not XML"),
        ("", "not XML"),
        ("<robot>\ud800</robot>", "not XML: .*surrogates"),
        ("<arm/>", "is a <arm>, not a <robot>"),
        ("<robot/>", r"one base link, not \[\]: it has no joint"),
        (urdf(joint(a="x", b="y"), joint("k", a="y", b="x")), "cycle: x -> y -> x"),
        (urdf(joint(kind="fixed")), "no moving joint"),
        (urdf(joint(kind="floating")), "joint 'j' is 'floating'; allowed: fixed, revolute"),
        (urdf(joint(), joint("k", b="other")), "link 'base' branches"),
        (urdf(joint(), joint("k", a="x", b="y")), "one base link"),
        (urdf(joint(), joint("k", a="one", b="one")), "'one' is reached twice"),
        (
            urdf(joint(), joint("k", a="x", b="y"), joint("l", a="y", b="x")),
            r"links \['x', 'y'\] are not joined to the base",
        ),
        (urdf(joint(), joint(a="one", b="two")), r"a name of its own, not \['j', 'j'\]"),
        (urdf(joint(name="")), "a name of its own"),
        (urdf('<joint name="j" type="revolute"/>'), "lacks its parent"),
        (urdf(joint(b="")), "'j' lacks its parent or child"),
        (urdf(joint(limit="")), "velocity of 'j'; lower of 'j'; upper of 'j'"),
        (urdf(joint(limit=limit(lower=None))), "missing: lower of 'j'(.|\n)*no lower"),
        (urdf(joint(limit=limit(velocity=None))), "no velocity"),
        (urdf(joint(limit=limit(lower="a"))), "'j': lower 'a' is not a number"),
        (urdf(joint(limit=limit(lower="nan"))), "lower nan and upper 2 are not a range"),
        (urdf(joint(limit=limit(lower="3"))), "lower 3 and upper 2 are not a range"),
        (urdf(joint(limit=limit(upper="inf"))), "missing: upper of 'j'(.|\n)*upper inf"),
        (urdf(joint(limit=limit(velocity="0"))), "missing: velocity of 'j'(.|\n)*velocity 0"),
        (urdf(joint(limit=limit(velocity="-1"))), "velocity -1 is not a speed"),
        (urdf(joint(limit=limit(velocity="nan"))), "velocity nan is not a speed"),
        (urdf(joint(limit=limit(effort="-1"))), "effort -1 is not a torque"),
        (urdf(joint(limit=limit(effort="nan"))), "effort nan is not a torque"),
        (urdf(joint(limit=LIMIT + '<axis xyz="0 0 0"/>')), "axis of joint 'j' has no direction"),
        (urdf(joint(limit=LIMIT + '<axis xyz="0 1"/>')), "axis of 'j': '0 1' is not three"),
        (urdf(joint(limit=LIMIT + '<origin xyz="0 nan 1"/>')), "joint 'j': '0 nan 1' is not three"),
        (urdf(joint(limit=LIMIT + '<origin rpy="0 1e9 1"/>')), "of at most 1e[+]06"),
        (urdf(joint(), inertial(mass="")), "the inertial of link 'one': no <mass>"),
        (urdf(joint(), inertial(mass="<mass/>")), "no value"),
        (urdf(joint(), inertial(mass='<mass value="-1"/>')), "mass -1 kg is not 0 to"),
        (urdf(joint(), inertial(mass='<mass value="nan"/>')), "mass nan kg"),
        (urdf(joint(), inertial(tensor='<inertia ixy="x"/>')), "ixy 'x' is not a number"),
        (urdf(joint(), inertial(tensor='<inertia ixx="inf"/>')), "moments .* are not numbers"),
        (urdf(joint(), inertial(tensor='<inertia iyy="-1"/>')), "negative ixx, iyy or izz"),
        (
            urdf(joint(), inertial(origin='<origin xyz="1"/>')),
            "origin of the inertial of link 'one",
        ),
        (urdf(joint(), link("<collision/>")), "element of link 'one' has no geometry"),
        (urdf(joint(), collision("")), "element of link 'one' has no geometry"),
        (urdf(joint(), collision("<sphere/>")), "sphere of link 'one': no radius"),
        (urdf(joint(), collision('<sphere radius="-1"/>')), "radius '-1' is not a length"),
        (urdf(joint(), collision('<sphere radius="nan"/>')), "radius 'nan' is not a length"),
        (
            urdf(joint(), collision('<cylinder radius="1" length="0"/>')),
            "length '0' is not a length",
        ),
        (
            urdf(joint(), collision('<capsule radius="x" length="1"/>')),
            "radius 'x' is not a number",
        ),
        (urdf(joint(), collision('<box size="1 0 1"/>')), "box of link 'one' has no size"),
        (urdf(joint(), collision('<box size="1 1"/>')), "size of the box of link 'one': '1 1'"),
        (urdf(joint(), collision("<cone/>")), "is a cone; allowed: sphere, cylinder, capsule, box"),
        (
            urdf(joint(), collision('<sphere radius="1"/>', '<origin xyz="x 0 0"/>')),
            "origin of a collision element of link 'one'",
        ),
        (
            urdf(joint(), collision('<mesh filename="m"/>')),
            r'a mesh; .*collision.meshes = "ignore"',
        ),
    ],
)
def test_errors_say_what_is_wrong(text, words):
    with pytest.raises(ConfigurationError, match=words):
        parse_urdf(text)


ARM = urdf(
    joint("lift", "prismatic"),
    joint("elbow", a="one", b="two"),
    joint("weld", "fixed", "two", "hand", '<origin xyz="0 0 0.5"/>'),
    collision('<mesh filename="m"/>'),
)


@pytest.fixture
def arm_file(tmp_path):
    def write(text, arm=ARM):
        (tmp_path / "own.urdf").write_text(arm, encoding="utf-8")
        path = tmp_path / "own.toml"
        path.write_text(text, encoding="utf-8")
        load_arm.cache_clear()
        return str(path)

    return write


OWN = """
urdf = "own.urdf"
tcp = "hand"
flange = "two"
home_deg = [0.5, 30.0]
acceleration_deg_s2 = [2.0, 90.0]

[task]
axes = "base"
weights = [1, 1, 1, 0, 0, 0.5]

[collision]
meshes = "ignore"
ignore = [["two", "base"]]

[[collision.shape]]
capsule = [[0, 0, 0], [0, 0, 1.0], 0.1]

[[collision.shape]]
name = "tray"
link = "hand"
box = [[0, 0, 0], [0.2, 0.4, 0.6]]
"""


def test_what_the_file_says_is_what_the_arm_is(arm_file):
    arm = load_arm(arm_file(OWN))
    assert arm.home == pytest.approx((0.5, math.pi / 6))
    assert [j.acceleration for j in arm.joints] == pytest.approx([2.0, math.pi / 2])
    assert arm.tcp.position == (0.0, 0.0, 0.5)
    assert arm.flange.position == (0.0, 0.0, 0.0)
    assert arm.task == Task(axes="base", weights=(1.0, 1.0, 1.0, 0.0, 0.0, 0.5))
    assert arm.ignored_pairs == {(0, 2)}
    base, tray = arm.shapes
    assert (base.name, base.body, base.shape.radius_m) == ("base", 0, 0.1)
    assert (tray.name, tray.body) == ("tray", 2)
    assert tray.shape.pose.position == pytest.approx((0.1, 0.2, 0.8))
    assert tray.shape.size_m == pytest.approx((0.2, 0.4, 0.6))


def test_defaults_where_the_file_says_nothing(arm_file):
    arm = load_arm(arm_file('urdf = "own.urdf"\ncollision.meshes = "ignore"'))
    assert arm.home == pytest.approx((0.5, 0.5))
    assert [j.acceleration for j in arm.joints] == pytest.approx([15.0, 15.0])
    assert arm.tcp == arm.flange
    assert arm.tcp.position.z == 0.5
    assert arm.task.weights == (1.0,) * 6
    assert arm.shapes == ()
    assert arm.counterbalanced_joints == 0


@pytest.mark.parametrize("name", arm_names())
def test_springs_carry_the_arms_of_a_pr2_to_the_elbow(name):
    assert load_arm(name).counterbalanced_joints == (4 if name.startswith("pr2") else 0)


def test_a_shape_of_one_s_own_takes_the_place_of_a_mesh(arm_file):
    text = 'urdf = "own.urdf"\n[[collision.shape]]\nlink = "one"\nbox = [[0, 0, 0], [1, 1, 1]]'
    assert [shape.name for shape in load_arm(arm_file(text)).shapes] == ["one"]


def changed(old, new):
    assert old in OWN
    return OWN.replace(old, new)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("urdf = ", r"own\.toml:1:8: is not TOML"),
        ("", "urdf: is missing"),
        (changed('"own.urdf"', "3"), "urdf: 3 is not allowed; it must be a text"),
        (changed('"own.urdf"', '"$NOWHERE/own.urdf"'), "the environment has no variable NOWHERE"),
        (changed('"own.urdf"', '"other.urdf"'), r"cannot read .*other\.urdf: No such file"),
        (
            changed('"own.urdf"', r'"\u0000.urdf"'),
            "urdf: '.*urdf' is not allowed; it must be a text without a NUL",
        ),
        (changed("tcp =", "tpc ="), "tpc: there is no such key; .*did you mean 'tcp'"),
        (changed('"hand"', '"paw"'), "tcp: there is no link 'paw'; allowed: base, one, two, hand"),
        (
            changed('tcp = "hand"', 'tcp = "one"'),
            "acceleration_deg_s2: has 2 values for 1 joints: lift",
        ),
        (
            changed('flange = "two"', 'flange = "one"'),
            "flange: link 'one' is not moved by the last joint",
        ),
        (changed('flange = "two"', 'flange = "x"'), "flange: there is no link 'x'"),
        (changed('"hand"', '"hadn"'), "tcp: there is no link 'hadn'; .*; did you mean 'hand'"),
        (
            changed('flange = "two"', 'flange = "Two"'),
            "flange: there is no link 'Two'; .*; did you mean 'two'",
        ),
        (
            changed('["two", "base"]', '["two", "bse"]'),
            "collision.ignore: there is no link 'bse'; .*; did you mean 'base'",
        ),
        (
            changed('link = "hand"', 'link = "hands"'),
            "collision.shape.link: there is no link 'hands'; .*; did you mean 'hand'",
        ),
        (
            'counterbalance = "elbwo"\n' + OWN,
            "counterbalance: there is no joint 'elbwo'; .*; did you mean 'elbow'",
        ),
        (
            'counterbalance = "ankle"\n' + OWN,
            "counterbalance: there is no joint 'ankle'; allowed: lift, elbow",
        ),
        (changed("[0.5, 30.0]", "[0.5]"), "home_deg: has 1 values for 2 joints"),
        (changed("[0.5, 30.0]", "[0.5, 200]"), "home_deg: elbow at 200 is outside -57.* to 114"),
        (changed("[0.5, 30.0]", "[0.5, nan]"), r"home_deg: \[0.5, nan\] .*-1000000 to 1000000"),
        (changed("[0.5, 30.0]", '["0.5", 3]'), r"home_deg: \['0.5', 3\] .*-1000000 to 1000000"),
        (changed("[2.0, 90.0]", "[2.0]"), "acceleration_deg_s2: has 1 values for 2 joints"),
        (changed("[2.0, 90.0]", "0"), "acceleration_deg_s2: 0 .*must be above 0, at most 1000000"),
        (
            changed("[2.0, 90.0]", "1e7"),
            "acceleration_deg_s2: 1.*at most 1000000 or several values",
        ),
        (changed('"base"\nweights', '"tool"\nweights'), "task.axes: 'tool' .*one of tcp, base"),
        (changed("[1, 1, 1, 0, 0, 0.5]", "[1, 1]"), "task.weights: .*must be 6 values"),
        (
            changed("[1, 1, 1, 0, 0, 0.5]", "[1, 1, 1, 1, 1, -1]"),
            "task.weights: .*-1.* must be 0 or more",
        ),
        (
            changed("[1, 1, 1, 0, 0, 0.5]", "[0, 0, 0, 0, 0, 0]"),
            "task.weights: .*one at least above 0",
        ),
        (
            changed('meshes = "ignore"', 'meshes = "load"'),
            "collision.meshes: 'load' .*one of fit, ignore",
        ),
        (changed('["two", "base"]', '["two", "paw"]'), "collision.ignore: there is no link 'paw'"),
        (changed('["two", "base"]', '["two"]'), "collision.ignore: .*must be 2 values"),
        (changed('link = "hand"', 'link = "paw"'), "collision.shape.link: there is no link 'paw'"),
        (changed("1.0], 0.1]", "1.0], -0.1]"), "capsule: .*-0.1.* must be above 0, at most 100 m"),
        (changed("1.0], 0.1]", "nan], 0.1]"), "capsule: .*nan.* must be -100 to 100 m"),
        (changed("0.4, 0.6]", "0, 0.6]"), "collision.shape.1.box: lowest corner .* first"),
        (
            changed("box = ", "capsule = [[0,0,0],[1,0,0],1]\nbox = "),
            r"shape.1: 'tray' has box and capsule; give one of box = \[c",
        ),
        (changed("capsule = ", "# "), "shape.0: it has no shape; give one of"),
    ],
)
def test_errors_of_the_file_name_it_and_the_key(arm_file, text, words):
    with pytest.raises(ConfigurationError, match=words) as caught:
        load_arm(arm_file(text))
    assert "own.toml" in str(caught.value)


@pytest.mark.parametrize("name", ["nowhere/own.urdf", "nowhere/own.toml", "\0.urdf"])
def test_a_file_that_is_not_there(name):
    with pytest.raises(ConfigurationError, match="cannot read"):
        load_arm(name)


def test_an_arm_in_a_package(tmp_path, monkeypatch):
    package = tmp_path / "somebodys_arms"
    package.mkdir()
    (package / "__init__.py").write_text("raise AssertionError('imported')")
    for file in ("ur5.toml", "ur5.urdf"):
        shutil.copy(files("cardan") / "robots" / file, package)
    monkeypatch.syspath_prepend(tmp_path)
    assert load_arm("somebodys_arms:ur5.toml") == load_arm("ur5")
    for file, words in (
        ("somebodys_arms:ur6.toml", r"somebodys_arms.ur6\.toml|ur6\.toml cannot be read"),
        ("nobodys_arms:ur5.toml", "'nobodys_arms:ur5.toml': there is no package 'nobodys_arms'"),
        ("types:ur5.urdf", "there is no package 'types'"),
    ):
        with pytest.raises(ConfigurationError, match=words):
            load_arm(file)


def test_a_file_that_is_not_text(tmp_path):
    path = tmp_path / "own.urdf"
    path.write_bytes(b"\xff\xfe<")
    with pytest.raises(ConfigurationError, match=r"cannot read .*own\.urdf"):
        load_arm(str(path))


def test_a_capsule_is_a_cylinder_and_its_ends():
    cylinder = '<cylinder radius="0.1" length="0.4"/>'
    parts = [("0 0 0", cylinder), ("0 0 0.2", '<sphere radius="0.1"/>')]
    parts += [("0 0 -0.2", '<sphere radius="0.1"/>'), ("1 0 0", '<sphere radius="0.1"/>')]
    inside = "".join(
        f'<collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision>'
        for at, shape in parts
    )
    shapes = [shape.shape for shape in parse_urdf(urdf(joint(), link(inside))).shapes]
    assert shapes == [
        ((0.0, 0.0, -0.2), (0.0, 0.0, 0.2), 0.1),
        ((1.0, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1),
    ]


WORDS = st.sampled_from(
    ["0", "1", "-1", "1e308", "-1e308", "1e-320", "nan", "inf", "x", "", "1 2 3"]
)
THREE = st.lists(WORDS, min_size=2, max_size=4).map(" ".join)


@st.composite
def wild_urdf(draw):
    """Return valid elements with arbitrary attributes, in arbitrary order, some missing."""
    links = st.sampled_from(["base", "one", "two", "hand", ""])
    kinds = st.sampled_from(["revolute", "continuous", "prismatic", "fixed", "planar"])
    parts = []
    for number in range(draw(st.integers(1, 3))):
        inside = draw(
            st.builds('<origin xyz="{}" rpy="{}"/><axis xyz="{}"/>'.format, THREE, THREE, THREE)
            | st.just("")
        ) + draw(st.just(LIMIT) | st.builds(limit, lower=WORDS, upper=WORDS, velocity=WORDS))
        chained = draw(st.booleans())
        start = ["base", "one", "two"][number] if chained else draw(links)
        end = ["one", "two", "hand"][number] if chained else draw(links)
        parts.append(joint(draw(st.sampled_from("jkl")), draw(kinds), start, end, inside))
    shapes = st.one_of(
        st.builds('<sphere radius="{}"/>'.format, WORDS),
        st.builds('<cylinder radius="{}" length="{}"/>'.format, WORDS, WORDS),
        st.builds('<box size="{}"/>'.format, THREE),
        st.just("<mesh/>"),
    )
    for _ in range(draw(st.integers(0, 3))):
        shape, at = draw(shapes), draw(THREE)
        parts.append(
            f'<link name="{draw(links)}"><inertial><mass value="{draw(WORDS)}"/>'
            f'<inertia ixx="{draw(WORDS)}" iyy="{draw(WORDS)}"/></inertial>'
            f'<collision><origin xyz="{at}"/><geometry>{shape}</geometry></collision></link>'
        )
    return urdf(*draw(st.permutations(parts)))


@given(wild_urdf())
def test_any_urdf_is_an_arm_of_finite_numbers_or_an_error(text):
    with contextlib.suppress(ConfigurationError):
        arm = parse_urdf(text)
        assert all(
            low <= q <= high for low, q, high in zip(arm.lower, arm.home, arm.upper, strict=True)
        )
        assert all(
            math.isfinite(x) for i in arm.inertias for x in (i.mass_kg, *i.center_m, *i.moments)
        )
        assert all(math.isfinite(x) for j in arm.joints for x in (*j.placement.position, *j.axis))


@given(st.text(max_size=80) | st.text('<>/ robotjinlkmefprchd="01-.', max_size=120))
def test_any_text_is_an_arm_or_an_error(text):
    with contextlib.suppress(ConfigurationError):
        parse_urdf(text)


LINKS = [link("", "base"), link("", "one")]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (bare(LINKS[0], joint()), r"joint 'j' names link 'one', there are \['base'\]"),
        (bare(LINKS[1], joint()), "joint 'j' names link 'base', there are"),
        (bare(joint()), r"joint 'j' names link 'base', there are \[\]"),
        (bare(LINKS[0], link("", "One"), joint()), r"'one', there are \['base', 'One'\]"),
        (bare(LINKS[0], link("", "one "), joint()), r"'one', there are \['base', 'one '\]"),
        (bare(*LINKS, joint(b=" one")), r"' one', there are \['base', 'one'\]"),
        (bare(*LINKS, LINKS[1], joint()), r"a name of its own, not \['base', 'one', 'one'\]"),
        (bare(*LINKS, "<link/>", joint()), "a name of its own"),
        (bare(*LINKS, link("", "two"), joint()), r"links \['two'\] are not joined to the base"),
    ],
)
def test_links_are_those_that_the_joints_name(text, words):
    with pytest.raises(ConfigurationError, match=words):
        parse_urdf(text)


def test_limits_of_a_joint_that_is_there_twice_are_not_chosen():
    text = bare(joint(), joint(limit=limit(velocity="30")))
    with pytest.raises(ConfigurationError, match="the URDF has 2 joints 'j'"):
        limits_in(text, ["j"])


@pytest.mark.parametrize(
    ("leader", "words"),
    [
        ("j", "joints: joint 'k' mimics 'j', and they are not a telescope: no other joint moves"),
        ("k", "joint 'k' mimics 'k', which cannot be followed"),
        ("l", "joint 'k' mimics 'l', which cannot be followed"),
    ],
)
def test_a_joint_that_mimics_another_of_the_arm_is_refused(leader, words):
    follower = joint("k", a="one", b="two", limit=f'{LIMIT}<mimic joint="{leader}"/>')
    with pytest.raises(ConfigurationError, match=words):
        parse_urdf(urdf(joint(), follower))


def test_soft_limits_narrow_the_range():
    soft = '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="5" k_velocity="1"/>'
    arm = parse_urdf(urdf(joint(limit=LIMIT + soft)))
    assert (arm.lower, arm.upper) == ((-0.5,), (2.0,))


BARE = '<visual><geometry><mesh filename="m"/></geometry></visual>'
MESH = '<collision><geometry><mesh filename="m"/></geometry></collision>'
BALL = '<collision><geometry><sphere radius="0.1"/></geometry></collision>'
TWO = (joint(), joint("k", a="one", b="two"))


@pytest.mark.parametrize(
    ("elements", "without"),
    [
        (TWO, "2 of 2 links have no body: one, two"),
        ((*TWO, link(MESH)), "2 of 2 links have no body: one, two"),
        ((*TWO, link(BALL)), "1 of 2 links have no body: two"),
        ((*TWO, link(MESH + BALL), link(BALL, "two")), ""),
        ((*TWO, link(BALL), link(BARE, "two")), "1 of 2 links have no body: two"),
        # The base does not move, and frames have no body.
        ((*TWO, link(MESH, "base"), link(BALL), joint("w", "fixed", "two", "case", "")), "1 of 2"),
        (
            (*TWO, link(BALL), joint("w", "fixed", "two", "case", ""), link(BALL, "case")),
            "",
        ),
        (
            (
                *(*TWO, link(BALL), link(BALL, "two")),
                *(joint("w", "fixed", "two", "tool", ""), link(MESH, "tool")),
            ),
            "1 of 3 links have no body: tool",
        ),
    ],
)
def test_links_without_a_body_are_reported(arm_file, elements, without):
    text = 'urdf = "own.urdf"\ncollision.meshes = "ignore"'
    said = load_arm(arm_file(text, urdf(*elements))).links_without_body()
    assert said == without if not without or ":" in without else said.startswith(without)


def test_a_shape_of_one_s_own_is_a_body(arm_file):
    text = 'urdf = "own.urdf"\n' + "".join(
        f'[[collision.shape]]\nlink = "{name}"\nbox = [[0, 0, 0], [1, 1, 1]]\n'
        for name in ("one", "two")
    )
    arm = load_arm(arm_file(text, urdf(*TWO, link(MESH), link(MESH, "two"))))
    assert arm.links_without_body() == ""


@pytest.mark.parametrize("name", arm_names())
def test_every_link_of_our_arms_has_a_body(name):
    assert load_arm(name).links_without_body() == ""
