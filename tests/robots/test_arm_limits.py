"""Limits that a URDF lacks: a single error requests them all, and the arm's file provides them."""

import math
import re
from xml.sax.saxutils import quoteattr

import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from cardan.common.tables import parse_toml, read_table
from cardan.errors import ConfigurationError
from cardan.robots import limits_in, load_arm, parse_urdf
from cardan.robots.arm_file import ArmFile
from cardan.robots.arm_reader import build_arm
from cardan.robots.urdf import read_tree

GOOD = '<limit lower="-1" upper="2" velocity="3" effort="5"/>'


def joint(name, limit, kind="revolute", more=""):
    return name, kind, limit, more


def chain(*joints):
    text = '<link name="l0"/>'
    for number, (name, kind, limit, more) in enumerate(joints):
        text += (
            f'<link name="l{number + 1}"/><joint name={quoteattr(name)} type="{kind}">'
            f'<parent link="l{number}"/><child link="l{number + 1}"/>'
            f'<axis xyz="0 0 1"/>{limit}{more}</joint>'
        )
    return f'<robot name="r">{text}</robot>'


@pytest.fixture
def load(tmp_path):
    def loaded(urdf, toml=""):
        (tmp_path / "own.urdf").write_text(urdf, encoding="utf-8")
        path = tmp_path / "own.toml"
        path.write_text(f'urdf = "own.urdf"\n{toml}', encoding="utf-8")
        load_arm.cache_clear()
        return load_arm(str(path))

    return loaded


def asked(load, urdf, toml=""):
    """Return the error's text, and its lines to paste."""
    with pytest.raises(ConfigurationError) as caught:
        load(urdf, toml)
    said = str(caught.value)
    assert "own.urdf: limits are missing: " in said
    head, _, lines = said.partition("\n")
    return head, lines


POOR = chain(
    joint("turn", "", "continuous"),
    joint("lift", '<limit velocity="0" effort="0"/>', "prismatic"),
    joint("left/elbow", '<limit lower="-1e16" upper="1e16" velocity="1e9" effort="4"/>'),
    joint("good", GOOD),
    joint('"odd" é', '<limit lower="-1" velocity="31"/>'),
)


def test_all_that_is_missing_is_asked_for_at_once(load):
    head, lines = asked(load, POOR)
    for words in (
        "velocity of 'turn', 'lift', 'left/elbow', '\"odd\" é'; lower of 'lift', 'left/elbow'; ",
        "; upper of 'lift', 'left/elbow', '\"odd\" é': put ",
        "at the end of the arm's .toml",
    ):
        assert words in head
    assert "good" not in head + lines
    for words in ("velocity 1e+09", "no lower", "lower -1e+16", "velocity 31", "no upper"):
        assert words in lines
    assert lines.endswith("""no limit, of 'turn', 'lift', '"odd" é'""")


def test_what_is_proposed_is_taken_and_careful(load):
    arm = load(POOR, asked(load, POOR)[1])
    turn, lift, elbow, good, odd = arm.joints
    assert (lift.velocity, lift.lower, lift.upper) == (0.05, -0.05, 0.05)
    assert turn.velocity == elbow.velocity == odd.velocity == math.radians(10)
    assert (elbow.lower, elbow.upper) == (math.radians(-45), math.radians(45))
    assert turn.lower == -math.inf
    assert (odd.lower, odd.upper) == (-1.0, 0.0)  # default of the specification: 0
    assert (good.lower, good.upper, good.velocity, good.effort) == (-1.0, 2.0, 3.0, 5.0)
    assert turn.effort == lift.effort == math.inf
    assert turn.acceleration == turn.velocity / 0.2


@pytest.mark.parametrize(
    ("limit", "kind", "missing"),
    [
        (GOOD, "revolute", ""),
        ("", "continuous", "velocity"),
        ('<limit velocity="3"/>', "continuous", ""),
        ("", "revolute", "velocity lower upper"),
        ('<limit lower="1" upper="1" velocity="3"/>', "revolute", "lower upper"),
        ('<limit lower="-1001" upper="1" velocity="3"/>', "revolute", "lower"),
        ('<limit lower="-1" upper="1" velocity="30.1"/>', "revolute", "velocity"),
        ('<limit lower="-1" upper="1" velocity="30"/>', "revolute", ""),
        ('<limit lower="-1" upper="1" velocity="10.1"/>', "prismatic", "velocity"),
        ('<limit lower="-1" upper="1" velocity="10"/>', "prismatic", ""),
        ('<limit lower="-1" upper="1" velocity="1" effort="0"/>', "prismatic", ""),
        # Soft limits count as limits.
        (
            '<limit velocity="3"/><safety_controller soft_lower_limit="-1" soft_upper_limit="1"/>',
            "revolute",
            "",
        ),
    ],
)
def test_what_counts_as_missing(load, limit, kind, missing):
    urdf = chain(joint("j", limit, kind))
    if missing:
        of_j = "; ".join(f"{field} of 'j'" for field in missing.split())
        assert f"missing: {of_j}: put" in asked(load, urdf)[0]
        words = ".*".join(missing.split())
        with pytest.raises(ConfigurationError, match=f"limits of joint 'j': .*{words}"):
            limits_in(urdf, ["j"])
    else:
        assert load(urdf).limits == limits_in(urdf, ["j"])


