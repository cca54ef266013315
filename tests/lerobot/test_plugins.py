"""Teleoperator and robot through LeRobot's interface: found, constructed and called in any
order."""

import inspect
import sys

import pytest

from cardan.drivers.base import OperatorDevice
from cardan.errors import ConfigurationError, DeviceNotFoundError, MotionLoopError
from cardan.types import (
    ButtonEvent,
    DeviceCapabilities,
    DeviceLink,
    DeviceState,
    RobotLink,
)
from cardan_learning.features import ActionKind, action_names
from tests.gateway.arm.arms import World
from tests.gateway.arm.ticked import FRAME, Ticked
from tests.lerobot import interface
from tests.lerobot.conftest import FOLDERS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

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

[gripper]
toggle = "right"
"""


class Held(OperatorDevice):
    """Operator device whose state the test sets."""

    capabilities = DeviceCapabilities(True, ("left",), frozenset({"led", "rumble"}), False)

    def __init__(self):
        self.opened, self.given, self.events = 0, [], []
        self.axes, self.held, self.now_s = (0.0,) * 6, frozenset(), 0.0

    def open(self):
        self.opened += 1

    def close(self):
        self.opened -= 1

    def diagnosis(self):
        return ()

    def state(self):
        return DeviceState(self.now_s, DeviceLink.LIVE, self.axes, self.held)

    def button_events(self):
        events, self.events = self.events, []
        return events

    def _feedback(self, feedback):
        self.given.append(feedback)

    def press(self, button):
        self.events.append(ButtonEvent(self.now_s, button, True))


@pytest.fixture
def session(tmp_path):
    path = tmp_path / "session.toml"
    path.write_text(SESSION)
    return str(path)


@pytest.fixture
def teleop(plugins, session, monkeypatch):
    module = plugins.teleoperator
    config = module.CardanTeleopConfig(
        id="mine",
        calibration_dir=plugins.lerobot.calibration,
        session=session,
        success_button="a",
        failure_button="b",
        rerecord_button="c",
    )
    made = module.CardanTeleop(config)
    made._device = held = Held()
    clock = sys.modules["lerobot_teleoperator_cardan.teleoperator"].time

    def now():
        held.now_s += 1 / 30
        return held.now_s

    monkeypatch.setattr(clock, "monotonic", now)
    return made


@pytest.fixture
def robot(plugins, session):
    module = plugins.robot
    config = module.CardanRobotConfig(
        id="mine", calibration_dir=plugins.lerobot.calibration, session=session
    )
    made = module.CardanRobot(config)
    world = World()
    arm = OpenedArm(world)
    made._made = made._made._replace(make=lambda: arm)
    made.world, made.opened_arm = world, arm
    return made


class OpenedArm(Ticked):
    """Arm whose loop runs once per request."""

    opened, ended = 0, ""

    def open(self):
        self.opened += 1

    def close(self):
        self.opened -= 1

    def _ask(self, verb, value=None, *, source="", sequence=None):
        if self.ended:
            raise MotionLoopError(self.ended)
        self.world.tick(2)
        return super()._ask(verb, value, source=source, sequence=sequence)


# -- found and made -------------------------------------------------------------------------------


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_the_name_is_the_modules_as_discovery_wants_it(folder):
    project = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["name"] == folder.name
    assert project["name"].startswith(interface.PREFIXES)
    assert (folder / folder.name / "__init__.py").is_file()
    needs = {each.partition("[")[0].partition(">")[0] for each in project["dependencies"]}
    assert needs == {"cardan", "cardan-learning", "lerobot"}


def test_cardan_itself_needs_no_lerobot():
    root = FOLDERS[0].parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    assert not any("lerobot" in each for each in project["dependencies"])
    assert not any(each.startswith("lerobot") for extra in extras for each in extra)


@pytest.mark.parametrize(
    ("part", "config", "kind", "base"),
    [
        ("teleoperator", "CardanTeleopConfig", "Teleoperator", "teleoperators"),
        ("robot", "CardanRobotConfig", "Robot", "robots"),
    ],
)
def test_they_are_registered_and_found_by_lerobots_rule(plugins, part, config, kind, base):
    """The class has its configuration's name without Config, in the package of its module."""
    registry = getattr(getattr(plugins.lerobot, base), f"{kind}Config")
    found = registry.get_choice_class("cardan")
    module = getattr(plugins, part)
    assert found is getattr(module, config)
    parent = sys.modules[found.__module__.rpartition(".")[0]]
    made = getattr(parent, config.removesuffix("Config"))
    assert issubclass(made, getattr(getattr(plugins.lerobot, base), kind))
    assert (made.name, made.config_class) == ("cardan", found)
    assert not inspect.isabstract(made)
    assert found(driver="spacemouse", session="").type == "cardan"


