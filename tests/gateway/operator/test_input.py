"""An operator device as a source of requests: the rule of re-arming, tick by tick."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.motion.speed_limited_reference import ReferenceLimits
from cardan.gateway.operator.deadman import Arming
from cardan.gateway.operator.input import CLUTCH_WITHIN_S, NO_REQUEST, ArmView, OperatorInput
from cardan.gateway.operator.mapping import GripperOptions, MappingOptions, Mode, TwistMapping
from cardan.types import (
    IDENTITY,
    IDENTITY_POSE,
    ZERO_TWIST,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Pose,
    RobotLink,
    RobotState,
    Twist,
    Vector3,
)

DT_S = 0.004
REST = (0.0,) * 6
FORWARD = (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
DEADMAN = MappingOptions(deadman=("left",))
CLUTCH = MappingOptions(clutch="right")
BARE = MappingOptions()
HAND = Pose(Vector3(0.1, 0.2, 0.3), IDENTITY)


class Asked:
    """An operator input and its arm, which grants every request of arming."""

    def __init__(self, options=DEADMAN):
        limits = ReferenceLimits()
        self.source = OperatorInput(TwistMapping(options), limits)
        self.now_s, self.arming = 10.0, Arming.DISARMED

    @property
    def armed(self):
        return self.arming.armed

    def disarm(self):
        self.arming = Arming.DISARMED
        self.source.disarm()

    def tick(
        self,
        axes=REST,
        *buttons,
        events=(),
        link=DeviceLink.LIVE,
        age_s=0.0,
        pose=None,
        masked=(),
        **view,
    ):
        self.now_s += DT_S
        device = DeviceState(self.now_s - age_s, link, axes, frozenset(buttons), pose)
        device = device._replace(masked=frozenset(masked))
        robot = RobotState(self.now_s, RobotLink.LIVE, 1, 0, DT_S, (), (), IDENTITY_POSE, "")
        edges = [ButtonEvent(self.now_s - age, name, down) for name, down, age in events]
        known = {"arming": self.arming, "free": True}
        known |= {"tcp": IDENTITY_POSE, "resting": IDENTITY_POSE}
        self.request = self.source.request(device, edges, ArmView(robot, DT_S, **{**known, **view}))
        self.arming = self.request.arming
        return self.request

    def seen(self, **tick):
        """Run one tick with the device at rest."""
        self.tick(**tick)
        return self

    def arm(self):
        self.tick()
        assert self.tick(REST, "left").newly_armed
        return self

    @property
    def advice(self):
        return self.source.advice("", self.arming)


# -- re-arming -----------------------------------------------------------------------------------


def test_the_act_is_the_dead_man_pressed_after_device_and_dead_man_were_at_rest():
    asked = Asked()
    assert not asked.tick().arming_requested
    assert "press 'left' to move" in asked.advice
    request = asked.tick(REST, "left")
    assert request.arming_requested
    assert request.newly_armed
    assert request.armed
    assert request.following
    assert not request.asks
    request = asked.tick(FORWARD, "left")
    assert not request.newly_armed
    assert request.asks
    assert request.twist.linear.x > 0.0


@pytest.mark.parametrize("before", [(REST, "left"), (FORWARD,), (FORWARD, "left")])
def test_a_dead_man_or_a_deflection_from_before_is_no_act(before):
    asked = Asked()
    asked.tick(*before)
    assert not asked.tick(FORWARD, "left").arming_requested
    assert asked.advice == "let go of the device and of 'left', then press 'left' to go on"


@pytest.mark.parametrize("age_s", [0.2, -0.2])
def test_a_deflection_that_may_drive_no_motion_is_no_act(age_s):
    asked = Asked().seen()
    request = asked.tick(FORWARD, "left", age_s=age_s)
    assert not request.arming_requested
    assert not request.asks
    asked.arm()


def test_an_inhibited_rearming_is_reported_and_has_to_be_repeated():
    asked = Asked().seen()
    request = asked.tick(REST, "left", inhibited="somebody else has the arm")
    assert request.arming_requested
    assert not request.armed
    assert not asked.tick(REST, "left").arming_requested
    asked.arm()


def test_nothing_counts_while_the_robot_is_not_ready():
    asked = Asked()
    asked.tick(input_ignored=True)
    assert not asked.tick(REST, "left").arming_requested
    asked.tick()
    assert not asked.tick(REST, "left", input_ignored=True).arming_requested
    assert not asked.tick(REST, "left").arming_requested
    asked.arm()


def test_disarming_takes_away_what_was_held():
    asked = Asked().arm()
    asked.disarm()
    assert not asked.tick(REST, "left").arming_requested
    asked.arm()


def test_without_a_dead_man_rest_arms_and_an_inhibited_one_takes_a_move_and_rest():
    asked = Asked(BARE)
    assert not asked.tick(FORWARD).armed
    assert asked.tick(REST).newly_armed
    assert asked.tick(FORWARD).asks
    asked = Asked(BARE)
    assert not asked.tick(REST, inhibited="held").arming_requested
    assert not asked.tick(FORWARD, inhibited="held").arming_requested
    request = asked.tick(REST, inhibited="held")
    assert request.arming_requested
    assert not request.newly_armed
    assert asked.source.rearming_instruction() == "move the device and let it go"
    # staying at rest is not another action
    assert not asked.tick(REST, inhibited="held").arming_requested
    assert not asked.tick(FORWARD, inhibited="held").arming_requested
    assert asked.tick(REST, inhibited="held").arming_requested


@pytest.mark.parametrize("options", [DEADMAN, CLUTCH, BARE])
def test_the_act_begins_with_a_device_that_is_there(options):
    asked = Asked(options).seen()
    act = asked.source.rearming_instruction()
    asked.tick(link=DeviceLink.LOST)
    assert (
        asked.source.rearming_instruction()
        == f"wait for the device (the device is lost), then {act}"
    )


def test_the_arm_is_not_moved_before_it_was_braked_for_somebody_else():
    asked = Asked().arm()
    request = asked.tick(FORWARD, "left", free=False)
    assert request.armed
    assert not request.following
    assert request.twist == ZERO_TWIST
    assert asked.tick(FORWARD, "left").asks


def test_a_suspended_hand_asks_for_nothing_in_that_tick():
    asked = Asked().arm()
    request = asked.tick(FORWARD, "left", suspended=True)
    assert request.armed
    assert not request.asks
    assert asked.tick(FORWARD, "left").asks


# -- the clutch ----------------------------------------------------------------------------------


def press(age_s=0.0):
    return ("right", True, age_s)


RELEASE = ("right", False, 0.0)


def test_presses_toggle_the_clutch():
    asked = Asked(CLUTCH).seen()
    request = asked.tick(REST, "right", events=[press()])
    assert request.newly_armed
    assert request.pressed
    asked.tick(FORWARD, events=[RELEASE])
    assert asked.request.asks
    request = asked.tick(FORWARD, "right", events=[press()])
    assert not request.armed
    assert request.fault == ""
    assert request.twist == ZERO_TWIST


@pytest.mark.parametrize(
    ("tick", "words"),
    [
        ({"events": [press(1.1 * CLUTCH_WITHIN_S)]}, "pressed 0.6 s ago"),
        ({"events": [press()], "behind": "the robot lags"}, "the robot lags"),
        ({"events": [press()], "axes": FORWARD}, "the device is not at rest"),
    ],
)
def test_a_press_that_begins_nothing_says_why(tick, words):
    asked = Asked(CLUTCH).seen()
    asked.tick(tick.pop("axes", REST), "right", **tick)
    assert not asked.armed
    asked.tick(REST)
    assert words in asked.advice


@pytest.mark.parametrize("tick", [{"inhibited": "no"}, {"tripped": True}, {"input_ignored": True}])
def test_a_press_at_a_bad_moment_begins_nothing_and_nothing_later(tick):
    asked = Asked(CLUTCH).seen()
    request = asked.tick(REST, "right", events=[press()], **tick)
    assert request.arming_requested is ("inhibited" in tick)
    assert not request.armed
    assert not asked.tick(REST, "right").armed
    asked.tick(REST, events=[RELEASE])
    assert asked.tick(REST, "right", events=[press()]).newly_armed


# -- faults --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("axes", "tick", "words"),
    [
        (REST, {"link": DeviceLink.LOST}, "the device is lost"),
        ((math.nan, 0.0, 0.0, 0.0, 0.0, 0.0), {}, "not numbers"),
        (FORWARD, {"age_s": 0.11}, "deflected but silent for 0.11 s"),
        (REST, {"age_s": -0.2}, "a time 0.2 s in the future"),
    ],
)
def test_a_fault_disarms_and_takes_the_act_anew(axes, tick, words):
    asked = Asked().arm()
    request = asked.tick(axes, "left", **tick)
    assert words in request.fault
    assert not request.armed
    assert request.twist == ZERO_TWIST
    assert not asked.tick(FORWARD, "left").armed
    asked.arm()


def test_silence_at_rest_is_no_fault():
    assert Asked().arm().tick(REST, "left", age_s=30.0).fault == ""


def test_a_hand_whose_pose_is_followed_has_to_give_one():
    asked = Asked(MappingOptions(mode=Mode.POSITION, deadman=("left",)))
    asked.tick(pose=HAND)
    assert asked.tick(REST, "left", pose=HAND).newly_armed
    assert "gives no pose" in asked.tick(REST, "left").fault
    asked.tick(pose=HAND)
    asked.tick(REST, "left")
    assert not asked.armed
    assert "the clutch was not engaged: the device gives no pose" in asked.advice


def test_only_an_armed_hand_has_faults():
    asked = Asked()
    assert asked.tick(FORWARD, link=DeviceLink.LOST).fault == ""


# -- random actions of the operator --------------------------------------------------------------

ticks = st.lists(
    st.tuples(
        st.sampled_from((REST, REST, FORWARD, (math.nan, *REST[1:]))),
        st.booleans(),
        st.sampled_from((DeviceLink.LIVE,) * 5 + (DeviceLink.LOST,)),
        st.sampled_from((0.0, 0.0, 0.2)),
        st.sampled_from(("", "", "inhibited", "input_ignored", "unfree", "suspended")),
    ),
    max_size=40,
)


@given(ticks)
def test_nothing_is_asked_for_but_by_an_armed_live_hand_with_its_dead_man_held(plan):
    asked, rested = Asked(), False
    for axes, held, link, age_s, trouble in plan:
        view = {
            "inhibited": "no" if trouble == "inhibited" and not asked.armed else "",
            "input_ignored": trouble == "input_ignored",
            "free": trouble != "unfree",
            "suspended": trouble == "suspended",
        }
        was_armed = asked.armed
        if trouble == "input_ignored":
            asked.disarm()  # The controller disarms before it reads the device.
            was_armed = False
        request = asked.tick(axes, *(("left",) if held else ()), link=link, age_s=age_s, **view)
        if request.asks or request.following:
            assert request.armed
            assert held
            assert link is DeviceLink.LIVE
            assert math.isfinite(request.twist.linear.x)
            assert not view["input_ignored"]
            assert view["free"]
        if request.asks:
            assert age_s == 0.0
            assert trouble != "suspended"
        if request.newly_armed:
            assert rested
            assert not was_armed
            assert view["inhibited"] == ""
        if request.armed:
            assert was_armed or request.newly_armed
        # True if device and dead-man's switch were at rest since the last interruption.
        if trouble == "input_ignored" or request.fault or (held and view["inhibited"]):
            rested = False
        elif link is not DeviceLink.LIVE:
            rested = rested and was_armed
        elif not held and axes == REST:
            rested = True


def test_a_button_that_the_device_has_not_is_reported_in_place_of_an_act_that_cannot_be():
    asked = Asked().seen()
    asked.source.complaint = "mapping.deadman: the device has no button 'left'; it has: go"
    asked.tick()
    assert asked.advice == asked.source.complaint
    asked.tick(link=DeviceLink.LOST)
    assert asked.advice != asked.source.complaint


@pytest.mark.parametrize("deadman", [(), ("left",), ("a", "b")])
def test_an_armed_device_moves_the_arm_while_one_button_of_its_dead_man_is_held(deadman):
    asked = Asked(MappingOptions(deadman=deadman)).seen()
    asked.tick(REST, *deadman)
    for held in ((), ("c",), ("a",), ("left", "c"), deadman):
        following = asked.tick(FORWARD, *held).following
        assert asked.armed
        assert following is (not deadman or bool({*deadman} & {*held}))


@pytest.mark.parametrize(
    ("joints", "axes", "asks"),
    [
        ({}, REST, False),
        ({}, (0.0, 0.1, 0.0, 0.0, 0.0, 0.0), True),
        ({}, (0.0, 0.0, 0.0, 0.0, 0.0, -0.1), True),
        ({"x": "a", "-rz": "b"}, REST, False),
        ({"x": "a", "-rz": "b"}, (0.0, 0.0, 0.0, 0.0, 0.0, 0.1), True),
    ],
)
def test_motion_of_any_kind_is_asked_for(joints, axes, asks):
    fixed = ("fixed",) * 6 if joints else MappingOptions().axes
    asked = Asked(MappingOptions(deadman=("left",), joints=joints, axes=fixed)).arm()
    assert asked.tick(axes, "left").asks is asks
    assert asked.tick(axes).asks is False


# -- fields of a request besides the twist ---------------------------------------------------------

BACK = (-1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
BOTH = MappingOptions(clutch="right", deadman=("left",))
POSE = MappingOptions(mode=Mode.POSITION, deadman=("left",))
POSE_CLUTCH = MappingOptions(mode=Mode.POSITION, clutch="right")
POSE_BOTH = MappingOptions(mode=Mode.POSITION, clutch="right", deadman=("left",))
AWAY = Pose(Vector3(0.101, 0.2, 0.3), IDENTITY)
NO_NUMBERS = Pose(Vector3(math.nan, 0.0, 0.0), IDENTITY)


def clutched(options, *held, pose=None):
    """An operator input after its clutch was pressed and released."""
    asked = Asked(options)
    asked.tick(pose=pose)
    assert asked.tick(REST, "right", *held, events=[press()], pose=pose).armed
    asked.tick(REST, *held, events=[RELEASE], pose=pose)
    return asked


def test_an_operator_claims_the_arm_by_a_button_or_by_motion():
    assert Asked().arm().arming is Arming.CLAIMING
    assert clutched(CLUTCH).arming is Arming.CLAIMING
    both = clutched(BOTH)
    assert both.arming is Arming.ARMED
    both.tick(REST, "left")
    assert both.arming is Arming.CLAIMING
    bare = Asked(BARE)
    assert bare.tick(REST).arming is Arming.ARMED
    assert bare.tick(FORWARD).arming is Arming.CLAIMING
    assert bare.tick(REST).arming is Arming.ARMED


def test_any_button_that_goes_down_is_a_press():
    asked = Asked()
    assert asked.tick(events=[press(), RELEASE]).pressed
    assert not asked.tick(events=[RELEASE]).pressed
    assert not asked.tick().pressed


def test_joints_move_only_while_the_operator_is_followed():
    asked = Asked(MappingOptions(deadman=("left",), joints={"rx": "rail"}, joint_speed_rad_s=0.5))
    tilted = (0.0, 0.0, 0.0, 0.4, 0.0, 0.0)
    assert asked.tick(tilted, "left").rates == {}
    asked.arm()
    assert asked.tick(tilted, "left").rates == {"rail": pytest.approx(0.2)}
    assert asked.tick(tilted, "left", suspended=True).rates == {}
    assert asked.tick(tilted, "left", free=False).rates == {}
    assert Asked().arm().tick(FORWARD, "left").rates == {}


def test_an_armed_device_stays_so_where_only_its_buttons_are_ignored():
    asked = Asked().arm()
    assert asked.tick(REST, "left", input_ignored=True).armed
    deflected = Asked(BARE)
    deflected.tick(FORWARD, inhibited="held")
    assert deflected.arming is Arming.DEFLECTED
    deflected.tick(FORWARD, input_ignored=True)
    assert deflected.arming is Arming.DISARMED


def test_the_gripper_is_the_operator_s_who_drives():
    gripper = GripperOptions(toggle="right")
    asked = Asked()
    asked.source = OperatorInput(TwistMapping(DEADMAN, gripper), ReferenceLimits())
    mapping = asked.source.mapping
    asked.tick(events=[press()])
    assert not mapping.gripper_closed
    asked.tick(REST, "left")
    asked.tick(REST, events=[press()])
    assert not mapping.gripper_closed  # armed, with the dead-man's switch released
    asked.tick(REST, "left", events=[press()])
    assert mapping.gripper_closed


# -- the device's pose -----------------------------------------------------------------------------


def posed(options=POSE):
    """An operator input that follows the device's pose."""
    asked = Asked(options).seen(pose=HAND)
    asked.tick(REST, "left", pose=HAND)
    assert asked.armed
    return asked


