"""The driver of ROS 2 arms: a session without I/O, and the node around it."""

from __future__ import annotations

from typing import ClassVar

from cardan.drivers.datagram_robot import DatagramRobot
from cardan.drivers.node_options import SIMULATED
from cardan.drivers.ros2_arm.options import Ros2ArmOptions
from cardan.drivers.ros2_arm.session import LIVING_S, Ros2ArmSession
from cardan.drivers.ros2_arm.transport import DESCRIPTION_TIMEOUT_S, TRANSPORTS, Ros2Transport
from cardan.errors import ConfigurationError, DriverError
from cardan.robots import limits_in
from cardan.types import HoldCommand, JointLimits

BRAKE_WITHIN_S = 1.0
"""Longest braking of a driver that is closed: no joint takes longer from its full speed."""


class Ros2Arm(DatagramRobot[Ros2ArmSession]):
    """An arm that ros2_control, or any node with its topics, controls.

    The arm's joint states are the clock. A driver that is closed while the arm moves brakes it.
    """

    Options: ClassVar[type[Ros2ArmOptions]] = Ros2ArmOptions
    summary = "any arm of a ROS 2 system (ros2_control)"
    page = "ros2-arm.md"
    peer = "ros2-arm"
    simulated = ({"transport": ("zenoh",), **SIMULATED[0]},)
    options: Ros2ArmOptions
    title = "the ROS 2 arm's driver"

    def cautions(self) -> tuple[str, ...]:
        """What speaks against the kind of command."""
        caution = self.options.caution
        return (caution,) if caution else ()

    def _make_session(self) -> Ros2ArmSession:
        return Ros2ArmSession(self.options)

    def _join(self) -> Ros2Transport:
        transport = TRANSPORTS[self.options.transport](self.options)
        try:
            if self.options.limits is None:
                self._session = Ros2ArmSession(self.options, self._described(transport))
        except BaseException:
            transport.close()
            raise
        session = self._session
        session.taken, session.named = transport.taken, transport.publisher
        session.listens_until_s = transport.now() + LIVING_S
        return transport

    def _described(self, transport: Ros2Transport) -> JointLimits:
        topic = self.options.description_topic
        text = transport.description()
        if not text:
            raise DriverError(
                f"nobody published a URDF on {topic} within {DESCRIPTION_TIMEOUT_S:g} s: start the "
                "robot's robot_state_publisher, or name the arm or its URDF as `robot`"
            )
        try:
            return limits_in(text, self.options.joints)
        except ConfigurationError as error:
            raise DriverError(f"{topic}: {error}") from None

    def _leave_within_s(self) -> float:
        return BRAKE_WITHIN_S + super()._leave_within_s()

    def _leave(self) -> None:
        """Brake by ramp while joint states come, then stop."""
        transport, session = self._joined(), self._session
        until_s = transport.now() + BRAKE_WITHIN_S
        while session.moving and transport.now() < until_s:
            found = [session.receive(data, transport.now()) for data in transport.wait()]
            if not any(found):
                break
            self._say(transport, session.command(HoldCommand(), transport.now()))
        self._owes_answer = False
        # However long the joint states are silent: their publisher is not the controller.
        self._say(transport, session.farewell(transport.now()))