def test_a_wrong_configuration_is_reported_when_it_is_made(plugins):
    where = {"calibration_dir": plugins.lerobot.calibration}
    for module, config in (
        (plugins.teleoperator, plugins.teleoperator.CardanTeleopConfig(**where)),
        (plugins.robot, plugins.robot.CardanRobotConfig(**where)),
    ):
        kind = getattr(module, type(config).__name__.removesuffix("Config"))
        with pytest.raises(ConfigurationError, match="give either"):
            kind(config)


def test_features_are_known_before_anything_is_open(teleop, robot):
    assert not teleop.is_connected
    assert not robot.is_connected
    assert tuple(teleop.action_features) == action_names(ActionKind.DELTA, True)
    assert tuple(robot.action_features) == action_names(ActionKind.DELTA, False)
    assert {*robot.action_features} <= {*teleop.action_features}
    assert len(robot.observation_features) == 12
    numbers = (teleop.action_features, robot.action_features, robot.observation_features)
    assert {kind for each in numbers for kind in each.values()} == {float}
    assert {*teleop.feedback_features} == {"led", "rumble"}
    assert teleop.is_calibrated
    assert robot.is_calibrated


@pytest.mark.parametrize("device", ["teleop", "robot"])
def test_the_order_of_calls(device, request, plugins):
    made = request.getfixturevalue(device)
    errors = plugins.lerobot.errors
    calls = {
        "teleop": [
            lambda: made.get_action(),
            lambda: made.send_feedback({}),
            lambda: made.disconnect(),
        ],
        "robot": [
            lambda: made.get_observation(),
            lambda: made.send_action({}),
            lambda: made.disconnect(),
        ],
    }[device]
    for _ in range(2):
        for call in calls:
            with pytest.raises(errors.DeviceNotConnectedError, match=r"connect\(\)"):
                call()
        made.connect()
        assert made.is_connected
        with pytest.raises(errors.DeviceAlreadyConnectedError):
            made.connect()
        made.calibrate()
        made.configure()
        made.disconnect()
        assert not made.is_connected


# -- the teleoperator -----------------------------------------------------------------------------


def test_the_hand_asks(teleop):
    teleop.connect()
    hand = teleop._device
    action = teleop.get_action()
    assert list(action) == list(teleop.action_features)
    assert set(action.values()) == {0.0, 1.0}
    hand.held = frozenset({"left"})
    teleop.get_action()
    hand.axes = (0.5, 0, 0, 0, 0, 0)
    hand.press("right")
    action = teleop.get_action()
    assert (action["delta_x"], action["gripper"]) == (0.5, 0.0)
    teleop.disconnect()
    assert hand.opened == 0


def test_events(teleop, plugins):
    events = plugins.lerobot.events
    nothing = {events[name]: False for name in interface.REPORTED_EVENTS}
    assert teleop.get_teleop_events() == nothing
    teleop.connect()
    assert teleop.get_teleop_events() == nothing
    hand = teleop._device
    hand.held = frozenset({"left"})
    assert teleop.get_teleop_events() == {**nothing, events.IS_INTERVENTION: True}
    hand.held = frozenset()
    for button, reported in (
        ("a", {events.SUCCESS}),
        ("b", set()),
        ("c", {events.RERECORD_EPISODE}),
    ):
        hand.press(button)
        teleop.get_action()
        ended = dict.fromkeys({*reported, events.TERMINATE_EPISODE}, True)
        assert teleop.get_teleop_events() == {**nothing, **ended}
        assert teleop.get_teleop_events() == nothing


