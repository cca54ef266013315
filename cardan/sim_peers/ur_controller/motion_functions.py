"""URScript's functions of the arm: motion, and measured and computed positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from cardan.common.bounds import Range
from cardan.sim_peers.kinematics import AXES
from cardan.sim_peers.ur_controller import checks
from cardan.sim_peers.ur_controller.actions import (
    DirectTorque,
    MoveC,
    MoveJ,
    MoveL,
    ServoJ,
    SpeedJ,
    SpeedL,
    StopJ,
    StopL,
)
from cardan.sim_peers.ur_controller.contact import Compliance
from cardan.sim_peers.ur_controller.kinematics import frame_of, pose_of
from cardan.sim_peers.ur_controller.language import (
    KINEMATICS_STEPS,
    MASS_STEPS,
    POSE_STEPS,
    Function,
    costing,
)
from cardan.sim_peers.ur_controller.motion import ArmMotion, ExternalSensor, Payload
from cardan.sim_peers.ur_controller.operators import text
from cardan.sim_peers.ur_controller.paths import MovejPath, MovelPath
from cardan.sim_peers.ur_controller.values import UrPose
from cardan.spatial import norm
from cardan.types import Pose as Frame, Vector3

LOOKAHEAD_S: Final = Range(0.03, 0.2, "s", "the script manual allows no other")
GAIN: Final = Range(100, 2000, "", "the script manual allows no other")
INERTIA_KG_M2: Final = 133.0
"""Largest inertia that the script manual allows."""
NEAR_SINGULARITY: Final = (0.05, 0.02)
"""Smallest singular values of the Jacobian at which freedrive is near a singularity, and too near
(chosen)."""

OPTIMAL_S: Final = 0.25
"""Time in which OptiMove with a share of 1 reaches the joints' highest speed (chosen)."""

_OPTIMAL: Final = {"a": 0.3, "v": 0.3, "r": 0}
_AS_A: Final = "a"
"""The manual's default of aRot: as `a`."""
_ACTIVE: Final = "active_tcp"
_CURRENT: Final = "current_joint_positions"


def motion_functions(motion: ArmMotion) -> Mapping[str, Function]:
    """Return the functions by name."""
    others = {**_moves(motion), **_modes(motion), **_state(motion), **_settings(motion)}
    return {
        **costing(POSE_STEPS, others),
        **costing(KINEMATICS_STEPS, _kinematics(motion)),
        **costing(MASS_STEPS, _torques(motion)),
    }


# -- moves -----------------------------------------------------------------------------------------


def _ready(motion: ArmMotion) -> None:
    if motion.freedrive:
        raise ValueError("the arm is in freedrive mode")


def _torques(motion: ArmMotion) -> Mapping[str, Function]:
    def direct_torque(torque: Any, friction: Any, viscous: Any, coulomb: Any) -> DirectTorque:
        _ready(motion)
        # The model's joints have no friction that any of these would compensate.
        checks.truth("friction_comp", friction)
        for name, scales in (("viscous_scale", viscous), ("coulomb_scale", coulomb)):
            if not all(0.0 <= each <= 1.0 for each in checks.vector(name, scales)):
                raise ValueError(f"{name} is {text(scales)}, which is not 0 to 1 for each joint")
        return DirectTorque(checks.joints("torque", torque))

    return {
        "direct_torque": Function(
            ("torque", "friction_comp", "viscous_scale", "coulomb_scale"),
            {
                "friction_comp": True,
                "viscous_scale": [0.9, 0.9, 0.8, 0.9, 0.9, 0.9],
                "coulomb_scale": [0.8, 0.8, 0.7, 0.8, 0.8, 0.8],
            },
            direct_torque,
            takes_time=True,
        )
    }