def test_an_absolute_hand_sends_the_tcp_where_it_is():
    options = MappingOptions(mode=Mode.ABSOLUTE, deadman=("left",), origin_m=Vector3(0, 0, 0))
    twist = posed(options).tick(REST, "left", pose=HAND).twist
    assert twist.linear.x > 0.0
    assert twist.linear.y > twist.linear.x


def test_a_hand_is_taken_up_anew_when_the_dead_man_beside_the_clutch_is_held():
    asked = clutched(POSE_BOTH, pose=HAND)
    assert not asked.request.following
    assert asked.tick(REST, "left", pose=HAND).following
    assert asked.tick(REST, "left", pose=AWAY).twist.linear.x > 0.0
    asked.tick(REST, pose=AWAY)
    request = asked.tick(REST, "left", pose=AWAY, behind="the robot lags")
    assert not request.armed
    assert not request.following
    assert "the clutch was not engaged: the robot lags; " in asked.advice


def test_a_dead_man_that_was_let_go_and_held_again_in_between_takes_the_hand_up_anew():
    asked = posed()
    again = [("left", False, 0.0), ("left", True, 0.0)]
    assert asked.tick(REST, "left", pose=AWAY, events=again).twist == ZERO_TWIST
    asked = posed()
    assert asked.tick(REST, "left", pose=AWAY, events=[("other", False, 0.0)]).asks
    assert posed().tick(REST, "left", pose=AWAY, events=[("left", True, 0.0)]).asks


