"""Record of a cycle of the control loop, input and output, as one line of JSON.

Numbers are written with Python's ``repr``, which reads back to the same bits, and a recorded
session is compared with a controller bit for bit (:mod:`cardan.recording.verify`). The controller
reads no clock: all its times are in the states.
"""

from __future__ import annotations

import enum
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from cardan.errors import shown
from cardan.gateway.arm.loop import Cycle
from cardan.types import (
    Axes,
    ButtonEvent,
    DeviceLink,
    DeviceState,
    Frame,
    Inertia,
    Pose,
    Quaternion,
    RobotCommand,
    RobotLink,
    RobotState,
    Vector3,
    Wrench,
)


class RecordError(ValueError):
    """Error: a text is no record of a cycle; the message says why."""


class RecordedRequest(NamedTuple):
    """Request as the controller's recorder gets it."""

    name: str
    """Name of the controller's method, or "verb"."""
    argument: str


class CycleRecord(NamedTuple):
    """One cycle."""

    number: int
    """Counts the controller's ticks, from 1."""
    before: tuple[RecordedRequest, ...]
    """Requests since the tick before, in their order."""
    robot: RobotState
    device: DeviceState | None
    events: tuple[ButtonEvent, ...]
    command: str
    """Command that was sent, as text of `command_text`."""


def _plain(value: Any) -> Any:
    """Encode types that JSON does not have: names of an enumeration, and sets."""
    if isinstance(value, enum.Enum):
        return value.value
    if isinstance(value, (frozenset, set)):
        return sorted(value)
    raise TypeError(f"{type(value).__name__} is not recorded")


_encode = json.JSONEncoder(separators=(",", ":"), default=_plain).encode


def command_text(command: RobotCommand) -> str:
    """Encode a command as JSON, its kind last. Equal texts mean equal commands."""
    return _encode(command)


def encode_cycle(number: int, before: Sequence[RecordedRequest], cycle: Cycle) -> str:
    """The record of a cycle."""
    return _encode(
        {
            "cycle": number,
            "before": before,
            "robot": cycle.robot,
            "device": cycle.device,
            "events": cycle.events,
            "command": cycle.command,
        }
    )


def decode_cycle(text: str) -> CycleRecord:
    """Decode the record of a cycle. Raises RecordError."""
    try:
        table: Mapping[str, Any] = json.loads(text)
        return CycleRecord(
            int(table["cycle"]),
            tuple(RecordedRequest(str(name), str(argument)) for name, argument in table["before"]),
            _robot(*table["robot"]),
            None if table["device"] is None else _device(*table["device"]),
            tuple(ButtonEvent(*each) for each in table["events"]),
            _encode(table["command"]),
        )
    except json.JSONDecodeError:
        why = "it is not JSON"
    except RecursionError:
        why = "it is nested too deeply"
    except KeyError as error:
        why = f"it has no {shown(error.args[0])}"
    except (ValueError, TypeError, AttributeError, OverflowError):
        why = "a value in it is not of its kind"
    raise RecordError(f"no record of a cycle: {why}")


def _robot(*row: Any) -> RobotState:
    state = RobotState(*row)
    return state._replace(
        link=RobotLink(state.link),
        joints=tuple(state.joints),
        external_axes=tuple(state.external_axes),
        pose=_pose(state.pose),
        wrench=_wrench(state.wrench),
        velocities=tuple(state.velocities),
        torques=tuple(state.torques),
    )


def _device(*row: Any) -> DeviceState:
    state = DeviceState(*row)
    return state._replace(
        link=DeviceLink(state.link),
        axes=Axes(*state.axes),
        buttons=frozenset(state.buttons),
        pose=_pose(state.pose),
        wrench=_wrench(state.wrench),
        inertia=_inertia(state.inertia),
        masked=frozenset(state.masked),
    )


def _inertia(row: Any) -> Inertia | None:
    if row is None:
        return None
    acceleration, rates = row
    return Inertia(Vector3(*acceleration), None if rates is None else Vector3(*rates))


def _pose(row: Any) -> Pose | None:
    if row is None:
        return None
    position, orientation, frame = row
    return Pose(Vector3(*position), Quaternion(*orientation), Frame(frame))


def _wrench(row: Any) -> Wrench | None:
    if row is None:
        return None
    force, torque, frame = row
    return Wrench(Vector3(*force), Vector3(*torque), Frame(frame))
