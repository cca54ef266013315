"""URDF files: accepted and refused like by other programs."""

from __future__ import annotations

import math
import re
import time
from pathlib import Path

import pinocchio as pin
import pytest

from cardan.errors import ConfigurationError
from cardan.robots import limits_in, load_arm, parse_urdf
from cardan.robots.urdf import MOST_LINKS

ROOT = Path(__file__).parents[2]


def urdf(head="", origin="", limit="", links="", collision="", name="j", attributes=""):
    """Return an arm of one joint with a fixed link at its end."""
    return (
        f'<robot name="r"{attributes}>{head}<link name="a"/><link name="b">{collision}</link>'
        f'<link name="c"/>{links}<joint name="{name}" type="revolute"><parent link="a"/>'
        f'<child link="b"/><axis xyz="0 0 1"/><limit lower="-1" upper="2" velocity="3" '
        f'effort="1"{limit}/></joint><joint name="weld" type="fixed"><parent link="b"/>'
        f'<child link="c"/>{origin}</joint></robot>'
    )


@pytest.fixture
def arm_file(tmp_path):
    def write(data, name="own.urdf", toml=None):
        (tmp_path / name).write_bytes(data if isinstance(data, bytes) else data.encode())
        path = tmp_path / name
        if toml is not None:
            path = tmp_path / "own.toml"
            path.write_text(toml, encoding="utf-8")
        load_arm.cache_clear()
        return str(path)

    return write


@pytest.mark.parametrize(
    "text",
    [
        urdf(attributes=' xmlns="http://www.ros.org"'),
        urdf(attributes=' xmlns:xacro="http://ros.org/wiki/xacro"'),
        urdf(head='<gazebo><sensor:camera sensor:kind="x"/></gazebo>'),
        "<!DOCTYPE robot>" + urdf(),
        urdf(head="<!-- <xacro:macro/> -->"),
        urdf(head='<transmission name="t"><joint name="j"/></transmission>'),
        '<?xml version="1.0" ?>' + urdf(attributes=' version="1.0"'),
        urdf(name="left/j"),
        urdf(name="{left}j"),
    ],
)
def test_what_others_read_is_read(text):
    (name,) = parse_urdf(text).joint_names
    assert name.endswith("j")
    assert limits_in(text, [name]).upper == (2.0,)


def test_a_file_is_in_the_encoding_that_its_xml_declares(arm_file):
    text = '<?xml version="1.0" encoding="ISO-8859-1"?>' + urdf(name="épaule")
    assert load_arm(arm_file(text.encode("iso-8859-1"))).joint_names == ("épaule",)
    for declared in ("", '<?xml version="1.0" encoding="UTF-8"?>'):
        name = arm_file((declared + urdf(name="épaule")).encode())
        assert load_arm(name).joint_names == ("épaule",)
    name = arm_file('<?xml version="1.0" encoding="utf-7"?>' + urdf())
    with pytest.raises(ConfigurationError, match=r"own\.urdf: its encoding is utf-7; save it as"):
        load_arm(name)
    with pytest.raises(ConfigurationError, match=r"cannot read .*own\.urdf: line 1 is not UTF-8"):
        load_arm(arm_file(urdf(name="épaule").encode("iso-8859-1")))


def test_a_suffix_in_capitals(arm_file):
    assert load_arm(arm_file(urdf(), "OWN.URDF")).joint_names == ("j",)
    assert load_arm(arm_file(urdf(), "OWN.URDF", 'urdf = "OWN.URDF"')).joint_names == ("j",)


def test_the_urdf_may_be_in_a_package(arm_file):
    name = arm_file("", toml='urdf = "cardan:robots/ur5.urdf"\ntcp = "tool0"')
    assert load_arm(name).joint_names == load_arm("ur5").joint_names
    name = arm_file("", toml='urdf = "nobodys_arms:ur5.urdf"')
    with pytest.raises(ConfigurationError, match=r"own\.toml: .*no package 'nobodys_arms'"):
        load_arm(name)


