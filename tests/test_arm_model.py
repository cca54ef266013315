"""Arm models as data."""

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cardan.arm_model import arm_names, load_arm, parse_urdf
from cardan.errors import ConfigurationError


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


def urdf(*joints):
    return f'<robot name="r">{"".join(joints)}</robot>'


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


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("<robot", "not XML"),
        (urdf(joint(), joint("k", b="other")), "branches"),
        (urdf(joint(), joint("k", a="x", b="y")), "one base link"),
        (urdf(joint(limit="")), "no <limit>"),
        (urdf(joint(limit='<limit lower="a" upper="2" velocity="3"/>')), "'j'"),
        (urdf('<joint name="j" type="revolute"/>'), "lacks its parent"),
    ],
)
def test_errors_say_what_is_wrong(text, words):
    with pytest.raises(ConfigurationError, match=words):
        parse_urdf(text)


@given(st.text(max_size=80) | st.text('<>/ robotjinlkmefprchd="01-.', max_size=120))
def test_any_text_is_an_arm_or_an_error(text):
    with contextlib.suppress(ConfigurationError):
        parse_urdf(text)