def _moves(motion: ArmMotion) -> Mapping[str, Function]:
    def ready() -> None:
        _ready(motion)

    def tool(name: str, value: Any) -> Frame:
        """Return the tool's frame from a pose, or from joints."""
        if isinstance(value, list):
            return motion.kinematics.forward(checks.joints(name, value), motion.tcp)
        return checks.frame(name, value)

    def joints(name: str, value: Any) -> tuple[float, ...]:
        """Return joints from a list of them, or from a pose."""
        if isinstance(value, UrPose):
            return tuple(_solved(motion, checks.frame(name, value), motion.target_q, motion.tcp))
        return checks.joints(name, value)

    def radius(r: Any) -> float:
        return checks.not_below_zero("r", r)

    def movej(q: Any, a: Any, v: Any, t: Any, r: Any) -> MoveJ:
        ready()
        return MoveJ(joints("q", q), *_profile(a, v, t), radius(r))

    def movel(pose: Any, a: Any, v: Any, t: Any, r: Any) -> MoveL:
        ready()
        return MoveL(tool("pose", pose), *_profile(a, v, t), radius(r))

    def optimovej(goal: Any, a: Any, v: Any, r: Any) -> MoveJ:
        ready()
        q = joints("goal", goal)
        return MoveJ(q, *_optimal(motion, MovejPath(motion.target_q, q), a, v), 0.0, radius(r))

    def optimovel(goal: Any, a: Any, v: Any, r: Any) -> MoveL:
        ready()
        there = tool("goal", goal)
        path = MovelPath(motion.kinematics.forward(motion.target_q, motion.tcp), there)
        return MoveL(there, *_optimal(motion, path, a, v), 0.0, radius(r))

    def movep(pose: Any, a: Any, v: Any, r: Any) -> MoveL:
        return movel(pose, a, v, 0.0, r)

    def movec(via: Any, to: Any, a: Any, v: Any, r: Any, mode: Any) -> MoveC:
        ready()
        return MoveC(
            tool("pose_via", via),
            tool("pose_to", to),
            checks.above_zero("a", a),
            checks.above_zero("v", v),
            radius(r),
            checks.choice("mode", mode, 0, 1) == 1,
        )

    def servoj(q: Any, a: Any, v: Any, t: Any, lookahead_time: Any, gain: Any) -> ServoJ:
        ready()
        for name, value, allowed in (
            ("lookahead_time", lookahead_time, LOOKAHEAD_S),
            ("gain", gain, GAIN),
        ):
            if value not in allowed:
                raise ValueError(f"{name} {text(value)} is not {allowed}")
        return ServoJ(checks.joints("q", q), checks.time(t), float(lookahead_time))

    def speedj(qd: Any, a: Any, t: Any, t_min: Any) -> SpeedJ:
        ready()
        return SpeedJ(checks.joints("qd", qd), *_changing(a, t, t_min))

    def speedl(xd: Any, a: Any, t: Any, a_rot: Any, t_min: Any) -> SpeedL:
        ready()
        speeds = checks.vector("xd", xd)
        change, time_s = _changing(a, t, t_min)
        turning = change if a_rot == _AS_A else checks.above_zero("aRot", a_rot)
        return SpeedL(speeds, change, turning, time_s)

    def stopl(a: Any, a_rot: Any) -> StopL:
        return StopL(checks.above_zero("a", a), _turning(a, a_rot))

    return {
        "movej": Function(
            ("q", "a", "v", "t", "r"), {"a": 1.4, "v": 1.05, "t": 0, "r": 0}, movej, True
        ),
        "movel": Function(
            ("pose", "a", "v", "t", "r"), {"a": 1.2, "v": 0.25, "t": 0, "r": 0}, movel, True
        ),
        "optimovej": Function(("goal", "a", "v", "r"), _OPTIMAL, optimovej, True),
        "optimovel": Function(("goal", "a", "v", "r"), _OPTIMAL, optimovel, True),
        "movep": Function(("pose", "a", "v", "r"), {"a": 1.2, "v": 0.25, "r": 0}, movep, True),
        "servoc": Function(("pose", "a", "v", "r"), {"a": 1.2, "v": 0.25, "r": 0}, movep, True),
        "movec": Function(
            ("pose_via", "pose_to", "a", "v", "r", "mode"),
            {"a": 1.2, "v": 0.25, "r": 0, "mode": 0},
            movec,
            True,
        ),
        "servoj": Function(
            ("q", "a", "v", "t", "lookahead_time", "gain"),
            {"a": 0, "v": 0, "t": 0.002, "lookahead_time": 0.1, "gain": 300},
            servoj,
            True,
        ),
        # Manuals up to 3.2 call the time `t_min`, and programs still do.
        "speedj": Function(("qd", "a", "t", "t_min"), {"t": 0.0, "t_min": 0.0}, speedj, True),
        "speedl": Function(
            ("xd", "a", "t", "aRot", "t_min"),
            {"t": 0.0, "aRot": _AS_A, "t_min": 0.0},
            speedl,
            True,
        ),
        "stopj": Function(("a",), {}, lambda a: StopJ(checks.above_zero("a", a)), True),
        "stopl": Function(("a", "aRot"), {"aRot": _AS_A}, stopl, True),
    }