def test_letting_go_takes_the_hand_up_anew():
    asked = posed()
    asked.tick(pose=HAND)
    assert not asked.source.device_map()
    request = asked.tick(REST, "left", pose=AWAY)
    assert request.armed
    assert request.twist == ZERO_TWIST
    assert asked.source.device_map()
    asked.disarm()
    assert not asked.source.device_map()
    assert not Asked().source.device_map()


def test_a_press_of_the_clutch_lets_go_of_the_hand_although_it_is_engaged_again_at_once():
    asked = Asked(POSE_CLUTCH).seen(pose=HAND)
    asked.tick(REST, "right", events=[press()], pose=HAND)
    assert asked.source.device_map()
    presses = [RELEASE, press(), RELEASE, press()]
    request = asked.tick(REST, "right", events=presses, pose=AWAY)
    assert request.armed
    assert request.twist == ZERO_TWIST


def test_the_references_are_taken_anew_where_hand_and_tcp_are():
    options = MappingOptions(mode=Mode.POSITION, deadman=("left",), recapture="grip")
    for event, moves in (
        (("grip", True, 0.0), False),
        (("grip", False, 0.0), True),
        (("other", True, 0.0), True),
    ):
        asked = posed(options)
        assert asked.tick(REST, "left", pose=AWAY, events=[event]).asks is moves
    asked = posed(options)
    both = [("grip", True, 0.0), ("grip", False, 0.0)]
    assert not asked.tick(REST, "left", pose=AWAY, events=both).asks


