"""Options of a session on the bus: the table ``[network]``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from cardan.bus.options import BusOptions
from cardan.common.bounds import ANGULAR_SPEED_RAD_S, LINEAR_SPEED_M_S, Range
from cardan.errors import OptionError
from cardan.gateway.arm.status import OPERATOR
from cardan.gateway.bus.compatibility import NamesOf, ServoScales
from cardan.protocols.ros2.names import RosNameError, checked_name

DEFAULT_NAME = "cartesian_control_server_ros2"
"""Name of the arm's node: that of the paper's server."""

RATE_HZ = Range(0.1, 1000.0, "Hz", "slower is no state; no robot has faster cycles")


def is_topic(name: str) -> bool:
    """Return whether ROS 2 allows a topic of this name."""
    try:
        checked_name(name)
    except RosNameError:
        return False
    return True


@dataclass(frozen=True, kw_only=True)
class NetworkOptions(BusOptions):
    """``[network]`` of a session: topics and commands of its arm."""

    name: str = DEFAULT_NAME
    """Name of the node, and first part of the arm's own topics and services."""
    namespace: str = ""
    """Prefix of all names of this arm; empty: none. Needed if several arms are on one bus."""
    rate_hz: Annotated[float, RATE_HZ] = 50.0
    """Rate at which the state is published."""
    commands: bool = True
    """False: the arm is published on the network, and takes no commands from it."""
    device: bool = False
    """True: the session's operator device is published as `spacenav/*`, `joy` and, if it has
    inertial sensors, `imu/data_raw`; `joy/set_feedback` makes it rumble; a device with force
    feedback is also published as a haptic device."""
    haptic: str = "hapticDevice_nws_ros2"
    """Name of the haptic device's node, and first part of its topics and services."""
    endless_without_watch: bool = False
    """True: motions without end (movv, gcmp, forc) are accepted from any client, even if its
    disconnection cannot be detected; only a stop then ends them."""
    source: str = "ros2"
    """First word of the names of nodes in the arm's authority: "ros2 /joystick"."""
    trajectory_controller: str = "joint_trajectory_controller"
    """Name of the controller whose action follow_joint_trajectory the arm offers to MoveIt."""
    other_names: tuple[NamesOf, ...] = ("servo",)
    """Names of other software that the arm answers to: MoveIt Servo's, CRTK's, those of FZI's
    Cartesian controllers, cmd_vel, those of YARP's joint server."""
    servo: str = "servo_node"
    """Node name in MoveIt Servo's names."""
    servo_units: Literal["unitless", "speed"] = "unitless"
    """Units of MoveIt Servo's commands: shares, -1 to 1, of the speeds below; or m/s and rad/s."""
    servo_linear_m_s: Annotated[float, LINEAR_SPEED_M_S] = 0.4
    servo_angular_rad_s: Annotated[float, ANGULAR_SPEED_RAD_S] = 0.8
    servo_joint_rad_s: Annotated[float, ANGULAR_SPEED_RAD_S] = 0.5
    transforms: Literal["all", "tool", "none"] = "all"
    """Transforms on /tf and /tf_static: base to flange and flange to TCP; the latter alone, beside
    a robot_state_publisher; or none."""
    base_frame: str = "base_link"
    flange_frame: str = "tool0"
    tcp_frame: str = "tcp"

    def absolute(self, name: str) -> str:
        """Return the absolute name of a topic that the session's node calls `name`. Raises
        RosNameError."""
        namespace = f"/{self.namespace}" if self.namespace else ""
        relative = name[:1] not in ("/", "~")
        return checked_name(f"{namespace}/{name}" if relative else name, f"{namespace}/{self.name}")

    def __post_init__(self) -> None:
        super().__post_init__()
        controller = self.trajectory_controller
        for key, name in (
            ("name", f"/{self.name}" if self.name else "//"),
            ("namespace", f"/{self.namespace}"),
            ("trajectory_controller", f"/{controller}" if controller else "//"),
            ("servo", f"/{self.servo}" if self.servo else "//"),
            ("haptic", f"/{self.haptic}" if self.haptic else "//"),
        ):
            if name != "/":
                try:
                    if "/" in name[1:]:
                        raise RosNameError(name)
                    checked_name(name)
                except RosNameError:
                    raise OptionError(
                        key, name[1:], "words of letters, digits and single _, without slashes"
                    ) from None
        if self.haptic == self.name:
            raise OptionError("haptic", self.haptic, "another name than `name`, the arm's")
        for each in ("base_frame", "tcp_frame"):
            if not getattr(self, each):
                raise OptionError(each, "", "the name of a frame")
        if self.base_frame == self.tcp_frame:
            raise OptionError("tcp_frame", self.tcp_frame, "another name than base_frame")
        if self.source == OPERATOR:
            raise OptionError("source", self.source, f"another name: {OPERATOR!r} is the device")

    @property
    def servo_scales(self) -> ServoScales:
        """Units of the commands of MoveIt Servo."""
        return ServoScales(
            self.servo_units == "unitless",
            self.servo_linear_m_s,
            self.servo_angular_rad_s,
            self.servo_joint_rad_s,
        )