def _optimal(motion: ArmMotion, path: MovejPath | MovelPath, a: Any, v: Any) -> tuple[float, float]:
    """Return acceleration and speed of a move from their shares of what the joints are able to."""
    fastest = motion.fastest_on(path)
    return (
        checks.share("a", a) * fastest / OPTIMAL_S,
        checks.share("v", v) * fastest,
    )


def _profile(a: Any, v: Any, t: Any) -> tuple[float, float, float]:
    if checks.time(t) > 0.0:
        return checks.moderate("a", a), checks.moderate("v", v), float(t)
    return checks.above_zero("a", a), checks.above_zero("v", v), 0.0


def _changing(a: Any, t: Any, t_min: Any) -> tuple[float, float]:
    """Return acceleration and time of a speed. With a time, the acceleration may be 0, and the time
    as short as it likes: UR's external control computes both, and has them from rounding errors."""
    time_s = checks.not_below_zero("t", t) or checks.not_below_zero("t_min", t_min)
    return (checks.not_below_zero if time_s else checks.above_zero)("a", a), time_s


def _turning(a: Any, a_rot: Any) -> float:
    return checks.above_zero("aRot", a if a_rot == _AS_A else a_rot)


# -- force and freedrive ---------------------------------------------------------------------------


def _modes(motion: ArmMotion) -> Mapping[str, Function]:
    def force_mode(frame: Any, selection: Any, wrench: Any, kind: Any, limits: Any) -> None:
        motion.begin_force(
            Compliance(
                checks.frame("task_frame", frame),
                checks.switches("selection_vector", selection),
                checks.vector("wrench", wrench),
                checks.choice("type", kind, 1, 3),
                tuple(map(abs, checks.vector("limits", limits))),
            )
        )

    def damping(value: Any) -> None:
        motion.force.damping = _within("damping", value, 1.0)

    def gain(value: Any) -> None:
        motion.force.gain = _within("scaling", value, 2.0)

    def freedrive(free_axes: Any, feature: Any) -> None:
        checks.switches("freeAxes", free_axes)
        if feature not in ("base", "tool"):
            checks.pose("feature", feature)
        motion.freedrive = True

    def teach() -> None:
        motion.freedrive = True

    def end_freedrive() -> None:
        motion.freedrive = False

    def sensor(turned: bool) -> Function:
        def enable(enable: Any, mass: Any, offset: Any, cog: Any) -> None:
            # The mass is ignored: the arm carries it, and moves as commanded.
            checks.not_below_zero("sensor_mass", mass)
            checks.vector("sensor_cog", cog, 3)
            place = checks.vector("sensor_measuring_offset", offset, 3)
            on = checks.truth("enable", enable)
            motion.sensor = ExternalSensor(place, turned) if on else None

        nowhere = [0.0, 0.0, 0.0]
        return Function(
            ("enable", "sensor_mass", "sensor_measuring_offset", "sensor_cog"),
            {"sensor_mass": 0.0, "sensor_measuring_offset": nowhere, "sensor_cog": nowhere},
            enable,
        )

    def tool_contact(direction: Any) -> int:
        return motion.touched(checks.vector("direction", direction))

    nothing = UrPose((0.0,) * AXES)
    return {
        "force_mode": Function(
            ("task_frame", "selection_vector", "wrench", "type", "limits"), {}, force_mode
        ),
        "end_force_mode": Function((), {}, motion.end_force),
        "force_mode_set_damping": Function(("damping",), {}, damping),
        "force_mode_set_gain_scaling": Function(("scaling",), {}, gain),
        "ft_rtde_input_enable": sensor(turned=False),
        "enable_external_ft_sensor": sensor(turned=True),
        "freedrive_mode": Function(
            ("freeAxes", "feature"), {"freeAxes": [1] * AXES, "feature": nothing}, freedrive
        ),
        "end_freedrive_mode": Function((), {}, end_freedrive),
        "teach_mode": Function((), {}, teach),
        "end_teach_mode": Function((), {}, end_freedrive),
        "tool_contact": Function(("direction",), {"direction": [0] * AXES}, tool_contact),
        "zero_ftsensor": Function((), {}, motion.zero_force),
    }