def test_the_hand_belongs_to_where_the_arm_comes_to_rest():
    asked = Asked(POSE).seen(pose=HAND)
    resting = Pose(Vector3(0.01, 0.0, 0.0), IDENTITY)
    assert asked.tick(REST, "left", pose=HAND, resting=resting).twist.linear.x > 0.0


def test_a_suspended_hand_is_followed_on_without_a_motion():
    asked = posed()
    request = asked.tick(REST, "left", pose=AWAY, suspended=True)
    assert request.following
    assert request.twist == ZERO_TWIST
    assert asked.source.device_map()


def test_what_the_hand_is_reported():
    assert Asked().arm().source.remark == ""
    asked = posed()
    assert asked.source.remark == ""
    for reached in range(1, 41):
        far = Pose(Vector3(0.1 + 0.005 * reached, 0.2, 0.3), IDENTITY)
        asked.tick(REST, "left", pose=far)
    assert asked.armed
    assert "the clutch slips" in asked.source.remark


def test_a_hand_that_leaps_is_let_go():
    asked = posed()
    far = Pose(Vector3(0.5, 0.2, 0.3), IDENTITY)
    request = asked.tick(REST, "left", pose=far)
    assert (
        request.fault == "the device's pose jumped: its tracking was lost, or it sees another hand"
    )
    assert not request.armed
    assert posed().tick(REST, pose=far).fault == ""  # the pose is not followed here