def test_a_published_description_lacks_all_its_limits_at_once():
    with pytest.raises(ConfigurationError, match=r"'turn': no velocity; .*'lift': velocity 0"):
        limits_in(POOR, ["turn", "lift", "good"])


def test_the_file_of_an_arm_counts_more_than_its_urdf(load):
    toml = """
velocity_deg_s = {a = 90, s = 0.2}
lower_deg.s = -0.1
upper_deg.a = 45
effort.a = 7
"""
    soft = '<safety_controller soft_upper_limit="0.5" k_velocity="1"/>'
    arm = load(chain(joint("a", GOOD, more=soft), joint("s", GOOD, "prismatic")), toml)
    a, s = arm.joints
    assert (a.velocity, a.lower, a.upper, a.effort) == (
        math.radians(90),
        -1.0,
        math.radians(45),
        7.0,
    )
    assert (s.velocity, s.lower, s.upper, s.effort) == (0.2, -0.1, 2.0, 5.0)
    # The description that a session publishes has them, too.
    assert limits_in(arm.urdf, arm.joint_names) == arm.limits
    model = pin.buildModelFromXML(arm.urdf)
    assert model.upperPositionLimit.tolist() == pytest.approx(arm.upper)
    assert model.effortLimit.tolist() == [7.0, 5.0]


def test_what_is_proposed_is_in_what_is_published(load):
    arm = load(POOR, asked(load, POOR)[1])
    assert limits_in(arm.urdf, arm.joint_names) == arm.limits


def test_a_name_of_several_lines_adds_none_to_what_is_proposed(load):
    name = "j\n[collision]\nmeshes = 'ignore'\n"
    urdf = chain(joint(name, ""))
    lines = asked(load, urdf)[1]
    assert "collision" not in parse_toml(lines, "own.toml")
    assert load(urdf, lines).joint_names == (name,)


def test_only_what_the_file_has_not_is_asked_for(load):
    head, lines = asked(load, POOR, "[velocity_deg_s]\nturn = 5")
    assert "turn" not in head
    assert "(where it has a table of them, into that)" in head
    assert lines.startswith("[velocity_deg_s]\n")


def test_an_arm_without_a_file_is_reported_one():
    with pytest.raises(
        ConfigurationError, match=re.escape('.toml, which begins with urdf = "FILE"')
    ):
        parse_urdf(POOR)


def test_only_the_arm_s_joints_need_limits(load):
    urdf = chain(joint("torso", "", "prismatic"), joint("a", GOOD), joint("finger", ""))
    assert load(urdf, 'tcp = "l2"\njoints = ["a"]').joint_names == ("a",)


@pytest.mark.parametrize(
    ("toml", "words"),
    [
        ("velocity_deg_s.b = 3", "velocity_deg_s.b: the arm has no .* 'b'; allowed: a, c"),
        ("effort.b = 3", "effort.b: the arm has no moving joint 'b'; allowed: a, c"),
        ("effort.A = 3", "effort.A: the arm has no moving joint 'A'; .*; did you mean 'a'"),
        ("velocity_deg_s.a = 0", "velocity_deg_s.*: .*must be above 0"),
        ("velocity_deg_s.a = 1720", "velocity_deg_s.a: 1720 is more than 1718.87"),
        ("upper_deg.a = 1e5", "upper_deg.a: 100000 is more than 57295.8"),
        ("upper_deg.a = -90", "upper_deg.a: lower -57.2958 and upper -90 are not a range"),
        ("lower_deg.a = nan", "lower_deg"),
        ("lower_deg.c = -90", "lower_deg.c: a continuous joint takes no range: leave it out"),
    ],
)
def test_errors_name_the_key(load, toml, words):
    urdf = chain(joint("a", GOOD), joint("c", '<limit velocity="1"/>', "continuous"))
    with pytest.raises(ConfigurationError, match=rf"own\.toml:\d+:\d+: {words}"):
        load(urdf, toml)


VALUES = st.none() | st.sampled_from(["0", "-1e16", "1e16", "inf", "-3", "2", "1e9", "1e-9"])
LIMITS = st.builds(
    lambda values: "<limit " + " ".join(f'{k}="{v}"' for k, v in values.items() if v) + "/>",
    st.fixed_dictionaries(dict.fromkeys(("lower", "upper", "velocity", "effort"), VALUES)),
)


@given(
    st.lists(
        st.tuples(LIMITS, st.sampled_from(["revolute", "continuous", "prismatic"])),
        min_size=1,
        max_size=3,
    )
)
def test_what_is_proposed_is_always_enough(limits):
    """An arm loads with the proposed lines."""
    urdf = chain(*(joint(f"j.{n}", *each) for n, each in enumerate(limits)))
    tree = read_tree(urdf)
    try:
        build_arm(tree, ArmFile(urdf="own.urdf"), {})
    except ConfigurationError as error:
        if "limits are missing" not in str(error):
            return
        lines = error.message.partition("\n")[2]
        file = read_table(ArmFile, parse_toml(f'urdf = "x"\n{lines}', "x.toml"))
        arm = build_arm(tree, file, {})
        assert arm.limits == limits_in(arm.urdf, arm.joint_names)
        assert all(low < high for low, high in zip(arm.lower, arm.upper, strict=True))
