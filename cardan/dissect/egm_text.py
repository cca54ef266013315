"""One readable line of an EGM message, in the units of the wire."""

from __future__ import annotations

from typing import Any

from cardan.dissect.egm import EgmSensorPathCorr, symbol
from cardan.dissect.protobuf import ProtoMessage, unknown_numbers
from cardan.dissect.text import number, numbers


def describe(message: ProtoMessage) -> str:
    """The named values of an EgmRobot, EgmSensor or EgmSensorPathCorr that are present."""
    parts = [type(message).__name__, _header(message.header)]
    if isinstance(message, EgmSensorPathCorr):
        parts += _path_correction(message.pathCorr)
    else:
        for name in ("feedBack", "planned", "speedRef"):
            parts += _motion(name, _get(message, name))
        parts += _states(message)
        parts += _force(_get(message, "measuredForce"))
        parts += _extras(message)
    if fields := unknown_numbers(message):
        parts.append(f"unknown fields {' '.join(map(str, fields))}")
    return " | ".join(filter(None, parts))


def _get(message: ProtoMessage, name: str) -> Any:
    return message.getfieldval(name) if name in message.default_fields else None


def _short(message: ProtoMessage, name: str) -> str:
    """An enum without its prefix."""
    text = symbol(message, name)
    return "-" if text is None else text.partition("_")[2] or f"unknown {text}"


def _header(header: ProtoMessage | None) -> str:
    if header is None:
        return "no header"
    seqno, tm = ("-" if v is None else v for v in (header.seqno, header.tm))
    return f"seqno {seqno} tm {tm} {_short(header, 'mtype')}"


def _triple(point: ProtoMessage) -> str:
    return numbers(v for v in (point.x, point.y, point.z) if v is not None)


def _pose(pose: ProtoMessage) -> list[str]:
    parts = []
    if pose.pos is not None:
        parts.append(f"pos {_triple(pose.pos)} mm")
    if (q := pose.orient) is not None:
        parts.append(f"quat {numbers(v for v in (q.u0, q.u1, q.u2, q.u3) if v is not None)}")
    if pose.euler is not None:
        parts.append(f"euler {_triple(pose.euler)} deg")
    return parts


def _motion(name: str, motion: ProtoMessage | None) -> list[str]:
    """feedBack, planned or speedRef."""
    if motion is None:
        return []
    per_second = "/s" if name == "speedRef" else ""
    parts = []
    if motion.joints is not None:
        parts.append(f"joints {numbers(motion.joints.joints or ())} deg{per_second}")
    if (pose := _get(motion, "cartesian")) is not None:
        parts += _pose(pose)
    if (speed := _get(motion, "cartesians")) is not None:
        values = speed.value or []
        parts.append(f"linear {numbers(values[:3])} mm/s, angular {numbers(values[3:])} deg/s")
    if motion.externalJoints is not None:
        values = motion.externalJoints.joints or []
        parts.append(f"external {numbers(values)} deg{per_second} or mm{per_second}")
    if (clock := _get(motion, "time")) is not None:
        parts.append(f"time {clock.sec or 0}.{clock.usec or 0:06d} s")
    if (stamp := _get(motion, "timeStamp")) is not None:
        parts.append(f"timeStamp {stamp.sec or 0}.{stamp.nsec or 0:09d} s")
    return [f"{name} {', '.join(parts) or '(empty)'}"]


def _states(message: ProtoMessage) -> list[str]:
    parts = []
    fields = (("motorState", "motors"), ("mciState", "MCI"), ("rapidExecState", "RAPID"))
    for name, label in fields:
        if (state := _get(message, name)) is not None:
            parts.append(f"{label} {_short(state, 'state')}")
    if (met := _get(message, "mciConvergenceMet")) is not None:
        parts.append("converged" if met else "not converged")
    return [", ".join(parts)]


def _force(force: ProtoMessage | None) -> list[str]:
    if force is None:
        return []
    active = _get(force, "fcActive")
    control = "" if active is None else f" (force control {'on' if active else 'off'})"
    return [f"force {numbers(force.force or ())}{control}"]


def _extras(message: ProtoMessage) -> list[str]:
    parts = []
    if (rate := _get(message, "utilizationRate")) is not None:
        parts.append(f"utilization {number(rate)} %")
    if (index := _get(message, "moveIndex")) is not None:
        parts.append(f"moveIndex {index}")
    if (collision := _get(message, "CollisionInfo")) is not None:
        triggered = "triggered" if collision.collsionTriggered else "not triggered"
        parts.append(f"collision {triggered}, quota {numbers(collision.collDetQuota or ())}")
    for name in ("RAPIDfromRobot", "RAPIDtoRobot"):
        if (data := _get(message, name)) is not None:
            signal = "-" if data.digVal is None else int(data.digVal)
            parts.append(f"{name} digVal {signal}, dnum {numbers(data.dnum or ())}")
    if (torque := _get(message, "torqueRef")) is not None:
        parts.append(f"torqueRef {numbers(torque.joints or ())}")
    if (signals := _get(message, "testSignals")) is not None:
        parts.append(f"testSignals {numbers(signals.signals or ())}")
    return parts


def _path_correction(correction: ProtoMessage | None) -> list[str]:
    if correction is None:
        return []
    pos = "" if correction.pos is None else f"pos {_triple(correction.pos)} mm "
    return [f"pathCorr {pos}age {correction.age} ms"]
