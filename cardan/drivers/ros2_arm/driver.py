"""Driver of ROS 2 arms: a session without I/O, and the node around it."""

from __future__ import annotations

import math
from typing import ClassVar

from cardan.drivers.datagram_robot import BRAKE_WITHIN_S, DatagramRobot
from cardan.drivers.node_options import SIMULATED
from cardan.drivers.ros2_arm.options import Ros2ArmOptions
from cardan.drivers.ros2_arm.session import LIVING_S, Ros2ArmSession
from cardan.drivers.ros2_arm.transport import DESCRIPTION_TIMEOUT_S, TRANSPORTS, Ros2Transport
from cardan.errors import ConfigurationError, DriverError
from cardan.robots import limits_in
from cardan.types import JointLimits


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
    brakes_within_s = BRAKE_WITHIN_S
    no_final_command_after_s = math.inf
    """False: the publisher of the joint states is not the controller."""

    def cautions(self) -> tuple[str, ...]:
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
                f"no node published a URDF on {topic} within {DESCRIPTION_TIMEOUT_S:g} s: start "
                "the robot's robot_state_publisher, or name the arm or its URDF as `robot`"
            )
        try:
            return limits_in(text, self.options.joints)
        except ConfigurationError as error:
            raise DriverError(f"{topic}: {error}") from None
