"""Options of the driver of ROS 2 arms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.bus.dds_options import DdsOptions
from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import require
from cardan.drivers.node_options import NodeOptions, require_name
from cardan.robots import load_arm
from cardan.types import JointLimits

SILENT_PERIODS = 3
"""Missed states after which the link is LOST; fewer are network jitter."""

STATE_RATE_HZ = Range(10.0, 2000.0, "Hz", "slower, three states are a third of a second")

Commands = Literal["position", "velocity", "joint_state", "trajectory"]

COMMAND_TOPICS: dict[str, str] = {
    "position": "/forward_position_controller/commands",
    "velocity": "/forward_velocity_controller/commands",
    "joint_state": "/robot_joint_command",
    "trajectory": "/joint_trajectory_controller/joint_trajectory",
}
"""Default topics by command kind: those of ros2_control's examples and most robots."""


@dataclass(frozen=True, kw_only=True)
class Ros2ArmOptions(NodeOptions):
    """Options of :class:`Ros2Arm`."""

    robot: Annotated[str, bounds.ARM_FILE] = "ur5"
    """An arm's name, or the path of a .toml or .urdf file, for names and limits of the joints.
    Empty: names are from `joints`, limits from `robot_description`."""
    joints: tuple[str, ...] = ()
    """Names of the joints on ROS 2 in kinematic order if they differ from those of `robot`, for
    instance by a prefix ("left_shoulder_pan_joint"); empty: as in `robot`."""
    transport: Literal["zenoh", "dds"] = "zenoh"
    """Middleware of the robot's nodes by their RMW_IMPLEMENTATION: zenoh: rmw_zenoh_cpp; dds:
    rmw_cyclonedds_cpp or rmw_fastrtps_cpp, which needs the plug-in cardan-dds."""
    dds_config: Annotated[str, bounds.DDS_CONFIG] = ""
    """For dds: configuration of Cyclone DDS, XML or file://PATH. Empty: CYCLONEDDS_URI if set,
    otherwise this computer only."""
    states_topic: str = "/joint_states"
    """Topic of sensor_msgs/JointState, published by the joint_state_broadcaster."""
    command: Commands = "position"
    """position, velocity: the array of a forward_command_controller with that interface;
    joint_state: a JointState with positions and speeds; trajectory: a JointTrajectory of one point
    for each state, which a joint_trajectory_controller follows with a delay (see the page)."""
    command_topic: str = ""
    """Topic of commands; empty: by `command`, such as that of `forward_position_controller`."""
    description_topic: str = "/robot_description"
    """Topic of the robot's URDF; needed if `robot` is empty."""
    rate_hz: Annotated[float, STATE_RATE_HZ] = 100.0
    """Rate at which the robot publishes joint states: the controller manager's update_rate."""
    silence_s: Annotated[float, bounds.BLIND_S] = 0.1
    """Silence (at least three periods) after which the link is LOST."""
    simulated_time: bool = False
    """The controller is a simulation (Gazebo) whose time may pass faster or slower than this
    computer's: no difference in speed is a fault. The arm is never faster than commanded, and
    slower if the simulation is."""
    lag_s: Annotated[float, bounds.LAG_S] = 0.1
    """Normal lag of the measured joints behind the commanded ones."""
    name: str = "cardan_arm_driver"
    """Name of this driver's node."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require(
            self.transport == "zenoh" or not self.port,
            "port",
            self.port,
            "0, since nodes on DDS discover each other by their domain",
        )
        for key in ("states_topic", "command_topic", "description_topic", "name"):
            given = getattr(self, key)
            if key == "command_topic" and not given:
                continue
            require_name(key, given, f"/{given}" if key == "name" else given)
        joints = self.joints
        unique = len(set(joints)) == len(joints) and all(joints)
        require(unique, "joints", joints, "a name of its own for each joint")
        if self.robot:
            count = len(load_arm(self.robot, "robot").joints)
            good = len(joints) in (0, count)
            require(good, "joints", joints, f"{count} names, as {self.robot} has, or none")
        else:
            require(bool(joints), "joints", joints, "names of the joints, because robot is empty")

    @property
    def caution(self) -> str:
        """Warning about a disadvantage of `command`; empty if it has none."""
        if self.command == "trajectory":
            return (
                "command = 'trajectory' sends single points, each of which replaces the one "
                "before, so the arm follows late and less evenly: load a "
                "forward_position_controller, and set command = 'position'"
            )
        if self.command == "velocity":
            return (
                "command = 'velocity': a forward velocity controller keeps the last speed when "
                "this process dies; have the robot watch its commands, or set command = 'position'"
            )
        return ""

    @property
    def dds(self) -> DdsOptions:
        """Options of the DDS connection."""
        return DdsOptions(
            dds_domain=self.domain,
            dds_config=self.dds_config,
            dds_distribution="humble" if self.distribution == "humble" else "iron and later",
        )

    @property
    def period_s(self) -> float:
        """Period of the joint states."""
        return 1.0 / self.rate_hz

    @property
    def topic(self) -> str:
        """Topic of the commands."""
        return self.command_topic or COMMAND_TOPICS[self.command]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints on ROS 2 in kinematic order."""
        return self.joints or load_arm(self.robot).joint_names

    @property
    def limits(self) -> JointLimits | None:
        """Limits of `robot`; None if it is empty."""
        return load_arm(self.robot).limits if self.robot else None

    @property
    def lost_after_s(self) -> float:
        """Silence after which the link is LOST, s."""
        return max(self.silence_s, SILENT_PERIODS * self.period_s)
