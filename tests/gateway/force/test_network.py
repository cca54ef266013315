"""Forces published by a program on the network, in virtual time."""

import math

import pytest

from cardan.common.haptics import WorldMap
from cardan.common.tables import read_table
from cardan.errors import ConfigurationError, OptionError
from cardan.gateway.bus.options import NetworkOptions
from cardan.gateway.force.conditioning import Conditioning
from cardan.gateway.force.lease import LEASE_S
from cardan.gateway.force.network import NetworkSource, PublishedFeedback
from cardan.gateway.session.config import ForceConfig, parse_config
from cardan.gateway.session.force_assembly import make_source
from cardan.types import Frame, Vector3
from tests.gateway.force.fakes import PERIOD_S, robot_state
from tests.gateway.force.test_rendering import SHIFTED, SPHERE, Bench

FORCE = Vector3(1.0, 0.0, 0.5)
TURNED = WorldMap(rotation=(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0))
"""Turns the device's x into the base's y."""


def test_one_publisher_at_a_time_gives_the_feedback():
    feedback = PublishedFeedback(0.1)
    assert feedback.give(1, 1, FORCE, 1.0) == ""
    assert "another publisher sends the feedback" in feedback.give(2, 1, FORCE, 1.05)
    assert feedback.give(1, 2, FORCE, 1.1) == ""
    assert feedback.give(2, 2, FORCE, 1.1 + 1.1 * LEASE_S) == ""
    assert "another publisher" in feedback.give(1, 3, FORCE, 1.2 + 1.1 * LEASE_S)
    assert feedback.diagnosis() == ("2 feedbacks refused: another publisher sent them",)


def test_after_a_stop_anybody_may_begin():
    feedback = PublishedFeedback(0.1)
    feedback.give(1, 1, FORCE, 1.0)
    feedback.stop()
    assert feedback.stopped
    assert feedback.fresh(1.0) is None
    assert feedback.give(2, 1, FORCE, 1.01) == ""
    assert not feedback.stopped
    assert feedback.fresh(1.02) == FORCE


@pytest.mark.parametrize("bad", [math.nan, math.inf, 2000.0])
def test_what_is_no_force_is_refused(bad):
    feedback = PublishedFeedback(0.1)
    assert "is not finite, or above 1000" in feedback.give(1, 1, Vector3(0.0, bad, 0.0), 1.0)
    assert feedback.newest is None


def test_a_message_that_comes_twice_or_late_does_not_keep_a_force_alive():
    feedback = PublishedFeedback(0.1)
    feedback.give(1, 5, FORCE, 1.0)
    for now_s in (1.05, 1.1, 1.15):
        feedback.give(1, 4, Vector3(0.0, 0.0, 3.0), now_s)
        feedback.give(1, 5, FORCE, now_s)
    assert feedback.fresh(1.15) is None
    assert feedback.diagnosis() == ("6 feedbacks dropped: they came twice, or out of order",)


def test_a_force_is_read_along_the_axes_of_the_base():
    source = NetworkSource(0.1)
    state = robot_state(1.0)
    source.publish(state, None, TURNED, 1.0)
    assert source.read(state, None) is None
    assert source.diagnosis() == (
        "no measured force: no node has published a feedback for the hand",
    )
    source.feedback.give(1, 1, FORCE, 1.0)
    reading = source.read(state, None)
    assert reading.force == pytest.approx((0.0, 1.0, 0.5))
    assert (reading.stamp_s, reading.frame) == (1.0, Frame.BASE)
    assert source.diagnosis() == ()
    source.publish(state, None, None, 1.0)  # While clutched out, no device pose defines a rotation.
    assert source.read(state, None).force == (0.0, 0.0, 0.0)
    source.feedback.stop()
    assert source.read(robot_state(2.0), None) == (2.0, (0.0, 0.0, 0.0), Frame.BASE)


class Session(Bench):
    """A session's renderer, with a program that publishes at 100 Hz."""

    def __init__(self, **options):
        self.source = NetworkSource(0.1)
        conditioning = Conditioning(tare=False)
        super().__init__(source=self.source, conditioning=conditioning, shaped=True, **options)
        self.sent = 0

    def publish(self, seconds, force=FORCE, world=SHIFTED):
        said = ""
        for cycle in range(round(seconds / PERIOD_S)):
            if cycle % 3 == 0:
                self.sent += 1
                assert self.source.feedback.give(1, self.sent, force, self.now_s) == ""
            said = said or self.ended(world)
        return said

    def ended(self, world=SHIFTED):
        self.now_s += PERIOD_S
        state = robot_state(self.now_s)
        looked = self.device.state()._replace(pose=self.device.pose, stamp_s=self.now_s)
        return self.renderer.cycle(state, looked, world, True)

    @property
    def rendered(self):
        measured = self.device.commands[-1].measured
        return None if measured is None else measured.force


def test_a_session_fades_the_force_in_and_keeps_it():
    session = Session()
    session.publish(1.0, world=None)
    assert session.rendered is None
    assert session.publish(0.1) == ""
    assert 0.0 < session.rendered.x < 0.4
    assert session.publish(1.0) == ""
    assert session.rendered == pytest.approx(FORCE, abs=1e-3)


def test_a_stream_that_falls_silent_has_the_session_let_go_by_its_own_rules():
    session = Session()
    session.publish(1.0)
    silent_s, said = session.now_s, ""
    while not said:
        said = session.ended()
        assert session.now_s - silent_s < 1.0
        if session.now_s - silent_s > 0.1 + 3 * PERIOD_S:
            assert session.rendered is None
    assert "the measured force is lost" in said
    assert 0.1 < session.now_s - silent_s < 0.25


def test_a_stop_fades_the_force_and_the_session_goes_on():
    session = Session()
    session.publish(1.0)
    session.source.feedback.stop()
    for _ in range(250):
        assert session.ended() == ""
    assert session.rendered == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert session.publish(1.0) == ""
    assert session.rendered == pytest.approx(FORCE, abs=1e-3)


def test_fixtures_and_the_network_are_felt_together():
    session = Session(fixtures=[SPHERE])
    session.publish(1.0)
    command = session.device.commands[-1]
    assert len(command.fixtures) == 1
    assert command.measured is not None


HAPTIC_SESSION = {
    "device": {"driver": "omni"},
    "robot": {"driver": "sim_arm", "robot": "ur5"},
    "mapping": {"mode": "position", "clutch": "button_2"},
    "force": {"source": "network"},
}


def test_a_session_takes_forces_only_where_programs_can_publish_them():
    made = parse_config(HAPTIC_SESSION | {"network": {"device": True}})
    assert isinstance(make_source(made.force), NetworkSource)
    for network in (None, {}, {"device": True, "commands": False}):
        tables = HAPTIC_SESSION | ({} if network is None else {"network": network})
        with pytest.raises(ConfigurationError, match=r"force\.source: .*device = true"):
            parse_config(tables)


def test_a_force_node_has_a_source_of_its_own():
    with pytest.raises(ConfigurationError, match='"network" is the session\'s'):
        read_table(ForceConfig, {"force": {"source": "network"}})


def test_the_nodes_of_arm_and_device_have_two_names():
    with pytest.raises(OptionError, match="another name than `name`"):
        NetworkOptions(name="omni", haptic="omni")
    with pytest.raises(OptionError, match="haptic"):
        NetworkOptions(haptic="my/omni")