def test_feedback(teleop):
    teleop.connect()
    teleop.send_feedback({"rumble": 3.0, "led": 1.0})
    teleop.send_feedback({"rumble": 0.0})
    assert [(each.rumble, each.led) for each in teleop._device.given] == [(1.0, True), (0.0, None)]


def test_a_device_that_is_not_there_is_not_connected(teleop):
    def absent():
        raise DeviceNotFoundError("no SpaceMouse: plug one in")

    teleop._device.open = absent
    with pytest.raises(DeviceNotFoundError, match="plug one in"):
        teleop.connect()
    assert not teleop.is_connected


# -- the robot ------------------------------------------------------------------------------------


def test_the_arm_is_driven_and_says_what_was_sent(robot):
    robot.connect()
    seen = robot.get_observation()
    assert list(seen) == list(robot.observation_features)
    nothing = dict.fromkeys(robot.action_features, 0.0)
    for _ in range(30):
        sent = robot.send_action({**nothing, "delta_z": -9.0, "gripper": 1.0})
        robot.world.tick(FRAME)
    assert list(sent) == list(robot.action_features)
    assert -1.01 <= sent["delta_z"] < -0.9
    assert robot.get_observation()["ee.z"] < seen["ee.z"] - 0.01
    robot.disconnect()
    assert robot.opened_arm.opened == 0


def test_why_nothing_moves_is_logged_once(robot, caplog):
    robot.connect()
    robot.world.hold_reason = "motors are off"
    nothing = dict.fromkeys(robot.action_features, 0.0)
    for _ in range(5):
        sent = robot.send_action({**nothing, "delta_x": 1.0})
        assert sent == nothing
    (said,) = [each.message for each in caplog.records if "motors are off" in each.message]
    assert said.startswith("cardan: ")


def test_a_silent_robot_is_not_connected(robot, plugins):
    error = plugins.lerobot.errors.DeviceNotConnectedError
    robot.world.link = RobotLink.LOST
    robot.config.ready_timeout_s = 0.0
    with pytest.raises(error):
        robot.connect()
    assert not robot.is_connected
    assert robot.opened_arm.opened == 0
    robot.world.link = RobotLink.LIVE
    robot.connect()
    robot.world.link, robot.config.silence_timeout_s = RobotLink.LOST, 0.0
    with pytest.raises(error, match="silent"):
        robot.get_observation()
    robot.world.link = RobotLink.LIVE
    robot.opened_arm.ended = "the session has ended: killed"
    nothing = dict.fromkeys(robot.action_features, 0.0)
    for call in (robot.get_observation, lambda: robot.send_action(nothing)):
        with pytest.raises(error, match="killed"):
            call()


def test_a_robot_that_falls_silent_for_a_moment_is_waited_for(robot, monkeypatch, caplog):
    robot.connect()
    robot.world.link = RobotLink.LOST
    looks = []

    def look(_seconds):
        looks.append(1)
        if len(looks) == 5:
            robot.world.link = RobotLink.LIVE

    monkeypatch.setattr(sys.modules["lerobot_robot_cardan.robot"].time, "sleep", look)
    assert list(robot.get_observation()) == list(robot.observation_features)
    assert len(looks) == 5
    assert [each.message for each in caplog.records if "silent" in each.message] == [
        "cardan: stat: the robot is silent, and its measurements are old"
    ]


class Camera:
    """Stand-in for a LeRobot camera."""

    is_connected = False

    def connect(self, warmup=True):
        self.is_connected = True

    def disconnect(self):
        self.is_connected = False

    def async_read(self, timeout_ms=200.0):
        assert self.is_connected
        return "picture"


def test_cameras_are_observed_beside_the_arm(robot):
    robot.cameras = {"wrist": Camera()}
    robot.connect()
    assert robot.is_connected
    assert robot.get_observation()["wrist"] == "picture"
    robot.disconnect()
    assert not robot.cameras["wrist"].is_connected