def test_deflections_mean_nothing_where_the_pose_is_followed():
    asked = Asked(POSE)
    asked.tick(FORWARD, pose=HAND)
    assert asked.tick(FORWARD, "left", pose=HAND).newly_armed
    asked = Asked(POSE_CLUTCH)
    asked.tick(FORWARD, pose=HAND)
    assert asked.tick(FORWARD, "right", pose=HAND, events=[press()]).newly_armed
    not_numbers = (math.nan, *REST[1:])
    assert posed().tick(not_numbers, "left", pose=HAND).fault == ""


@pytest.mark.parametrize(
    ("age_s", "ok"), [(0.1, True), (0.1001, False), (-0.1, True), (-0.1001, False)]
)
def test_how_old_a_report_may_be_to_the_border(age_s, ok):
    robot_s = 0.0
    device = DeviceState(-age_s, DeviceLink.LIVE, FORWARD, frozenset({"left"}), HAND)
    still = device._replace(axes=REST)
    rate = OperatorInput(TwistMapping(DEADMAN), ReferenceLimits())
    assert (rate._fault(device, robot_s, True) == "") is ok
    assert (rate._fault(still, robot_s, True) == "") is (ok or age_s > 0.0)
    pose = OperatorInput(TwistMapping(POSE), ReferenceLimits())
    assert (pose._fault(device, robot_s, True) == "") is ok
    free = device._replace(buttons=frozenset())
    assert (pose._fault(free, robot_s, False) == "") is (ok or age_s > 0.0)
    robot = RobotState(robot_s, RobotLink.LIVE, 1, 0, DT_S, (), (), IDENTITY_POSE, "")
    view = ArmView(robot, DT_S, IDENTITY_POSE, IDENTITY_POSE, Arming.RELEASED, True)
    request = pose.request(device, (), view)
    assert request.newly_armed is ok