@pytest.mark.parametrize(
    ("text", "toml", "at"),
    [
        (urdf(limit=' x=""').replace('velocity="3"', ""), 'urdf = "own.urdf"', "own.urdf"),
        (urdf(collision="<collision/>"), 'urdf = "own.urdf"', "own.urdf"),
        ("<robot", 'urdf = "own.urdf"', "own.urdf"),
        (urdf(), 'urdf = "own.urdf"\ntcp = "paw"', "own.toml"),
        (urdf(), 'urdf = "own.urdf"\nhome_deg = [400]', "own.toml"),
    ],
)
def test_the_file_that_is_wrong_is_named(arm_file, text, toml, at):
    with pytest.raises(ConfigurationError) as caught:
        load_arm(arm_file(text, toml=toml))
    (named,) = re.findall(r"own\.\w+", str(caught.value).partition(":")[0])
    assert named == at


def test_a_moment_of_zero_may_be_rounded():
    def arm(moment):
        inertia = f'<inertia ixx="{moment}" iyy="0.1" izz="0.1"/>'
        body = f'<inertial><mass value="1"/>{inertia}</inertial>'
        return parse_urdf(
            urdf(links="").replace('<link name="c"/>', f'<link name="c">{body}</link>')
        )

    assert arm("-5.42e-20").inertias[0].mass_kg == 1.0
    with pytest.raises(ConfigurationError, match="negative ixx, iyy or izz"):
        arm("-1e-6")


# -- Versions ---------------------------------------------------------------------------------


HALF = math.sqrt(0.5)
TURNED = f'<origin xyz="0 0 1" quat_xyzw="0 {HALF} 0 {HALF}"/>'


def test_version_1_1_has_quaternions():
    tcp = parse_urdf(urdf(origin=TURNED, attributes=' version="1.1"')).tcp
    assert tcp.orientation == pytest.approx((HALF, 0, HALF, 0))
    assert tcp.position == (0.0, 0.0, 1.0)


def test_version_1_1_has_capsules():
    body = '<collision><geometry><capsule radius="0.1" length="0.4"/></geometry></collision>'
    arm = parse_urdf(urdf(collision=body, attributes=' version="1.1"'))
    (shape,) = arm.shapes
    assert shape.shape == ((0.0, 0.0, -0.2), (0.0, 0.0, 0.2), 0.1)


def test_version_1_2_has_accelerations():
    def acceleration(limit):
        text = urdf(limit=limit, attributes=' version="1.2"')
        (value,) = limits_in(text, ["j"]).acceleration
        assert parse_urdf(text).joints[0].acceleration == value
        return value

    assert acceleration(' acceleration="1"') == 1.0
    assert acceleration(' acceleration="4" deceleration="2" jerk="100"') == 2.0
    assert acceleration(' acceleration="4" deceleration="20"') == 4.0
    assert acceleration(' acceleration="0"') == 15.0
    assert acceleration("") == 15.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (urdf(attributes=' version="9.9"'), "is of version '9.9'; allowed: 1.0, 1.1, 1.2"),
        (urdf(origin=TURNED), "origin of joint 'weld': quat_xyzw is for version=\"1.1\""),
        (
            urdf(origin=TURNED.replace("xyz=", 'rpy="0 0 0" xyz=', 1), attributes=' version="1.1"'),
            "origin of joint 'weld': quat_xyzw is for .* without an rpy",
        ),
        (
            urdf(origin='<origin quat_xyzw="nonsense"/>', attributes=' version="1.1"'),
            "quat_xyzw of the origin of joint 'weld': 'nonsense' is not four numbers",
        ),
        (
            urdf(origin='<origin quat_xyzw="0 0 0 0"/>', attributes=' version="1.1"'),
            "'0 0 0 0' has not the length 1",
        ),
        (urdf(limit=' acceleration="x"'), "limits of joint 'j': acceleration 'x' is not a number"),
        (urdf(limit=' deceleration="-1"'), "limits of joint 'j': deceleration -1 is below 0"),
        (urdf(limit=' acceleration="1_0"'), "acceleration '1_0' is not a number"),
        (urdf(origin='<origin xyz="0 1_0 0"/>'), "'0 1_0 0' is not three numbers"),
        (urdf(limit=' acceleration="nan"'), "acceleration nan is not a number of at most"),
        (urdf(head="<xacro:arm/>"), "has <xacro:arm>: expand it first, by `xacro FILE > arm.urdf`"),
        (urdf(links='<link name="d"/>'), r"links \['d'\] are not joined"),
        (urdf(name="weld"), r"every joint has a name of its own, not \['weld', 'weld'\]"),
        (
            urdf().replace('type="fixed"', 'type="ball"'),
            "joint 'weld' is 'ball'; allowed: fixed, revolute, continuous, prismatic",
        ),
        (
            urdf().replace('type="fixed"', 'type="planar"'),
            "joint 'weld' is 'planar'; allowed: fixed",
        ),
    ],
)
def test_what_others_refuse_is_refused(text, words):
    with pytest.raises(ConfigurationError, match=words):
        parse_urdf(text)


