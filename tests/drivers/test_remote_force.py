"""Force feedback to a device on another computer, in virtual time: messages, and both ends."""

import itertools
import math

import pytest

from cardan.common.haptics import (
    Box,
    Cylinder,
    HapticCommand,
    HapticState,
    MeasuredForce,
    OperatingState,
    Plane,
    Sphere,
    Spring,
    Viscous,
    WorldMap,
)
from cardan.drivers.haptic import HapticDevice
from cardan.drivers.remote import Remote
from cardan.drivers.remote.shared import (
    CLAIM_TYPE,
    STATE_TYPE,
    Claim,
    HapticFeedback,
    RemoteHapticCommand,
    Shared,
    UnusableError,
    claim_message,
    read_claim,
    read_shared,
    shared_message,
)
from cardan.errors import CommandError, DriverError, NotOpenError
from cardan.gateway.force.passive import FADE_S, HOLD_S
from cardan.protocols.ros2.cdr import codec_of
from cardan.types import (
    IDENTITY,
    NEUTRAL,
    NEVER_S,
    ZERO3,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
    Pose,
    Vector3,
)
from tests.drivers.remote_bench import Bench, Link
from tests.gateway.force.fakes import FakeHaptic

UP = Vector3(0.0, 0.0, 1.0)
TURNED = (0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
FIXTURES = (
    Sphere(UP, 0.1, 300.0, 2.0, 1.0, True),
    Plane(ZERO3, UP, 400.0),
    Box(UP, Vector3(0.1, 0.2, 0.3), 500.0, rotation=TURNED),
    Cylinder(ZERO3, UP, 0.2, 100.0, inside=True),
    Spring(UP, 50.0, 1.5, 0.2),
    Viscous(3.0),
)
COMMAND = HapticCommand(
    17,
    NEVER_S,
    True,
    WorldMap(TURNED, Vector3(0.4, 0.0, 0.3), TURNED),
    FIXTURES,
    MeasuredForce(Vector3(0.1, 0.2, 0.3), NEVER_S, absorbed_j=0.004),
    Vector3(0.0, 0.1, 0.0),
    0.5,
)
PRESSED = HapticCommand(1, 0.0, True, measured=MeasuredForce(Vector3(0.0, 0.0, 1.0), 0.0))
HAPTIC_FEEDBACK = HapticFeedback(
    HapticState(
        state=OperatingState.PAUSED,
        reason="commands stopped",
        force=Vector3(0.0, 0.0, 0.5),
        force_commanded=UP,
        rendering=True,
        peak_n=1.2,
        energy_j=0.003,
        delivered_j=-0.001,
        given_peak_j=0.004,
        passivity_damping_n_s_m=0.5,
        thermal_derating=0.7,
        command_sequence=16,
        force_age_s=math.inf,
        faults=3,
    ),
    2.0,
)


def over(kind, message):
    codec = codec_of(kind)
    return codec.decode(codec.encode(message))


def claim(command=COMMAND):
    order = RemoteHapticCommand(command, 12.5)
    return Claim(7, "arm", 1.0, True, 0, DeviceFeedback(), order)


def test_what_the_hand_is_to_feel_and_feels_arrives_as_it_was_sent():
    for sent in (claim(), claim(COMMAND._replace(measured=None))):
        assert read_claim(over(CLAIM_TYPE, claim_message(sent))) == sent
    state = DeviceState(0.5, DeviceLink.LIVE, NEUTRAL, frozenset())
    shared = Shared(11, 1.0, 7, "arm", 0.9, state, haptic_feedback=HAPTIC_FEEDBACK)
    assert read_shared(over(STATE_TYPE, shared_message(shared))).haptic_feedback == HAPTIC_FEEDBACK


@pytest.mark.parametrize(
    ("change", "words"),
    {
        "NaN force": ({"force": {"x": math.nan, "y": 0.0, "z": 0.0}}, "a force that are no"),
        "map": ({"linear": [math.inf] * 9}, "a map that are not numbers"),
        "energy": ({"absorbed": -1.0}, "a negative energy"),
        "scale": ({"force_scale": 2.0}, "beyond 0 to 1"),
        "shape": ({"fixtures": [{"shape": "Cone", "values": []}]}, "a fixture 'Cone'"),
        "short": ({"fixtures": [{"shape": "Viscous", "values": [1.0]}]}, "too few or too many"),
        "many": ({"fixtures": [{"shape": "Viscous", "values": [1.0, 1.0]}] * 9}, "more than 8"),
        "answers": ({"answers": math.nan}, "an invalid time answers"),
    }.values(),
)
def test_forces_that_mean_nothing_are_refused(change, words):
    message = claim_message(claim())
    with pytest.raises(UnusableError, match=words):
        read_claim(message | {"force": [message["force"][0] | change]})


# -- both ends ------------------------------------------------------------------------------------


class StillHand(FakeHaptic):
    """Device that stands still and measures exactly the commanded force."""

    def __init__(self):
        super().__init__()
        self.haptic_state = self.haptic_state._replace(pose=Pose(ZERO3, IDENTITY))

    @property
    def force_n(self):
        command = self.commands[-1] if self.commands else HapticCommand(0, 0.0)
        return command.measured.force.z if command.engaged and command.measured else 0.0


def pressed(link=None, **options):
    """Return a bench whose device renders 1 N from the remote session."""
    bench = Bench(link or Link(), haptic=StillHand(), **options).live()
    bench.command = PRESSED
    bench.run(1.0)
    assert bench.haptic.force_n == pytest.approx(1.0)
    return bench


@pytest.mark.parametrize("delay_s", [0.0003, 0.05, 0.2])
def test_a_force_goes_the_way_that_the_motion_came(delay_s):
    bench = pressed(Link(delay_s, 0.1 * delay_s, loss=0.05), max_age_s=0.5)
    assert bench.haptic.calls == ["enable"]
    haptic_state = bench.core.haptic_feedback.state
    assert (haptic_state.state, haptic_state.rendering, haptic_state.command_sequence) == (
        OperatingState.ENABLED,
        True,
        1,
    )
    assert bench.core.haptic_feedback.largest_n == 3.0


def test_fixtures_are_rendered_beside_the_hand_by_the_maps_of_the_session():
    bench = pressed()
    bench.command = COMMAND
    bench.run(0.3)
    given = bench.haptic.commands[-1]
    assert (given.fixtures, given.world, given.force_scale) == (FIXTURES, COMMAND.world, 0.5)
    assert bench.there_s - given.stamp_s <= 0.004 + 1e-9
    assert given.measured.force == pytest.approx((0.1, 0.3, 0.3))
    assert given.force == ZERO3


def silent(bench):
    bench.up.cut = bench.down.cut = True


def one_way(bench):
    bench.up.cut = True


def killed(bench):
    bench.core.claim = lambda *_: None


def stalled(bench):
    bench.up.stall(bench.now_s + 0.5)


@pytest.mark.parametrize("happens", [silent, one_way, killed, stalled])
def test_silence_lets_a_force_fade_within_a_fifth_of_a_second(happens):
    bench = pressed()
    forces = []
    happens(bench)
    bench.run(0.45, lambda: forces.append(bench.haptic.force_n))
    steps = [before - after for before, after in itertools.pairwise(forces)]
    assert max(steps) <= 0.004 / FADE_S + 0.01, "the force fades"
    assert not any(forces[round((HOLD_S + FADE_S + 0.008) / 0.002) :])


def test_after_a_stall_the_force_comes_back_slowly():
    bench = pressed()
    stalled(bench)
    bench.run(0.5)
    assert bench.haptic.force_n == 0.0
    forces = []
    bench.run(0.3, lambda: forces.append(bench.haptic.force_n))
    steps = [after - before for before, after in itertools.pairwise(forces)]
    assert max(steps) <= 0.004 / FADE_S + 0.01
    assert forces[-1] == pytest.approx(1.0)
    assert bench.haptic.calls == ["enable"], "it is the same engagement"


def test_a_device_that_is_given_back_feels_nothing_at_once():
    bench = pressed()
    bench.up.send(bench.claimed(bench.core.final_claim(bench.now_s)), bench.now_s)
    bench.core.claim = lambda *_: None
    bench.run(0.01)
    assert not bench.haptic.commands[-1].engaged
    assert bench.share.lessee(bench.there_s) == ""


def test_a_clutch_out_ends_the_force_at_once():
    bench = pressed()
    bench.command = PRESSED._replace(sequence=2, engaged=False)
    bench.run(0.05)
    assert not bench.haptic.commands[-1].engaged


def test_another_lease_is_another_engagement_though_it_came_while_this_end_stood_still():
    bench = pressed()
    before = bench.force_end._port
    assert before is not None
    order, heard_s, lease = bench.share.order(bench.there_s)
    haptic_state = len(bench.haptic.commands)
    bench.force_end.cycle(order, heard_s, lease + 1, bench.there_s + 0.02)
    assert [each.engaged for each in bench.haptic.commands[haptic_state:]][:1] == [False]
    assert bench.force_end._port is not before


def test_an_answer_to_what_the_hand_has_not_done_yet_is_none():
    bench = pressed()
    claims = bench.core.claim

    def lying(*values):
        made = claims(*values)
        return made and made._replace(order=made.order._replace(answers_s=bench.there_s + 1.0))

    bench.core.claim = lying
    bench.run(0.05)
    assert not bench.haptic.commands[-1].engaged


def test_what_the_device_refuses_is_reported_at_the_arm():
    bench = Bench(haptic=StillHand()).live()
    bench.haptic.obstacle = "the stylus is in its inkwell"
    bench.command = PRESSED
    bench.run(0.3)
    haptic_state = bench.core.haptic_feedback.state
    assert "the stylus is in its inkwell" in haptic_state.reason
    assert (haptic_state.state, haptic_state.rendering) == (OperatingState.DISABLED, False)
    bench.haptic.obstacle = ""
    bench.run(0.3)
    assert bench.core.haptic_feedback.state.rendering


# -- the driver -----------------------------------------------------------------------------------


def driver(bench):
    device = Remote(force=True, device="x")
    device._core = bench.core
    device._check_open = lambda _what: None
    return device


def test_only_with_force_it_is_a_haptic_device():
    assert not isinstance(Remote(), HapticDevice)
    assert isinstance(Remote(force=True), HapticDevice)
    assert isinstance(Remote(Remote.Options(force=True)), HapticDevice)


def test_without_a_state_it_has_neither_a_position_nor_a_force(monkeypatch):
    device = Remote(force=True, device="x")
    assert device.feedback_limits.force_n == 0.0
    with pytest.raises(NotOpenError, match="no position to give"):
        device.measured_pose()
    waiting = DeviceState(0.0, DeviceLink.STALE, NEUTRAL, frozenset(), reason="silent")
    monkeypatch.setattr(device, "state", lambda: waiting)
    with pytest.raises(DriverError, match="silent") as refusal:
        device.measured_pose()
    assert not isinstance(refusal.value, NotOpenError)


def test_a_closed_one_cannot_be_enabled():
    with pytest.raises(NotOpenError):
        Remote(force=True).enable()


def test_nothing_is_let_out_before_it_is_enabled_and_after_it_is_not(monkeypatch):
    bench = pressed()
    device = driver(bench)
    monkeypatch.setattr("cardan.drivers.remote.device.time.monotonic", lambda: bench.now_s)
    assert device.haptics().state is OperatingState.DISABLED
    device.render(PRESSED)
    assert not device._command.engaged
    device.enable()
    device.render(PRESSED)
    assert device._command == PRESSED
    assert device.haptics().state is OperatingState.ENABLED
    assert device.haptics().rendering
    assert device.feedback_limits.force_n == 3.0
    device.pause()
    assert not device._command.engaged
    device.resume()
    device.render(PRESSED)
    assert device._command.engaged
    silent(bench)
    bench.run(0.3)
    haptic_state = device.haptics()
    assert not haptic_state.rendering
    assert "max_age_s" in haptic_state.reason


def test_a_command_that_means_nothing_changes_nothing():
    device = driver(Bench())
    device.enable()
    device.render(PRESSED)
    for bad in (
        PRESSED._replace(force=Vector3(math.nan, 0.0, 0.0)),
        PRESSED._replace(fixtures=(Viscous(1.0),) * 9),
        PRESSED._replace(joint_torques_n_m=ZERO3),
    ):
        with pytest.raises(CommandError):
            device.render(bad)
    assert device._command == PRESSED
