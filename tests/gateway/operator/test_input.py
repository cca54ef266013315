"""An operator device as a source of requests: the rule of arming, tick by tick."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.gateway.motion.reference import ReferenceLimits
from cardan.gateway.operator.arming import Arming
from cardan.gateway.operator.input import CLUTCH_WITHIN_S, NO_REQUEST, ArmView, OperatorInput
from cardan.gateway.operator.mapping import MappingOptions, Mode, TwistMapping
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
    """A source and its arm, which takes whatever request is armed."""

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
        self, axes=REST, *buttons, events=(), link=DeviceLink.LIVE, age_s=0.0, pose=None, **view
    ):
        self.now_s += DT_S
        device = DeviceState(self.now_s - age_s, link, axes, frozenset(buttons), pose)
        robot = RobotState(self.now_s, RobotLink.LIVE, 1, 0, DT_S, (), (), IDENTITY_POSE, "")
        edges = [ButtonEvent(self.now_s - age, name, down) for name, down, age in events]
        known = {"arming": self.arming, "free": True}
        known |= {"tcp": IDENTITY_POSE, "resting": IDENTITY_POSE}
        self.request = self.source.request(device, edges, ArmView(robot, DT_S, **{**known, **view}))
        self.arming = self.request.arming
        return self.request

    def arm(self):
        self.tick()
        assert self.tick(REST, "left").engages
        return self

    @property
    def advice(self):
        return self.source.advice("", self.arming)


# -- the deliberate act --------------------------------------------------------------------------


def test_the_act_is_the_dead_man_pressed_after_device_and_dead_man_were_at_rest():
    asked = Asked()
    assert not asked.tick().acts
    assert "press 'left' to move" in asked.advice
    request = asked.tick(REST, "left")
    assert request.acts
    assert request.engages
    assert request.armed
    assert request.following
    assert not request.asks
    request = asked.tick(FORWARD, "left")
    assert not request.engages
    assert request.asks
    assert request.twist.linear.x > 0.0


@pytest.mark.parametrize("before", [(REST, "left"), (FORWARD,), (FORWARD, "left")])
def test_a_dead_man_or_a_deflection_from_before_is_no_act(before):
    asked = Asked()
    asked.tick(*before)
    assert not asked.tick(FORWARD, "left").acts
    assert asked.advice == "let go of the device and of 'left', then press 'left' to go on"


@pytest.mark.parametrize("age_s", [0.2, -0.2])
def test_a_deflection_that_may_drive_no_motion_is_no_act(age_s):
    asked = Asked()
    asked.tick()
    request = asked.tick(FORWARD, "left", age_s=age_s)
    assert not request.acts
    assert not request.asks
    asked.arm()


def test_an_act_that_is_barred_is_seen_and_has_to_be_made_anew():
    asked = Asked()
    asked.tick()
    request = asked.tick(REST, "left", barred="somebody else has the arm")
    assert request.acts
    assert not request.armed
    assert not asked.tick(REST, "left").acts
    asked.arm()


def test_nothing_counts_while_the_robot_is_not_ready():
    asked = Asked()
    asked.tick(void=True)
    assert not asked.tick(REST, "left").acts
    asked.tick()
    assert not asked.tick(REST, "left", void=True).acts
    assert not asked.tick(REST, "left").acts
    asked.arm()


def test_disarming_takes_away_what_was_held():
    asked = Asked().arm()
    asked.disarm()
    assert not asked.tick(REST, "left").acts
    asked.arm()


def test_without_a_dead_man_rest_arms_and_a_barred_one_takes_a_move_and_rest():
    asked = Asked(BARE)
    assert not asked.tick(FORWARD).armed
    assert asked.tick(REST).engages
    assert asked.tick(FORWARD).asks
    asked = Asked(BARE)
    assert not asked.tick(REST, barred="held").acts
    assert not asked.tick(FORWARD, barred="held").acts
    request = asked.tick(REST, barred="held")
    assert request.acts
    assert not request.engages
    assert asked.source.act_words() == "move the device and let it go"
    assert not asked.tick(REST, barred="held").acts  # Staying at rest is no further act.
    assert not asked.tick(FORWARD, barred="held").acts
    assert asked.tick(REST, barred="held").acts


@pytest.mark.parametrize("options", [DEADMAN, CLUTCH, BARE])
def test_the_act_begins_with_a_device_that_is_there(options):
    asked = Asked(options)
    asked.tick()
    act = asked.source.act_words()
    asked.tick(link=DeviceLink.LOST)
    assert asked.source.act_words() == f"wait for the device (the device is lost), then {act}"


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
    asked = Asked(CLUTCH)
    asked.tick()
    request = asked.tick(REST, "right", events=[press()])
    assert request.engages
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
    asked = Asked(CLUTCH)
    asked.tick()
    asked.tick(tick.pop("axes", REST), "right", **tick)
    assert not asked.armed
    asked.tick(REST)
    assert words in asked.advice


@pytest.mark.parametrize("tick", [{"barred": "no"}, {"tripped": True}, {"void": True}])
def test_a_press_at_a_bad_moment_begins_nothing_and_nothing_later(tick):
    asked = Asked(CLUTCH)
    asked.tick()
    request = asked.tick(REST, "right", events=[press()], **tick)
    assert request.acts is ("barred" in tick)
    assert not request.armed
    assert not asked.tick(REST, "right").armed
    asked.tick(REST, events=[RELEASE])
    assert asked.tick(REST, "right", events=[press()]).engages


# -- faults --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("axes", "tick", "words"),
    [
        (REST, {"link": DeviceLink.LOST}, "the device is lost"),
        ((math.nan, 0.0, 0.0, 0.0, 0.0, 0.0), {}, "not numbers"),
        (FORWARD, {"age_s": 0.11}, "deflected but silent for 0.11 s"),
        (REST, {"age_s": -0.2}, "0.2 s in the future"),
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
    assert asked.tick(REST, "left", pose=HAND).engages
    assert "gives no pose" in asked.tick(REST, "left").fault
    asked.tick(pose=HAND)
    asked.tick(REST, "left")
    assert not asked.armed
    assert "the clutch was not engaged: the device gives no pose" in asked.advice


def test_only_an_armed_hand_has_faults():
    asked = Asked()
    assert asked.tick(FORWARD, link=DeviceLink.LOST).fault == ""


# -- whatever the operator does ------------------------------------------------------------------

ticks = st.lists(
    st.tuples(
        st.sampled_from((REST, REST, FORWARD, (math.nan, *REST[1:]))),
        st.booleans(),
        st.sampled_from((DeviceLink.LIVE,) * 5 + (DeviceLink.LOST,)),
        st.sampled_from((0.0, 0.0, 0.2)),
        st.sampled_from(("", "", "barred", "void", "unfree", "suspended")),
    ),
    max_size=40,
)


@given(ticks)
def test_nothing_is_asked_for_but_by_an_armed_live_hand_with_its_dead_man_held(plan):
    asked, rested = Asked(), False
    for axes, held, link, age_s, trouble in plan:
        view = {
            "barred": "no" if trouble == "barred" and not asked.armed else "",
            "void": trouble == "void",
            "free": trouble != "unfree",
            "suspended": trouble == "suspended",
        }
        was_armed = asked.armed
        if trouble == "void":
            asked.disarm()  # The controller has, before it asks.
            was_armed = False
        request = asked.tick(axes, *(("left",) if held else ()), link=link, age_s=age_s, **view)
        if request.asks or request.following:
            assert request.armed
            assert held
            assert link is DeviceLink.LIVE
            assert math.isfinite(request.twist.linear.x)
            assert not view["void"]
            assert view["free"]
        if request.asks:
            assert age_s == 0.0
            assert trouble != "suspended"
        if request.engages:
            assert rested
            assert not was_armed
            assert view["barred"] == ""
        if request.armed:
            assert was_armed or request.engages
        # Whether device and dead-man were seen at rest since the last interruption.
        if trouble == "void" or request.fault or (held and view["barred"]):
            rested = False
        elif link is not DeviceLink.LIVE:
            rested = rested and was_armed
        elif not held and axes == REST:
            rested = True


def test_a_button_that_the_device_has_not_is_told_in_place_of_an_act_that_cannot_be():
    asked = Asked()
    asked.tick()
    asked.source.complaint = "mapping.deadman: the device has no button 'left'; it has: go"
    asked.tick()
    assert asked.advice == asked.source.complaint
    asked.tick(link=DeviceLink.LOST)
    assert asked.advice != asked.source.complaint


@pytest.mark.parametrize(
    ("linear", "angular", "rates", "asks"),
    [
        (0.0, 0.0, {}, False),
        (0.1, 0.0, {}, True),
        (0.0, -0.1, {}, True),
        (0.0, 0.0, {"a": 0.0, "b": 0.0}, False),
        (0.0, 0.0, {"a": 0.0, "b": -0.1}, True),
    ],
)
def test_motion_of_any_kind_is_asked_for(linear, angular, rates, asks):
    twist = Twist(Vector3(0.0, linear, 0.0), Vector3(0.0, 0.0, angular), ZERO_TWIST.frame)
    assert NO_REQUEST._replace(twist=twist, rates=rates).asks is asks
