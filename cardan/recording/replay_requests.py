"""Repetition of recorded requests at an arm's verbs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from cardan.gateway.arm.replay_requests import CommandHeader
from cardan.gateway.arm.vocab import Parameter, Stream
from cardan.types import Frame, Pose, Quaternion, Twist, Vector3, Wrench

if TYPE_CHECKING:  # Imports Pinocchio, which a session without an arm's model does not need.
    from cardan.gateway.arm.verb_methods import ArmVerbs


def _set_parameters(verbs: ArmVerbs, values: Sequence[Sequence[Any]], source: str) -> None:
    verbs.set_parameters({Parameter(key): value for key, value in values}, source=source)


def _aim(verbs: ArmVerbs, target: Sequence[Any], sender: Sequence[Any]) -> None:
    position, orientation, frame = target
    pose = Pose(Vector3(*position), Quaternion(*orientation), Frame(frame))
    verbs.streams.aim(pose, CommandHeader(*sender))


def _twist(verbs: ArmVerbs, numbers: list[float], frame: str, sender: Sequence[Any]) -> None:
    twist = Twist(Vector3(*numbers[:3]), Vector3(*numbers[3:]), Frame(frame))
    verbs.streams.twist(twist, CommandHeader(*sender))


def _wrench(verbs: ArmVerbs, numbers: list[float], frame: str, sender: Sequence[Any]) -> None:
    wrench = Wrench(Vector3(*numbers[:3]), Vector3(*numbers[3:]), Frame(frame))
    verbs.streams.wrench(wrench, CommandHeader(*sender))


REPEAT: Mapping[str, Callable[..., None]] = {
    "set_parameters": _set_parameters,
    "aim": _aim,
    "twist": _twist,
    "wrench": _wrench,
    "joints": lambda verbs, rates, sender: verbs.streams.joints(rates, CommandHeader(*sender)),
    "take_back": lambda verbs, kind, reason: verbs.take_back(Stream(kind), reason),
    "acquire": lambda verbs, source: verbs.acquire(source=source),
    "hand_over": lambda verbs, to, source: verbs.hand_over(to, source=source),
    "release": lambda verbs, source: verbs.release(source),
}
"""Functions that repeat a recorded request with its values, by the request's name."""


def repeat(verbs: ArmVerbs, name: str, argument: str) -> None:
    """Repeat a request. Raises the errors of the request."""
    REPEAT[name](verbs, *json.loads(argument))
