"""``cardan robots``: generation of an arm's file from a vendor's URDF, for users."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pytest

from cardan.bus import description
from cardan.bus.description import Description
from cardan.bus.options import BusOptions
from cardan.errors import ConfigurationError
from cardan.gateway.session.cautions import arm_cautions
from cardan.own_arm import pictures, tried
from cardan.own_arm.added import add, parse_limits
from cardan.own_arm.ends import ends_of
from cardan.robots import arm_names, load_arm
from cardan.robots.urdf import read_tree
from tests.command_line import the_command_line

LIMIT = '<limit lower="-2" upper="2.5" velocity="1.5" effort="80"/>'


def joint(name, parent, child, axis="0 1 0", limit=LIMIT, kind="revolute", xyz="0 0 0.3"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def link(name):
    return (
        f'<link name="{name}"><collision><origin xyz="0 0 0.12"/><geometry>'
        '<cylinder radius="0.03" length="0.1"/></geometry></collision></link>'
    )


GRIPPER = '<limit lower="0" upper="0.04" velocity="0.1" effort="20"/>'


def robot(slow=LIMIT):
    """Robot of six joints, with a tool frame between two fingers, and a camera on the base."""
    chain = "".join(
        link(f"l{number}")
        + joint(
            f"j{number}",
            f"l{number - 1}" if number > 1 else "base_link",
            f"l{number}",
            ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")[number - 1],
            slow if number == 2 else LIMIT,
        )
        for number in range(1, 7)
    )
    return (
        '<robot name="vendor"><link name="base_link"/><link name="camera"/><link name="tool0"/>'
        '<link name="finger_a"/><link name="finger_b"/>'
        + chain
        + joint("eye", "base_link", "camera", limit="", kind="fixed")
        + joint("tool", "l6", "tool0", limit="", kind="fixed", xyz="0 0 0.1")
        + joint("grip", "l6", "finger_a", limit=GRIPPER, kind="prismatic")
        + joint(
            "grip_too", "l6", "finger_b", limit=f'{GRIPPER}<mimic joint="grip"/>', kind="prismatic"
        )
        + "</robot>"
    )


draw = pictures.draw


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tried, "POSES", 100)
    # Skips the drawing, which takes most of the command's time.
    monkeypatch.setattr(pictures, "draw", lambda _arm, _poses, picture: picture.touch())
    load_arm.cache_clear()
    Path("vendor.urdf").write_text(robot(), encoding="utf-8")
    return tmp_path


def cardan(capsys, *words):
    """Run the command; return its output."""
    the_command_line()(list(words), standalone_mode=False)
    return capsys.readouterr().out


def test_where_the_tree_has_several_ends_the_likely_ones_are_listed(here, capsys):
    with pytest.raises(ConfigurationError) as raised:
        cardan(capsys, "robots", "add", "vendor.urdf")
    lines = [line for line in str(raised.value).splitlines() if line.startswith("--tcp ")]
    assert lines == [
        "--tcp tool0  # 6 joints move: j1, j2, j3, j4, j5, j6",
        "--tcp finger_a  # 7 joints move: j1, j2, j3, j4, j5, j6, grip; of a finger: grip",
    ]
    assert not Path("vendor.toml").exists()


def test_names_of_tools_are_known_and_an_arm_may_have_so_many_joints_only():
    def named(name):
        tree = read_tree(
            f'<robot name="r"><link name="b"/><link name="x"/><link name="{name}"/>'
            f"{joint('a', 'b', 'x')}{joint('c', 'b', name)}</robot>"
        )
        return ends_of(tree)[0].link

    for name in ("tool0", "panda_hand_tcp", "ee_link", "gripper_grasping_frame", "left/tool"):
        assert named(name) == name
    assert named("knee") == "x"


def with_gripper(*more):
    """Links and joints of an arm of two joints and a gripper."""
    return (
        '<robot name="r"><link name="b"/><link name="palm"/><link name="mover"/>'
        f"{link('x')}{link('y')}{joint('a', 'b', 'x', '0 0 1')}{joint('c', 'x', 'y')}"
        f"{joint('fix', 'y', 'palm', limit='', kind='fixed')}{''.join(more)}</robot>"
    )


HALF_TURN = '<limit lower="-1.57" upper="0" velocity="3" effort="30"/>'
WRIST = '<limit lower="-2.8" upper="2.8" velocity="3" effort="30"/>'


def test_the_only_end_is_before_the_finger_which_is_held(here, capsys):
    text = with_gripper(joint("jointGripper", "palm", "mover", limit=HALF_TURN))
    Path("z.urdf").write_text(text, encoding="utf-8")
    printed = cardan(capsys, "robots", "add", "z.urdf")
    assert load_arm("z.toml").joint_names == ("a", "c")
    assert 'tcp = "palm"' in Path("z.toml").read_text(encoding="utf-8")
    assert "tcp      the link before jointGripper, which moves a finger and is held" in printed
    cardan(capsys, "robots", "add", "z.urdf", "--tcp", "mover", "--overwrite")
    assert load_arm("z.toml").joint_names == ("a", "c", "jointGripper")


@pytest.mark.parametrize(
    ("name", "limit", "kind", "is_finger"),
    [
        ("gripper", GRIPPER, "prismatic", True),
        ("left_jaw", WRIST, "revolute", True),
        ("gripper_roll", WRIST, "revolute", False),
        ("gripper_spin", '<limit velocity="3" effort="30"/>', "continuous", False),
        ("wrist", HALF_TURN, "revolute", False),
    ],
)
def test_a_finger_is_known_by_its_name_and_a_short_travel(here, name, limit, kind, is_finger):
    text = with_gripper(joint(name, "palm", "mover", limit=limit, kind=kind))
    Path("z.urdf").write_text(text, encoding="utf-8")
    added = add("z.urdf", Path("z.toml"))
    assert added.fingers == ((name,) if is_finger else ())
    assert (name in added.arm.joint_names) is not is_finger


def test_a_hand_without_an_arm_is_an_arm(here):
    text = f'<robot name="r">{link("b")}{link("f")}{link("tip")}'
    text += f"{joint('finger_1', 'b', 'f')}{joint('finger_2', 'f', 'tip')}</robot>"
    Path("z.urdf").write_text(text, encoding="utf-8")
    assert add("z.urdf", Path("z.toml")).arm.joint_names == ("finger_1", "finger_2")


def test_the_link_before_the_fingers_is_proposed_first(here):
    fingers = '<link name="left_gripper_finger_tip"/><link name="right_finger"/>'
    text = with_gripper(
        fingers,
        joint("g1", "palm", "left_gripper_finger_tip", limit=GRIPPER, kind="prismatic"),
        joint("g2", "palm", "right_finger", limit=GRIPPER, kind="prismatic"),
        joint("end", "x", "mover", limit="", kind="fixed"),
    )
    ends = ends_of(read_tree(text))
    assert [(end.link, end.fingers) for end in ends] == [
        ("palm", ()),
        ("mover", ()),
        ("left_gripper_finger_tip", ("g1",)),
        ("right_finger", ("g2",)),
    ]


@pytest.mark.parametrize(
    ("limit", "xyz", "kind", "words"),
    [
        ('<limit lower="-170" upper="170" velocity="2" effort="9"/>', "0 0 1", "revolute", "degr"),
        (LIMIT, "0 0 580", "revolute", "millimeters"),
        ('<limit lower="0" upper="500" velocity="2" effort="9"/>', "0 0 1", "prismatic", "millim"),
        ('<limit lower="-15.8" upper="15.8" velocity="2" effort="9"/>', "0 0 1", "revolute", ""),
        (LIMIT, "0 0 3", "revolute", ""),
    ],
)
def test_numbers_in_other_units_are_a_warning(here, capsys, limit, xyz, kind, words):
    text = f'<robot name="r">{link("b")}{link("x")}{link("y")}{joint("a", "b", "x", "0 0 1")}'
    text += f"{joint('c', 'x', 'y', limit=limit, kind=kind, xyz=xyz)}</robot>"
    Path("z.urdf").write_text(text, encoding="utf-8")
    for command in (("add", "z.urdf"), ("show", "z.toml")):
        said = [
            line
            for line in cardan(capsys, "robots", *command).splitlines()
            if "WARNING" in line and "are these" in line
        ]
        assert len(said) == bool(words)
        assert not said or words in said[0]


def test_the_arms_of_this_package_have_no_numbers_in_other_units():
    for name in arm_names():
        assert not [each for each in arm_cautions(load_arm(name)) if "are these" in each]


def test_it_writes_the_arm_s_file_and_what_it_prints_can_be_run(here, capsys, monkeypatch):
    monkeypatch.setattr(pictures, "draw", draw)
    printed = cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0")
    arm = load_arm("vendor.toml")
    assert arm.joint_names == ("j1", "j2", "j3", "j4", "j5", "j6")
    assert "limits   of the URDF" in printed
    assert re.search(r"inverse  found for \d+ of 100 reachable poses", printed)
    assert Path("vendor.png").read_bytes().startswith(b"\x89PNG")
    session = printed.partition("save as vendor-session.toml:\n")[2].partition("and run it")[0]
    Path("vendor-session.toml").write_text(session, encoding="utf-8")
    assert printed.endswith("cardan run vendor-session.toml --console\n")
    assert cardan(capsys, "check", "vendor-session.toml").startswith("vendor-session.toml: fine")


def test_the_file_has_the_home_that_was_chosen(here):
    added = add("vendor.urdf", Path("vendor.toml"), "tool0")
    arm = added.write()
    assert arm.home == pytest.approx(added.arm.home, abs=1e-9)
    assert arm.shapes == added.arm.shapes
    assert "home_deg = [" in added.text


def test_an_arm_of_too_few_joints_keeps_the_position_first(here, capsys):
    printed = cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "l5")
    assert "task     5 joints cannot keep an orientation along every line" in printed
    assert load_arm("vendor.toml").task.weights == (1.0, 1.0, 1.0, 0.05, 0.05, 0.05)
    printed = cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0", "--overwrite")
    assert "task" not in printed
    assert load_arm("vendor.toml").task.weights == (1.0,) * 6


def test_missing_limits_are_proposed_in_the_file_and_marked(here, capsys):
    Path("vendor.urdf").write_text(
        robot('<limit lower="-2" upper="2" velocity="0" effort="1"/>'), encoding="utf-8"
    )
    printed = cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0")
    assert "limits   missing of j2; PROPOSED" in printed
    text = Path("vendor.toml").read_text(encoding="utf-8")
    assert "# PROPOSED" in text
    assert "[velocity_deg_s]\nj2 = 10.0 # deg/s; the URDF: velocity 0" in text


def test_limits_are_given_on_the_command_line(here, capsys):
    Path("vendor.urdf").write_text(robot('<limit velocity="0" effort="1"/>'), encoding="utf-8")
    limits = ("lower_deg.j2=-90", "upper_deg.j2=80", "velocity_deg_s.j1=20")
    words = [word for limit in limits for word in ("--limit", limit)]
    printed = cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0", *words)
    assert "limits   missing of j2; PROPOSED" in printed
    assert "limits   given of j1, j2" in printed
    text = Path("vendor.toml").read_text(encoding="utf-8")
    assert "[velocity_deg_s]\nj1 = 20.0\nj2 = 10.0 # deg/s; the URDF: velocity 0\n" in text
    assert "[lower_deg]\nj2 = -90.0\n" in text
    joints = load_arm("vendor.toml").joints
    assert joints[0].velocity == pytest.approx(math.radians(20.0))
    assert joints[1].lower == pytest.approx(math.radians(-90.0))

    limits = (*words, "--limit", "velocity_deg_s.j2=30", "--overwrite")
    printed = cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0", *limits)
    assert "PROPOSED" not in printed + Path("vendor.toml").read_text(encoding="utf-8")
    assert load_arm("vendor.toml").joints[1].velocity == pytest.approx(math.radians(30.0))


def test_limits_of_joints_are_distinguished_by_the_last_sign():
    assert parse_limits(["effort.left/a.b=c=3"]) == {"effort": {"left/a.b=c": 3.0}}


def test_links_without_a_body_and_missing_meshes_are_said(here, capsys):
    mesh = '<cylinder radius="0.03" length="0.1"/>'
    text = robot().replace(mesh, '<mesh filename="package://gone/l1.stl"/>', 1)
    Path("vendor.urdf").write_text(text, encoding="utf-8")
    printed = cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0")
    assert "WARNING" in printed
    assert "links have no body: l1" in printed
    assert "package://gone/l1.stl" in printed
    assert '# link = "l1"' in Path("vendor.toml").read_text(encoding="utf-8")


def test_how_much_too_large_the_cover_of_a_mesh_is_stands_there(here, capsys):
    corners = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.2)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 2 3", "f 4 5 6", "f 6 7 8"]
    Path("l1.obj").write_text("\n".join(lines), encoding="utf-8")
    text = robot().replace('<cylinder radius="0.03" length="0.1"/>', '<mesh filename="l1.obj"/>', 1)
    Path("vendor.urdf").write_text(text, encoding="utf-8")
    printed = cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0")
    assert re.search(r"mesh +of l1 is covered by 1 shapes, \d+ % larger", printed)


def test_nothing_is_written_over_without_being_reported(here, capsys):
    Path("vendor.toml").write_text("mine", encoding="utf-8")
    words = ("robots", "add", "vendor.urdf", "--tcp", "tool0")
    with pytest.raises(ConfigurationError, match=r"--overwrite: vendor\.toml exists"):
        cardan(capsys, *words)
    assert Path("vendor.toml").read_text(encoding="utf-8") == "mine"
    cardan(capsys, *words, "--overwrite")
    assert load_arm("vendor.toml").joint_names[0] == "j1"


@pytest.mark.parametrize("output", ["vendor.urdf", "mine.urdf", "mine.png", "mine"])
@pytest.mark.parametrize("more", [(), ("--overwrite",)])
def test_a_file_that_is_to_be_written_ends_in_toml(here, capsys, output, more):
    words = ("robots", "add", "vendor.urdf", "--tcp", "tool0", "-o", output, *more)
    with pytest.raises(ConfigurationError, match=f"^--output: {output} must end in .toml$"):
        cardan(capsys, *words)
    assert Path("vendor.urdf").read_text(encoding="utf-8") == robot()
    assert [path.name for path in here.iterdir()] == ["vendor.urdf"]


def test_what_is_no_description_is_said_before_what_is_in_the_way(here, capsys):
    Path("mine.toml").write_text("mine", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"^FILE: mine\.toml must be a \.urdf, \.xacro or"):
        cardan(capsys, "robots", "add", "mine.toml")


def test_the_session_beside_an_arm_elsewhere_is_one(here, capsys):
    Path("arms").mkdir()
    printed = cardan(
        capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0", "-o", "arms/mine.toml"
    )
    session = printed.partition("save as arms/mine-session.toml:\n")[2].partition("and run it")[0]
    Path("arms/mine-session.toml").write_text(session, encoding="utf-8")
    said = cardan(capsys, "check", "arms/mine-session.toml")
    assert said.startswith("arms/mine-session.toml: fine")


def test_a_limit_is_given_once():
    with pytest.raises(ConfigurationError, match=r"^--limit: 'effort\.j1' is given twice$"):
        parse_limits(["effort.j1=3", "effort.j1=4"])


def test_the_file_may_stand_elsewhere(here):
    Path("arms").mkdir()
    added = add("vendor.urdf", Path("arms/mine.toml"), "tool0")
    assert 'urdf = "../vendor.urdf"' in added.text
    assert added.write().joint_names[0] == "j1"


def test_names_add_no_lines_to_the_file(here):
    name = "j1&#10;[collision]&#10;meshes = 1 #"
    Path("vendor.urdf").write_text(robot().replace('"j1"', f'"{name}"'), encoding="utf-8")
    added = add("vendor.urdf", Path("vendor.toml"), "tool0")
    assert added.write().joint_names[0] == name.replace("&#10;", "\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("vendor.urdf", "--tcp", "hook"), "--tcp: there is no link 'hook'"),
        (("vendor.urdf", "--tcp", "tool0", "--base", "hook"), "--base: there is no link 'hook'"),
        (("nothing.urdf",), "cannot read nothing.urdf"),
        (("vendor.sdf",), "FILE: vendor.sdf must be a .urdf, .xacro or .xml (MJCF)"),
        (
            ("vendor.urdf", "--tcp", "tool0", "--limit", "velocity_deg_s.hook=1"),
            "--limit: velocity_deg_s.hook: the arm has no moving joint 'hook'",
        ),
        (
            ("vendor.urdf", "--tcp", "tool0", "--limit", "velocity_deg_s.j2=-1"),
            "--limit: velocity_deg_s",
        ),
        (("vendor.urdf", "--limit", "speed.j2=1"), "--limit: 'speed.j2=1' must be KEY.JOINT="),
        (("panda",), "FILE: panda comes with Cardan: `cardan robots show panda` shows it, and"),
        (
            ("vendor.urdf", "--limit", "x=1,5"),
            "--limit: 'x=1,5' must be KEY.JOINT=NUMBER, as velocity_deg_s.elbow=90; write the "
            "decimal point as ., not as a comma; KEY is one of velocity_deg_s",
        ),
        (
            ("vendor.urdf", "--limit", "=-1"),
            "--limit: '=-1' must be KEY.JOINT=NUMBER, as velocity_deg_s.elbow=90; KEY is one of",
        ),
        (("vendor.urdf", "--limit", "effort.j2=nan"), "--limit: 'effort.j2=nan' must be KEY."),
        (("vendor.urdf", "--xacro", "prefix"), "--xacro: 'prefix' must be NAME=VALUE"),
        (("vendor.urdf", "--xacro", "a=b"), "--xacro: xacro: vendor.urdf takes no arguments"),
    ],
)
def test_what_is_wrong_is_said_of_the_option(here, capsys, words, said):
    with pytest.raises(ConfigurationError, match=re.escape(said)):
        cardan(capsys, "robots", "add", *words)


class Bus:
    """Stand-in for a bus on which `text` is published; it records requests."""

    def __init__(self, text) -> None:
        self.text, self.asked = text, []

    def describe(self, topic, options):
        self.asked.append((topic, options))
        return Description(self.text, f"{topic} of /rsp, by the router {options.router}")


@pytest.fixture
def bus(here, monkeypatch):
    bus = Bus(robot())
    monkeypatch.setattr(description, "describe", bus.describe)
    return bus


ROUTER = "tcp/127.0.0.1:7999"
ADD_TOPIC = ("robots", "add", "--from-topic", "--router", ROUTER, "--tcp", "tool0")


def test_a_description_on_the_bus_is_kept_as_a_file_and_then_as_any_file(bus, capsys):
    printed = cardan(capsys, *ADD_TOPIC)
    assert bus.asked == [("/robot_description", BusOptions(router=ROUTER))]
    assert Path("robot_description.urdf").read_text(encoding="utf-8") == robot()
    text = Path("robot_description.toml").read_text(encoding="utf-8")
    assert 'urdf = "robot_description.urdf"' in text
    origin = f"/robot_description of /rsp, by the router {ROUTER}"
    assert f"# That file is the text of {origin}." in text
    assert f"URDF     of {origin}; kept as robot_description.urdf" in printed
    assert Path("robot_description.png").exists()
    assert load_arm("robot_description.toml").home == load_arm_of_file(capsys).home
    assert printed.endswith("cardan run robot_description-session.toml --console\n")


def load_arm_of_file(capsys):
    """Return the same arm, added from its file."""
    cardan(capsys, "robots", "add", "vendor.urdf", "--tcp", "tool0")
    return load_arm("vendor.toml")


def test_a_topic_may_be_named_and_two_arms_have_a_file_each(bus, capsys):
    for arm in ("left", "right"):
        cardan(capsys, *ADD_TOPIC, f"/{arm}/robot_description", "-o", f"{arm}.toml")
        cardan(capsys, *ADD_TOPIC, "-o", f"{arm}_too.toml")
    assert [topic for topic, _ in bus.asked[::2]] == [
        "/left/robot_description",
        "/right/robot_description",
    ]
    assert sorted(each.name for each in Path().glob("*.urdf")) == [
        "left-left_robot_description.urdf",
        "left_too-robot_description.urdf",
        "right-right_robot_description.urdf",
        "right_too-robot_description.urdf",
        "vendor.urdf",
    ]


def test_a_description_that_was_kept_is_not_written_over_either(bus, capsys):
    Path("robot_description.urdf").write_text("mine", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"--overwrite: robot_description\.urdf exists"):
        cardan(capsys, *ADD_TOPIC)
    assert bus.asked == []


def test_what_is_no_urdf_is_said_of_the_topic_and_nothing_is_kept(bus, capsys):
    bus.text = "<sdf/>"
    with pytest.raises(ConfigurationError, match=r"^/robot_description: .*<robot>"):
        cardan(capsys, *ADD_TOPIC)
    bus.text = robot()
    with pytest.raises(ConfigurationError, match="--tcp tool0"):
        cardan(capsys, "robots", "add", "--from-topic")
    assert [each.name for each in Path().iterdir()] == ["vendor.urdf"]


def test_meshes_of_a_description_on_the_bus_are_looked_for_as_of_a_file(bus, capsys, monkeypatch):
    mesh = '<cylinder radius="0.03" length="0.1"/>'
    bus.text = robot().replace(mesh, '<mesh filename="package://vendor_arm/l1.obj"/>', 1)
    assert "package://vendor_arm/l1.obj" in cardan(capsys, *ADD_TOPIC)
    folder = Path("install/share/vendor_arm")
    folder.mkdir(parents=True)
    corners = [(x, y, z) for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.2)]
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + ["f 1 2 3", "f 4 5 6", "f 6 7 8"]
    (folder / "l1.obj").write_text("\n".join(lines), encoding="utf-8")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(Path("install").absolute()))
    assert "of l1 is covered by 1 shapes" in cardan(capsys, *ADD_TOPIC, "--overwrite")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "FILE: give a URDF, or --from-topic"),
        (("vendor.urdf", "--router", ROUTER), "--session, --router: go with --from-topic"),
        (("vendor.urdf", "--from-topic"), "--from-topic: takes a topic in FILE's place"),
    ],
)
def test_a_file_or_a_topic_is_asked_for(here, capsys, words, said):
    with pytest.raises(ConfigurationError, match=re.escape(said)):
        cardan(capsys, "robots", "add", *words)


def test_the_arms_that_are_there_are_listed(here, capsys):
    Path("mine.toml").write_text('urdf = "vendor.urdf"\ntcp = "tool0"', encoding="utf-8")
    Path("session.toml").write_text('[robot]\ndriver = "sim_arm"', encoding="utf-8")
    rows = json.loads(cardan(capsys, "robots", "list", "--json"))
    assert [row["arm"] for row in rows] == [*arm_names(), "mine.toml"]


def test_an_arm_is_shown(here, capsys):
    printed = cardan(capsys, "robots", "show", "ur5")
    assert "shoulder_pan_joint" in printed
    assert "reach    x -" in printed
    shown = json.loads(cardan(capsys, "robots", "show", "ur5", "--json"))
    assert [each["name"] for each in shown["joints"]] == list(load_arm("ur5").joint_names)
    assert shown["cautions"] == []


def test_the_view_has_the_base_the_joints_and_the_tcp():
    arm = load_arm("ur5")
    lines = pictures.side_views(arm, [pictures.posed(arm, arm.home, "home")])
    text = "\n".join(lines[:-1])
    assert text.startswith("home")
    assert text.count("X") == 1
    assert "o" in text
    assert max(map(len, lines)) < 80


def test_postures_are_free_and_inverse_solutions_are_right():
    arm = load_arm("gofa_crb15000_5")
    assert len(tried.postures(arm)) == 3
    found = tried.try_inverse(arm, poses=50)
    assert found.tried == 50
    assert found.found >= 49
    assert found.outside == 0


def test_the_tries_end_in_time():
    arm = load_arm("ur5")
    assert tried.try_inverse(arm, longest_s=0.0).tried == 0
    assert "took too long" in tried.try_inverse(arm, longest_s=0.0).words()