@pytest.mark.parametrize(
    ("tick", "words"),
    [
        ({"age_s": 0.25}, "the device's pose is 0.25 s old"),
        ({"age_s": -0.3}, "the robot's pose is 0.3"),
        ({"pose": None}, "the device gives no pose"),
        ({"pose": NO_NUMBERS}, "the device gives no pose"),
    ],
)
def test_why_a_pose_is_not_taken(tick, words):
    for options, held in ((POSE, "left"), (POSE_CLUTCH, "right")):
        asked = Asked(options).seen(pose=HAND)
        events = [press()] if held == "right" else []
        assert not asked.tick(REST, held, events=events, **{"pose": HAND, **tick}).armed
        assert f"the clutch was not engaged: {words}" in asked.advice


def test_a_pose_that_is_none_is_not_followed():
    fault = "the device gives no pose to follow"
    assert posed().tick(REST, "left", pose=NO_NUMBERS).fault == fault
    assert posed().tick(REST, pose=NO_NUMBERS).fault == ""


@pytest.mark.parametrize("free", [True, False])
def test_a_hand_is_taken_when_its_robot_is_there_and_deflections_at_any_time(free):
    asked = Asked(POSE).seen(pose=HAND)
    assert "not engaged" not in asked.advice
    request = asked.tick(REST, "left", pose=HAND, behind="the robot lags", free=free)
    assert request.arming_requested
    assert not request.armed
    assert "the clutch was not engaged: the robot lags" in asked.advice
    asked = Asked(POSE).seen()
    assert "not engaged" not in asked.advice
    asked = Asked().seen()
    assert asked.tick(REST, "left", behind="the robot lags", free=free).newly_armed


def test_a_device_that_was_gone_was_not_let_go():
    asked = Asked().seen()
    asked.tick(link=DeviceLink.LOST)
    assert asked.arming is Arming.DISARMED
    assert not asked.tick(REST, "left").arming_requested
    asked = Asked(BARE)
    asked.tick(FORWARD, inhibited="held")
    asked.tick(link=DeviceLink.LOST, inhibited="held")
    assert asked.arming is Arming.DEFLECTED
    assert asked.tick(REST, inhibited="held").arming_requested


# -- the clutch's presses --------------------------------------------------------------------------


def test_a_press_needs_a_button_that_was_seen_up():
    asked = Asked(CLUTCH)
    # no state has been read before
    assert not asked.tick(REST, "right", events=[press()]).arming_requested
    asked = Asked(CLUTCH)
    asked.tick(REST, "right")
    assert not asked.tick(REST, "right", events=[press()]).arming_requested
    asked.tick(REST, "right")
    assert asked.tick(REST, "right", events=[RELEASE, press()]).newly_armed
    asked = Asked(CLUTCH)
    asked.tick(link=DeviceLink.LOST)
    assert not asked.tick(REST, "right", events=[RELEASE, press()]).arming_requested
    asked = Asked(CLUTCH).seen()
    assert not asked.tick(REST, "right", events=[press()], link=DeviceLink.LOST).arming_requested


def test_a_second_press_without_a_release_does_not_count():
    asked = Asked(CLUTCH).seen()
    request = asked.tick(FORWARD, "right", events=[press(), press()])
    assert not request.armed
    asked = Asked(CLUTCH).seen()
    assert not asked.tick(REST, "right", events=[press(), press(), press()]).armed


def test_a_press_that_came_too_late_and_a_second_one_are_no_act():
    asked = Asked(CLUTCH).seen()
    events = [press(1.1 * CLUTCH_WITHIN_S), press()]
    assert not asked.tick(REST, "right", events=events).armed


def test_other_buttons_are_no_clutch():
    asked = Asked(CLUTCH).seen()
    assert not asked.tick(REST, "x", events=[("x", True, 0.0)]).arming_requested
    asked = clutched(CLUTCH)
    assert asked.tick(REST, "x", events=[("x", True, 0.0)]).armed
    events = [("x", False, 0.0), press()]
    assert not asked.tick(REST, "right", "x", events=events).armed


