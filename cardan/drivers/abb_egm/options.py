"""Options of the EGM driver."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from cardan.common import bounds
from cardan.common.bounds import Range
from cardan.common.options import Options, require_each
from cardan.common.sockets import is_loopback
from cardan.protocols.egm.messages import DNUM_MAX
from cardan.types import JointLimits

if TYPE_CHECKING:
    from cardan.robots import ArmModel

CONTROLLER_PERIOD_S = 0.004032
"""Cycle of a real controller; RAPID's \\SampleRate calls it 4 ms (a virtual one has 4.000 ms)."""

SILENT_PERIODS = 3
"""Missed datagrams after which the link is LOST; fewer are network jitter."""

SAMPLE_RATE_MS = Range(
    4, 160, "ms", "three periods that are missed may take half a second, no longer"
)
JOINTS = Range(6, 7, "", "EGM has six joints, and a seventh among the external axes")
EXTERNAL_AXES = Range(0, 6, "", "EGM has six external axes")
COMM_TIMEOUT_S = Range(
    0.0, 10.0, "s", "a robot that moves on at its last speed for longer leaves its cell", above=True
)
EXTERNAL_AXIS = Range(0, 5, "", "EGM has six external axes, counted from 0")


@dataclass(frozen=True)
class AbbEgmOptions(Options):
    """Options of :class:`AbbEgm`. Lengths are in m, angles in degrees as in RAPID."""

    listen_host: Annotated[str, bounds.LISTEN_HOST_OR_IPV4] = "127.0.0.1"
    """This computer's address on the robot's network; 0.0.0.0: all of them. The default receives
    from this computer only."""
    listen_port: Annotated[int, bounds.ANY_PORT] = 6510
    """UDP port; the controller's UdpUc device names it as Remote Port Number. 0: any free one."""
    controller_host: Annotated[str, bounds.HOST_OR_IPV4] | None = None
    """The only controller address to accept. None: the first that sends a valid datagram."""
    mode: Literal["pose", "joint", "path-correction"] = "pose"
    """Mode that the RAPID program runs: EGMRunPose, EGMRunJoint or EGMMoveL/EGMMoveC."""
    speed_reference: Literal["matched", "none", "only"] = "matched"
    """matched: position with its speed; none: position; only: speed (RAPID: PosCorrGain 0)."""
    sample_rate_ms: Annotated[int, SAMPLE_RATE_MS] | None = None
    """\\SampleRate of the RAPID program, nominal ms; None: 4, in path correction 48."""
    joints: Annotated[int, JOINTS] = 6
    """6, or 7 for an arm whose third axis travels as an external one (joint mode only)."""
    external_axes: Annotated[int, EXTERNAL_AXES] = 0
    """Number of external axes that are guided along with the arm."""
    linear_external_axes: tuple[Annotated[int, EXTERNAL_AXIS], ...] = ()
    """Indices from 0 of the external axes that are linear (mm on the wire), not rotary."""
    force_frame: Literal["tool", "base"] = "tool"
    """Frame of the measured forces; ABB's manual does not define it."""
    robot: Annotated[str, bounds.ARM_FILE] | None = None
    """Robot model for joint ranges and speeds; None: only the limits below."""
    joint_lower_deg: tuple[Annotated[float, bounds.JOINT_ANGLE_DEG], ...] = ()
    """Lower ends of the joint range; empty: the robot's."""
    joint_upper_deg: tuple[Annotated[float, bounds.JOINT_ANGLE_DEG], ...] = ()
    """Upper ends of the joint range; empty: the robot's."""
    joint_speed_deg_s: Annotated[float, bounds.JOINT_SPEED_DEG_S] = 90.0
    """Highest joint speed in joint mode; slower joints of `robot` keep their limit."""
    joint_acceleration_deg_s2: Annotated[float, bounds.ANGULAR_ACCELERATION_DEG_S2] = 720.0
    """Highest joint acceleration in joint mode, deg/s²."""
    external_axis_speed: Annotated[float, bounds.JOINT_SPEED_RAD_S] = 0.1
    """Highest speed of external axes, rad/s or m/s."""
    external_axis_acceleration: Annotated[float, bounds.JOINT_ACCELERATION_RAD_S2] = 0.5
    """Highest acceleration of external axes, rad/s² or m/s²."""
    linear_speed_m_s: Annotated[float, bounds.LINEAR_SPEED_M_S] = 0.25
    """Highest speed of the TCP in pose mode and of the offset in path correction, m/s."""
    linear_acceleration_m_s2: Annotated[float, bounds.LINEAR_ACCELERATION_M_S2] = 2.0
    """Highest acceleration of the TCP, m/s²."""
    angular_speed_deg_s: Annotated[float, bounds.ANGULAR_SPEED_DEG_S] = 90.0
    """Highest speed of rotation of the TCP in pose mode, deg/s."""
    angular_acceleration_deg_s2: Annotated[float, bounds.ANGULAR_ACCELERATION_DEG_S2] = 720.0
    """Lower corner of a box that the commanded TCP position stays in; empty: no box."""
    workspace_lower_m: tuple[Annotated[float, bounds.COORDINATE_M], ...] = ()
    """Lower corner of a box the commanded TCP position stays in; empty: no box."""
    workspace_upper_m: tuple[Annotated[float, bounds.COORDINATE_M], ...] = ()
    """Upper corner of that box."""
    path_offset_m: Annotated[float, bounds.PATH_OFFSET_M] = 0.02
    """Largest path correction along y and along z."""
    max_speed_deviation_deg_s: Annotated[float, bounds.JOINT_SPEED_DEG_S] | None = None
    """\\MaxSpeedDeviation of the RAPID program if known, for the diagnosis."""
    silence_s: Annotated[float, bounds.BLIND_S] = 0.1
    """Silence (at least three periods) after which the link is LOST."""
    command_timeout_s: Annotated[float, bounds.BLIND_S] = 0.1
    """Delay of a command (at least three periods) from which on the robot brakes instead."""
    comm_timeout_s: Annotated[float, COMM_TIMEOUT_S] = 0.2
    """\\CommTimeout of the RAPID program. A controller silent for longer has ended its run and gets
    no message, which its next run would take as the first."""
    digital_output: bool | None = None
    """RAPIDtoRobot.digVal at the start (RobotWare 7.7 and later); None: not sent."""
    output_values: tuple[Annotated[float, bounds.OUTPUT_VALUE], ...] = ()
    """RAPIDtoRobot.dnum at the start; empty: not sent."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_axes()
        self._check_limits()
        require_each(
            self,
            (
                "output_values",
                len(self.output_values) <= DNUM_MAX,
                f"at most {DNUM_MAX} numbers",
            ),
        )

    def _check_axes(self) -> None:
        step = 24 if self.mode == "path-correction" else 4
        good = self.sample_rate_ms is None or self.sample_rate_ms % step == 0
        require_each(self, ("sample_rate_ms", good, f"a multiple of {step} in {self.mode} mode"))
        if self.joints == 7:
            require_each(
                self,
                ("joints", self.mode == "joint", "6 unless mode is joint"),
                ("external_axes", self.external_axes <= 5, "0 to 5"),
            )
        if self.mode == "path-correction":
            outputs = self.digital_output is not None or self.output_values
            require_each(
                self,
                (
                    "speed_reference",
                    self.speed_reference == "matched",
                    "matched (the default) in path-correction mode, which has no speeds",
                ),
                ("external_axes", self.external_axes == 0, "0 in this mode"),
                ("output_values", not outputs, "none in this mode"),
            )

    def _check_limits(self) -> None:
        lower, upper, joints = self.joint_lower_deg, self.joint_upper_deg, self.joints
        low, high = self.workspace_lower_m, self.workspace_upper_m
        if self.robot is not None:
            from cardan.robots import arm_names

            names = arm_names()
            allowed = f"absent or one of {', '.join(names)}"
            require_each(self, ("robot", self.robot in names, allowed))
        require_each(
            self,
            ("joint_lower_deg", len(lower) in (0, joints), f"{joints} angles, or none"),
            ("joint_upper_deg", len(upper) in (0, joints), f"{joints} angles, or none"),
            ("workspace_lower_m", len(low) in (0, 3), "three coordinates, or none"),
            ("workspace_upper_m", len(high) in (0, 3), "three coordinates, or none"),
            ("workspace_lower_m", _is_below(low, high), f"below the upper corner {high}"),
        )
        if arm := self._arm():
            known = len(arm.joints)
            require_each(self, ("robot", known == joints, f"one with {joints} joints"))
        else:
            given = bool(upper) == bool(lower)
            require_each(self, ("joint_upper_deg", given, "given with the lower"))
        if ends := self._range_deg():
            allowed = f"below the upper ends {ends[1]}"
            require_each(self, ("joint_lower_deg", _is_below(*ends), allowed))

    def _range_deg(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        lower, upper = self.joint_lower_deg, self.joint_upper_deg
        if arm := self._arm():
            lower = lower or tuple(map(math.degrees, arm.lower))
            upper = upper or tuple(map(math.degrees, arm.upper))
        return (lower, upper) if lower else None

    @property
    def caution(self) -> str:
        """Warning that another computer could pose as the controller; empty if none can."""
        if self.controller_host is not None or is_loopback(self.listen_host):
            return ""
        return (
            f"listen_host {self.listen_host} without controller_host: the first sender to UDP port "
            f"{self.listen_port} is taken for the robot, whatever computer it is; set "
            "controller_host to the controller's address"
        )

    @property
    def period_s(self) -> float:
        """The controller's control period, s."""
        default_ms = 48 if self.mode == "path-correction" else 4
        return (self.sample_rate_ms or default_ms) / 4 * CONTROLLER_PERIOD_S

    @property
    def lost_after_s(self) -> float:
        """Silence after which the link is LOST, s."""
        return max(self.silence_s, SILENT_PERIODS * self.period_s)

    @property
    def late_after_s(self) -> float:
        """Age from which on a command is late, s."""
        return max(self.command_timeout_s, SILENT_PERIODS * self.period_s)

    @property
    def joint_limits(self) -> JointLimits | None:
        """Limits of joint mode; None if no joint range is known."""
        ends = self._range_deg()
        if ends is None:
            return None
        return JointLimits(
            lower=tuple(map(math.radians, ends[0])),
            upper=tuple(map(math.radians, ends[1])),
            velocity=self.joint_speeds_rad_s,
            acceleration=(math.radians(self.joint_acceleration_deg_s2),) * self.joints,
        )

    @property
    def joint_speeds_rad_s(self) -> tuple[float, ...]:
        """Highest speed of each joint, rad/s."""
        own = (math.radians(self.joint_speed_deg_s),) * self.joints
        arm = self._arm()
        return own if arm is None else tuple(map(min, own, arm.velocity))

    def _arm(self) -> ArmModel | None:
        if self.robot is None:
            return None
        from cardan.robots import load_arm

        return load_arm(self.robot)


def _is_below(low: tuple[float, ...], high: tuple[float, ...]) -> bool:
    return len(low) == len(high) and all(a < b for a, b in zip(low, high, strict=True))