def _within(name: str, value: Any, most: float) -> float:
    if not checks.not_below_zero(name, value) <= most:
        raise ValueError(f"{name} is {text(value)}, which is not 0 to {most:g}")
    return float(value)


# -- where the arm is ------------------------------------------------------------------------------


def _state(motion: ArmMotion) -> Mapping[str, Function]:
    def history(steps: Any) -> list[float]:
        return motion.position_before(
            checks.whole("steps", steps, 0, motion.positions_retained - 1)
        )

    def force() -> float:
        return norm(Vector3(*motion.tcp_force()[:3]))

    def actual_q() -> list[float]:
        return list(motion.actual_q)

    def actual_qd() -> list[float]:
        return list(motion.actual_qd)

    def flange() -> UrPose:
        return pose_of(motion.kinematics.forward(motion.actual_q))

    values: Mapping[str, Callable[[], Any]] = {
        "get_actual_joint_positions": actual_q,
        "get_joint_positions": actual_q,
        "get_actual_joint_speeds": actual_qd,
        "get_joint_speeds": actual_qd,
        "get_actual_tcp_pose": motion.actual_tcp_pose,
        "get_actual_tcp_speed": motion.actual_tcp_speed,
        "get_actual_tool_flange_pose": flange,
        "get_joint_torques": motion.joint_torques,
        "get_target_joint_positions": lambda: list(motion.target_q),
        "get_target_joint_speeds": lambda: list(motion.target_qd),
        "get_target_joint_accelerations": lambda: list(motion.target_qdd),
        "get_target_tcp_pose": motion.target_tcp_pose,
        "get_target_tcp_speed": motion.target_tcp_speed,
        "get_target_waypoint": motion.waypoint,
        "get_tcp_force": motion.tcp_force,
        "force": force,
        "get_tcp_offset": lambda: motion.tcp_offset,
        "get_target_payload": lambda: motion.payload.mass,
        "get_target_payload_cog": lambda: list(motion.payload.cog),
        "get_target_payload_inertia": lambda: list(motion.payload.inertia),
        "get_gravity": lambda: list(motion.gravity),
        "is_steady": lambda: motion.steady,
    }
    return {
        **{name: Function((), {}, value) for name, value in values.items()},
        "get_actual_joint_positions_history": Function(("steps",), {"steps": 0}, history),
    }