def test_a_press_after_a_fault_in_the_same_tick_does_not_engage():
    asked = clutched(CLUTCH)
    request = asked.tick(FORWARD, "right", events=[press()], age_s=0.2)
    assert request.fault
    assert not request.arming_requested
    asked = clutched(POSE_CLUTCH, pose=HAND)
    far = Pose(Vector3(0.5, 0.2, 0.3), IDENTITY)
    request = asked.tick(REST, "right", events=[press()], pose=far)
    assert request.fault
    assert not request.armed


def test_a_press_counts_for_half_a_second():
    source = OperatorInput(TwistMapping(CLUTCH), ReferenceLimits())
    robot = RobotState(1.0, RobotLink.LIVE, 1, 0, DT_S, (), (), IDENTITY_POSE, "")
    view = ArmView(robot, DT_S, IDENTITY_POSE, IDENTITY_POSE, Arming.DISARMED, True)
    device = DeviceState(1.0, DeviceLink.LIVE, REST, frozenset())
    source.request(device, (), view)
    edge = ButtonEvent(1.0 - CLUTCH_WITHIN_S, "right", True)
    assert source.request(device._replace(buttons=frozenset({"right"})), (edge,), view).newly_armed


def test_a_press_that_is_accepted_takes_back_why_the_one_before_was_not():
    asked = Asked(CLUTCH).seen()
    asked.tick(FORWARD, "right", events=[press()])
    assert "not engaged" in asked.advice
    asked.tick(REST, events=[RELEASE])
    asked.tick(REST, "right", events=[press()])
    assert asked.armed
    assert "not engaged" not in asked.advice
    asked = Asked(CLUTCH).seen()
    asked.tick(FORWARD, "right", events=[press()])
    asked.disarm()
    assert "not engaged" not in asked.advice


# -- filters ---------------------------------------------------------------------------------------


class Filter:
    """A filter whose result the test sets."""

    name = "rule"

    def __init__(self, apply, status=lambda: ""):
        self._apply, self.status = apply, status

    def apply(self, twist, robot):
        return self._apply(twist)


def fails(*_):
    raise ValueError("no reading")


def turned(linear, angular=(0.0, 0.0, 0.0)):
    return lambda twist: Twist(Vector3(*linear), Vector3(*angular), twist.frame)


@pytest.mark.parametrize(
    ("apply", "words"),
    [
        (fails, "the filter rule failed: ValueError('no reading')"),
        (turned((math.nan, 0, 0)), "the filter rule gives values that are not numbers"),
        (turned((0, 0, 0), (0, math.inf, 0)), "the filter rule gives values that are not numbers"),
    ],
)
def test_a_filter_that_fails_stops_and_the_first_is_named(apply, words):
    seen = []
    asked = Asked().arm()
    asked.source.filters = (
        Filter(lambda twist: twist),
        Filter(apply),
        Filter(lambda twist: seen.append(twist) or twist),
        Filter(fails),
    )
    asked.source.filters[-1].name = "later"
    request = asked.tick(FORWARD, "left")
    assert request.filter_fault == words
    assert request.twist == ZERO_TWIST
    assert seen == [ZERO_TWIST]


