"""The suite of an arm's action server of FollowJointTrajectory."""

from __future__ import annotations

from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, SuiteTransport
from cardan.conform.transports import Wires
from cardan.errors import ConfigurationError
from cardan.protocols.ros2.names import RosNameError, checked_name
from cardan_conform_arms.joint_trajectory.decoded import TrajectoryTraffic
from cardan_conform_arms.joint_trajectory.faults import FAULTS
from cardan_conform_arms.joint_trajectory.names import ACTION, channels_of
from cardan_conform_arms.joint_trajectory.requirements import requires
from cardan_conform_arms.joint_trajectory.scenario import TrajectoryScenario


class JointTrajectory(Suite[TrajectoryTraffic]):
    """Servers that execute MoveIt's plans: joint_trajectory_controller or a session of Cardan."""

    name = "joint-trajectory"
    judges = "the server"
    speaks = "the ROS 2 action of joint trajectories on rmw_zenoh"
    target = (
        "ROUTER, ROUTER,ACTION or, where more joints are published than the controller moves, "
        "ROUTER,ACTION,JOINT,JOINT..; the Zenoh router as tcp/127.0.0.1:7447"
    )
    peer = "pr2_right_arm"
    levels = Level.MOVE
    requirements = requires.all()
    transport = SuiteTransport("other")
    decode = TrajectoryTraffic
    simulation = "cardan_conform_arms.joint_trajectory.simulated:ActionSimulation"
    own_faults = FAULTS
    seconds = 0.5

    def __init__(self) -> None:
        self._joints: tuple[str, ...] = ()

    def scenario(self, level: Level, seconds: float) -> TrajectoryScenario:
        return TrajectoryScenario(level, seconds, self._joints)

    def wires(self, target: str) -> Wires:
        # Zenoh is installed with the extra cardan[network].
        from cardan_conform_arms.ros2_arm.wire import RosWires

        router, action, *joints = [*target.split(","), ""][: max(2, target.count(",") + 1)]
        self._joints = tuple(joints)
        try:
            return RosWires(router, channels_of(checked_name(action or ACTION)))
        except RosNameError as error:
            raise ConfigurationError("--target", str(error)) from None
