"""Devices and arms made from a session's file or a driver; errors are raised before anything is
opened."""

import pytest

from cardan.drivers.spacemouse import SpaceMouse
from cardan.errors import ConfigurationError
from cardan.gateway.bus import remote as on_the_network
from cardan.gateway.session import remote as in_a_session
from cardan_learning.features import ActionKind
from cardan_learning.setup import make_arm, make_device

SESSION = """
[device]
driver = "spacemouse"

[robot]
driver = "sim_arm"
robot = "ur5"

[arm]
model = "ur5"

[mapping]
deadman = "left"
linear_speed_m_s = 0.05

[gripper]
toggle = "right"

"""


@pytest.fixture
def session(tmp_path):
    path = tmp_path / "session.toml"
    path.write_text(SESSION)
    return str(path)


@pytest.fixture
def asked(monkeypatch):
    """Arms made from a session's configuration, or from a network address."""
    made = []
    for module, name in ((in_a_session, "session_arm"), (on_the_network, "network_arm")):
        monkeypatch.setattr(module, name, lambda of, source: made.append(of))
    return made


def test_both_of_a_sessions_file(session, asked):
    device = make_device(session=session)
    assert isinstance(device.device, SpaceMouse)
    assert device.actions.kind is ActionKind.DELTA
    arm = make_arm(session=session, action="target")
    assert arm.joints[0] == "shoulder_pan_joint"
    assert (len(arm.joints), arm.kind) == (6, ActionKind.TARGET)
    assert arm.mapping.linear_speed_m_s == 0.05
    assert not arm.gripper  # A simulated arm has no outputs.
    arm.make()
    assert asked[0].device is None


def test_the_hand_reads_no_more_of_the_file_than_its_own(session, tmp_path):
    path = tmp_path / "other.toml"
    path.write_text('[device]\ndriver = "spacemouse"\n[robot]\ndriver = "nobody_has_it"\n')
    assert isinstance(make_device(session=str(path)).device, SpaceMouse)


def test_both_of_drivers(asked):
    device = make_device(
        driver="spacemouse",
        options={"curve": 0.5},
        mapping={"deadman": "left"},
        gripper={"toggle": "right"},
        action="target",
    )
    assert device.device.options.curve == 0.5
    arm = make_arm(
        driver="abb_egm",
        options={"listen_port": 6510},
        model="gofa_crb15000_5",
        mapping={"linear_speed_m_s": 0.2},
        limits={"linear_speed_m_s": 0.2},
    )
    assert arm.gripper
    assert arm.mapping.linear_speed_m_s == 0.2
    arm.make()
    assert asked[0].limits.linear_speed_m_s == 0.2


def test_an_arm_on_the_network(asked):
    arm = make_arm(address="tcp/127.0.0.1:7447/cell/arm", model="ur5", network_gripper=True)
    assert (len(arm.joints), arm.gripper) == (6, True)
    arm.make()
    assert asked == ["tcp/127.0.0.1:7447/cell/arm"]


DEVICE, ARM = make_device, make_arm


@pytest.mark.parametrize(
    ("make", "given", "why"),
    [
        (DEVICE, {}, "give either the file of a session, or a driver"),
        (DEVICE, {"session": "a.toml", "driver": "spacemouse"}, "give either"),
        (DEVICE, {"session": "none.toml"}, "cannot read none.toml"),
        (DEVICE, {"driver": "spacemouze"}, "there is no driver 'spacemouze'"),
        (DEVICE, {"driver": "spacemouse", "options": {"dead_zon": 1}}, "dead_zon"),
        (DEVICE, {"driver": "spacemouse", "mapping": {"deadmen": "left"}}, "mapping.deadmen"),
        (DEVICE, {"driver": "spacemouse", "action": "pose"}, "one of delta, target"),
        (DEVICE, {"driver": "sim_arm"}, "is not an operator device"),
        (DEVICE, {"driver": "leap"}, "mapping.mode"),
        (ARM, {"driver": "sim_arm"}, "arm"),
        (ARM, {"driver": "spacemouse", "model": "ur5"}, "is not a robot"),
        (ARM, {"driver": "sim_arm", "model": "teo_soft_neck"}, "rigid links|soft"),
        (ARM, {"driver": "sim_arm", "model": "ur5", "action": "joints"}, "delta, target, pose"),
        (ARM, {"address": "/arm"}, "model"),
        (ARM, {"address": "/arm", "model": "ur5", "driver": "sim_arm"}, "give it alone"),
        (ARM, {"address": "/arm", "model": "ur5", "limits": {"max_lead_m": 0.1}}, "own session"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_opened(make, given, why):
    with pytest.raises(ConfigurationError, match=why):
        make(**given)


def test_options_beside_a_file_are_refused(session):
    with pytest.raises(ConfigurationError, match="a session's file has those of its driver"):
        make_device(session=session, options={"curve": 0.5})