def test_filters_shape_motion_one_after_the_other_and_begin_none():
    asked = Asked().arm()
    asked.source.filters = (
        Filter(lambda twist: twist._replace(linear=Vector3(twist.linear.x, 0.5, 0.0))),
        Filter(lambda twist: twist._replace(angular=Vector3(0.0, 0.0, twist.linear.y))),
    )
    twist = asked.tick(FORWARD, "left").twist
    assert twist.linear.x > 0.0
    assert twist.linear.y == twist.angular.z == 0.5
    turn = (0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    assert asked.tick(turn, "left").twist.linear.y == 0.5
    assert asked.tick(REST, "left").twist == ZERO_TWIST
    assert not Asked(BARE).tick(REST).filter_fault


def test_what_filters_say_is_reported():
    asked = Asked()
    asked.source.filters = (
        Filter(fails, lambda: "slow here"),
        Filter(fails),
        Filter(fails, fails),
        Filter(fails, lambda: 7),
    )
    assert asked.source.filter_words() == (
        "slow here",
        "the filter rule failed: ValueError('no reading')",
        "the filter rule failed: TypeError('status() returned 7, not a text')",
    )


# -- messages --------------------------------------------------------------------------------------

TWO = MappingOptions(deadman=("left", "right"))
CLUTCHES = MappingOptions(clutch="right", deadman=("left", "up"))


@pytest.mark.parametrize(
    ("options", "arming", "axes", "held", "words"),
    [
        (BARE, Arming.DISARMED, FORWARD, (), "let go of the device to go on"),
        (DEADMAN, Arming.RELEASED, REST, (), "press 'left' to move"),
        (
            TWO,
            Arming.DISARMED,
            BACK,
            ("left",),
            "let go of the device and of 'left' or 'right', then press 'left' or 'right' to go on",
        ),
        (POSE, Arming.DISARMED, FORWARD, ("left",), "let go of 'left', then press it to go on"),
        (CLUTCH, Arming.DISARMED, REST, (), "press 'right' to move"),
        (
            CLUTCH,
            Arming.DISARMED,
            FORWARD,
            (),
            "let go of the device, then press 'right' to move",
        ),
        (
            CLUTCH,
            Arming.DISARMED,
            REST,
            ("right",),
            "let go of 'right', then press 'right' to move",
        ),
        (POSE_CLUTCH, Arming.DISARMED, FORWARD, (), "press 'right' to move"),
        (
            CLUTCHES,
            Arming.DISARMED,
            REST,
            (),
            "press 'right', with 'left' or 'up' held, to move",
        ),
    ],
)
def test_how_to_go_on_is_reported(options, arming, axes, held, words):
    asked = Asked(options)
    assert asked.source.advice("why; ", arming) == "why; "  # no state of the device has been read
    asked.tick(axes, *held, input_ignored=True)
    assert asked.source.advice("why; ", arming) == f"why; {words}"


@pytest.mark.parametrize(
    ("options", "masked", "words"),
    [
        (DEADMAN, ("left",), "let go of 'left', then press 'left' to move"),
        (DEADMAN, ("right",), "press 'left' to move"),
        (
            TWO,
            ("left", "right"),
            "let go of 'left' and 'right', then press 'left' or 'right' to move",
        ),
        (CLUTCH, ("right",), "let go of 'right', then press 'right' to move"),
        (
            CLUTCHES,
            ("up",),
            "let go of 'up', then press 'right', with 'left' or 'up' held, to move",
        ),
        (
            CLUTCHES,
            ("right", "up"),
            "let go of 'right' and 'up', then press 'right', with 'left' or 'up' held, to move",
        ),
    ],
)
def test_a_button_from_before_the_device_counted_is_to_be_let_go_of(options, masked, words):
    asked = Asked(options)
    assert not asked.tick(masked=masked).armed
    arming = asked.arming if options.clutch else Arming.RELEASED
    assert asked.arming is arming
    assert asked.source.advice("", arming) == words


def test_a_reason_that_is_the_device_s_own_is_reported_once():
    asked = Asked()
    asked.tick(link=DeviceLink.LOST)
    assert asked.source.advice("", Arming.DISARMED) == "the device is lost"
    assert asked.source.advice("held; ", Arming.DISARMED) == "held; the device is lost"
    assert asked.source.advice("the device is lost; ", Arming.DISARMED) == "the device is lost"
    reported = DeviceState(1.0, DeviceLink.LOST, REST, frozenset(), reason="unplugged")
    assert asked.source._fault(reported, 1.0, False) == "unplugged"


def test_a_refusal_is_reported_in_place_of_why():
    asked = Asked(CLUTCH).seen()
    asked.tick(FORWARD, "right", events=[press()])
    asked.tick(REST)
    words = "the clutch was not engaged: the device is not at rest; press 'right' to move"
    assert asked.source.advice("why; ", Arming.DISARMED) == words


@pytest.mark.parametrize(
    ("options", "act"),
    [
        (BARE, "move the device and let it go"),
        (TWO, "let go of 'left' or 'right', then press it"),
        (BOTH, "press 'right'"),
    ],
)
def test_the_act_is_an_instruction(options, act):
    asked = Asked(options)
    assert asked.source.rearming_instruction() == act
    asked.tick()
    assert asked.source.rearming_instruction() == act
    asked.tick(link=DeviceLink.LOST)
    assert (
        asked.source.rearming_instruction()
        == f"wait for the device (the device is lost), then {act}"
    )


def test_the_act_with_a_clutch_from_before_the_device_counted_begins_with_its_release():
    asked = Asked(CLUTCH)
    asked.tick(masked=("right",))
    assert asked.source.rearming_instruction() == "let go of 'right', then press it"


def test_no_request_asks_for_nothing():
    assert tuple(NO_REQUEST) == (
        Arming.DISARMED, False, False, False, ZERO_TWIST, {}, False, False, "", ""
    )  # fmt: skip
