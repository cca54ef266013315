"""A haptic device on the network without an arm, in virtual time."""

import pytest

from cardan.common.haptics import FeedbackLimits, OperatingState
from cardan.drivers.ihaptic import IHapticDevice
from cardan.errors import ConfigurationError
from cardan.gateway.force.lease import LEASE_S
from cardan.gateway.session.force_assembly import load_haptic
from cardan.gateway.session.haptic_session import PERIOD_S, LoneFeedback
from cardan.types import ZERO3, Vector3
from tests.gateway.force.fakes import FakeHaptic

MAX_AGE_S = 0.1
PUSH = Vector3(0.1, 0.0, 0.0)


class TorqueHaptic(FakeHaptic):
    feedback_limits = FeedbackLimits(3.0, 0.35)


class Bench:
    """A session with a device alone, in virtual time, and a program that publishes at 100 Hz."""

    def __init__(self, device=None, mode="cartesian"):
        self.device = device or TorqueHaptic()
        self.haptic = IHapticDevice(self.device, mode)
        self.feedback = LoneFeedback(self.device, self.haptic, MAX_AGE_S)
        self.now_s, self.sent = 1.0, 0

    def run(self, seconds, asked=None, publisher=1):
        """Run for a time; return the reply to the newest feedback."""
        said = ""
        for cycle in range(round(seconds / PERIOD_S)):
            self.now_s += PERIOD_S
            if asked is not None and cycle % 2 == 0:
                self.sent += 1
                said = self.feedback.give(publisher, self.sent, asked, self.now_s)
            self.feedback.cycle(self.now_s)
        return said

    @property
    def last(self):
        return self.device.commands[-1]


def test_nothing_is_enabled_or_commanded_before_the_first_feedback():
    bench = Bench()
    bench.run(1.0)
    assert bench.device.calls == []
    assert bench.device.commands == []
    assert bench.run(0.1, PUSH) == ""
    assert bench.device.calls == ["enable"]
    assert bench.last.engaged
    assert 0.0 < bench.last.force.x < 0.3 * PUSH.x
    bench.run(0.6, PUSH)
    assert bench.last.force == PUSH


def test_a_force_that_the_device_does_not_let_out_yet_stays_small():
    bench = Bench()
    bench.device.lets_out = False
    bench.run(1.0, PUSH)
    assert bench.last.force == ZERO3
    bench.device.lets_out = True
    bench.run(0.6, PUSH)
    assert bench.last.force == PUSH
    bench.run(1.0)
    bench.run(2 * PERIOD_S, PUSH)
    assert bench.last.force.x < 0.05 * PUSH.x


def test_a_stream_that_falls_silent_is_let_go_once_it_is_too_old():
    bench = Bench()
    bench.run(0.5, PUSH)
    bench.run(MAX_AGE_S - 3 * PERIOD_S)
    assert bench.last.engaged
    bench.run(4 * PERIOD_S)
    assert not bench.last.engaged
    count = len(bench.device.commands)
    bench.run(1.0)
    assert len(bench.device.commands) == count
    bench.run(0.1, PUSH)
    assert bench.last.engaged


def test_a_stop_ends_it_at_once_and_another_program_may_go_on():
    bench = Bench()
    bench.run(0.5, PUSH)
    assert "another publisher" in bench.run(PERIOD_S, PUSH, publisher=2)
    assert bench.feedback.stop() == ""
    assert not bench.last.engaged
    assert bench.run(0.1, PUSH, publisher=2) == ""
    assert bench.last.engaged


def test_after_a_fault_nothing_is_rendered_until_it_was_stopped_or_silent():
    bench = Bench()
    bench.run(0.5, PUSH)

    def fault():
        bench.device.haptic_state = bench.device.haptic_state._replace(
            state=OperatingState.FAULT,
            faults=bench.device.haptic_state.faults + 1,
            reason="it flew",
        )

    fault()
    words = bench.run(0.5, PUSH)
    assert words == "the force is lost: it flew; call stop_feedback, or be silent for 1 s"
    assert bench.feedback.diagnosis()[0] == "the force is lost: it flew"
    assert not bench.last.engaged
    assert bench.device.calls == ["enable"]
    bench.feedback.stop()
    assert bench.run(0.1, PUSH) == ""
    assert bench.device.calls == ["enable", "enable"]
    assert bench.last.engaged
    fault()
    bench.run(0.1, PUSH)
    assert not bench.last.engaged
    bench.run(1.1 * LEASE_S)
    assert bench.run(0.1, PUSH) == ""
    assert bench.last.engaged


def test_a_device_that_cannot_be_enabled_says_why():
    bench = Bench()
    bench.device.obstacle = "the stylus is in the inkwell"
    assert bench.run(0.2, PUSH) == "no force: the stylus is in the inkwell"
    bench.device.obstacle = ""
    assert bench.run(0.2, PUSH) == ""


def test_torques_are_in_newton_meters():
    bench = Bench(mode="joint")
    assert bench.run(0.6, Vector3(0.2, -0.1, 0.0)) == ""
    assert bench.last.joint_torques_n_m == (0.2, -0.1, 0.0)
    assert "the unit is N·m, not mN·m" in bench.run(PERIOD_S, Vector3(350.0, 0.0, 0.0))
    assert bench.last.joint_torques_n_m == (0.2, -0.1, 0.0)


def test_a_file_needs_a_device_that_gives_force(tmp_path):
    file = tmp_path / "mouse.toml"
    file.write_text('[device]\ndriver = "spacemouse"\n[robot]\ndriver = "anything"\n')
    with pytest.raises(ConfigurationError, match=r"device.driver: 'spacemouse' gives no force"):
        load_haptic(file)