def _kinematics(motion: ArmMotion) -> Mapping[str, Function]:
    kinematics = motion.kinematics

    def joints(value: Any, name: str = "q") -> tuple[float, ...]:
        return tuple(motion.actual_q) if value == _CURRENT else checks.joints(name, value)

    def tool(value: Any) -> Frame:
        return motion.tcp if value == _ACTIVE else checks.frame("tcp", value)

    def forward_kin(q: Any, tcp: Any) -> UrPose:
        return pose_of(kinematics.forward(joints(q), tool(tcp)))

    def inverse_kin(x: Any, near: Any, far: Any, turned: Any, tcp: Any) -> list[float]:
        # Closed form: the only error is rounding.
        checks.not_below_zero("maxPositionError", far)
        checks.not_below_zero("maxOrientationError", turned)
        return _solved(motion, checks.frame("x", x), joints(near, "qnear"), tool(tcp))

    def has_solution(x: Any, near: Any, far: Any, turned: Any, tcp: Any) -> bool:
        checks.not_below_zero("maxPositionError", far)
        checks.not_below_zero("maxOrientationError", turned)
        goal = checks.frame("pose", x)
        return kinematics.inverse(goal, joints(near, "qnear"), tool(tcp)) is not None

    def is_within(position: Any, near: Any) -> bool:
        if isinstance(position, list):
            return motion.in_range(checks.joints("position", position))
        goal = checks.frame("position", position)
        return kinematics.inverse(goal, joints(near, "qNear"), motion.tcp) is not None

    def jacobian(q: Any, tcp: Any) -> list[list[float]]:
        columns = kinematics.jacobian(joints(q), tool(tcp))
        return [list(row) for row in zip(*columns, strict=True)]

    def freedrive_status() -> int:
        for number, threshold in enumerate(reversed(NEAR_SINGULARITY)):
            if motion.is_singular(threshold):
                return 2 - number
        return 0

    tolerances = ("maxPositionError", "maxOrientationError")
    given = {"qnear": _CURRENT, **dict.fromkeys(tolerances, 1e-10), "tcp": _ACTIVE}
    current = {"q": _CURRENT, "tcp": _ACTIVE}
    return {
        "get_forward_kin": Function(("q", "tcp"), current, forward_kin),
        "get_inverse_kin": Function(("x", "qnear", *tolerances, "tcp"), given, inverse_kin),
        "get_inverse_kin_has_solution": Function(
            ("pose", "qnear", *tolerances, "tcp"), given, has_solution
        ),
        "get_freedrive_status": Function((), {}, freedrive_status),
        "get_jacobian": Function(("q", "tcp"), current, jacobian),
        "is_within_safety_limits": Function(("position", "qNear"), {"qNear": _CURRENT}, is_within),
    }


def _solved(motion: ArmMotion, goal: Frame, near: Any, tcp: Frame) -> list[float]:
    found = motion.kinematics.inverse(goal, near, tcp)
    if found is None:
        raise ValueError(f"no joints have the TCP at p{checks.shown(pose_of(goal))}")
    return found


# -- settings of the controller --------------------------------------------------------------------


def _settings(motion: ArmMotion) -> Mapping[str, Function]:
    def set_tcp(pose: Any, tcp_name: Any) -> None:
        checks.words("tcp_name", tcp_name)
        motion.set_tcp(frame_of(checks.pose("pose", pose)))

    def carry(mass: Any, cog: tuple[float, ...], inertia: tuple[float, ...]) -> None:
        motion.payload = Payload(checks.not_below_zero("m", mass), cog, inertia)
        motion.zero_force()

    def set_payload(m: Any, cog: Any) -> None:
        center = motion.tcp.position if cog is None else checks.vector("cog", cog, 3)
        carry(m, tuple(center), (0.0,) * AXES)

    def set_payload_mass(m: Any) -> None:
        carry(m, motion.payload.cog, (0.0,) * AXES)

    def set_payload_cog(cog: Any) -> None:
        carry(motion.payload.mass, checks.vector("CoG", cog, 3), (0.0,) * AXES)

    def set_target_payload(m: Any, cog: Any, inertia: Any, transition_time: Any) -> None:
        checks.not_below_zero("transition_time", transition_time)
        moments = checks.vector("inertia", inertia)
        if max(map(abs, moments)) > INERTIA_KG_M2 or min(moments[:3]) < 0.0:
            raise ValueError(
                f"inertia is {text(inertia)}, which is beyond {INERTIA_KG_M2:.0f} kg m2, or below 0"
            )
        carry(m, checks.vector("cog", cog, 3), moments)

    def set_gravity(d: Any) -> None:
        motion.gravity = checks.vector("d", d, 3)

    return {
        "set_tcp": Function(("pose", "tcp_name"), {"tcp_name": ""}, set_tcp),
        "set_payload": Function(("m", "cog"), {"cog": None}, set_payload),
        "set_payload_mass": Function(("m",), {}, set_payload_mass),
        "set_payload_cog": Function(("CoG",), {}, set_payload_cog),
        "set_target_payload": Function(
            ("m", "cog", "inertia", "transition_time"),
            {"inertia": [0] * AXES, "transition_time": 0},
            set_target_payload,
        ),
        "set_gravity": Function(("d",), {}, set_gravity),
    }