# -- Malicious files --------------------------------------------------------------------------


def chain(count):
    """Return a chain of fixed joints at the end of an arm."""
    links = "".join(f'<link name="l{i}"/>' for i in range(count))
    joints = "".join(
        f'<joint name="k{i}" type="fixed"><parent link="{f"l{i - 1}" if i else "c"}"/>'
        f'<child link="l{i}"/><origin xyz="0 0 0.001" rpy="0.1 0 0"/></joint>'
        for i in range(count)
    )
    return urdf(links=links + joints)


def followers(count):
    joints = "".join(
        f'<joint name="k{i}" type="prismatic"><parent link="a"/><child link="l{i}"/>'
        f'<mimic joint="k{i - 1}" multiplier="1e5"/></joint>'
        for i in range(count)
    )
    return urdf(links="".join(f'<link name="l{i}"/>' for i in range(count)) + joints)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '<!DOCTYPE r [<!ENTITY a0 "ha">]><robot name="&a0;"/>',
            "declares the entity 'a0': write what it stands for",
        ),
        ("<robot>" + "<a>" * 150, "has elements in more than 100 others"),
        (urdf(head="<a>" * 150 + "</a>" * 150), "has elements in more than 100 others"),
        (urdf(head="<a>" * 99 + "</a>" * 99, limit=' acceleration="x"'), "acceleration 'x' is not"),
        ("<robot " + " ".join(f'a{i}=""' for i in range(300)) + "/>", "one base link"),
        (chain(MOST_LINKS), f"{MOST_LINKS + 3} links are more than {MOST_LINKS}"),
        (urdf(origin='<origin xyz="1e308 0 0"/>'), "'1e308 0 0' is not three numbers"),
        (urdf(limit=' acceleration="1e308"'), "acceleration 1e[+]308 is not a number of at most"),
        (followers(20), "tcp: link 'a' branches"),
    ],
)
def test_a_hostile_file_ends_in_one_error_soon(text, words):
    start = time.thread_time()
    with pytest.raises(ConfigurationError, match=words):
        parse_urdf(text)
    assert time.thread_time() - start < 5.0


def test_joints_that_mimic_without_end(arm_file):
    def load(text):
        return load_arm(arm_file(text, toml='urdf = "own.urdf"\ntcp = "c"'))

    multiplied = followers(20).replace('joint="k-1"', 'joint="j"')
    with pytest.raises(ConfigurationError, match=r"mimic of joint 'k.': it turns 1e[+]10 times"):
        load(multiplied)
    # Held joints have a position even if the joint that they mimic is missing.
    for lost in (followers(1), followers(2).replace('joint="k-1"', 'joint="k1"')):
        assert load(lost).joint_names == ("j",)


def test_the_longest_chain_is_read():
    assert len(parse_urdf(chain(MOST_LINKS - 3)).joints) == 1


# -- Files of ours ----------------------------------------------------------------------------


def published():
    """Return every URDF in documentation, examples and the package."""
    for path in sorted(ROOT.glob("cardan/robots/*.urdf")):
        names = load_arm(path.stem).joint_names
        yield pytest.param(path.read_text(encoding="utf-8"), names, id=path.stem)
    texts = [
        (path.stem, path.read_text(encoding="utf-8"))
        for path in sorted(ROOT.glob("examples/**/*.urdf"))
    ]
    for path in sorted(ROOT.glob("docs/**/*.md")):
        text = path.read_text(encoding="utf-8")
        blocks = re.findall(r"```xml\n(.*?)```", text, re.DOTALL)
        texts += [(f"{path.stem}-page", block) for block in blocks if "<robot" in block]
    for name, text in texts:
        yield pytest.param(text, parse_urdf(text).joint_names, id=name)


@pytest.mark.parametrize(("text", "names"), list(published()))
def test_every_urdf_of_ours_is_read_by_other_programs(text, names, capfd):
    """urdfdom reports skipped elements on stderr, and continues."""
    model = pin.buildModelFromXML(text)
    pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
    assert capfd.readouterr().err == ""
    assert [name for name in model.names if name != "universe"] == list(names)
