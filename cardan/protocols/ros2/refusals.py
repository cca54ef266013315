"""Responses to refused service requests: a ROS 2 client waits forever for a response, and ROS 2 has
no other error reply."""

from __future__ import annotations

from cardan.protocols.ros2.actions import CANCEL_TYPE, CancelCode
from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.messages import default_message
from cardan.protocols.ros2.parameters import set_result

INVALID_GOAL = -1
"""Error code of results of control_msgs, whose 0 is success."""

_WORDS = ("message", "reason", "failure_reason", "error_string", "response")
"""Fields for the reason."""


def refusal(service: str, reason: str) -> Message:
    """Make the response of a service that did nothing, with `reason` if it has a field for it: not
    successful, not accepted, of no known goal, without values. Raises InterfaceError."""
    response = default_message(f"{service}_Response")
    if service == CANCEL_TYPE:
        response["return_code"] = int(CancelCode.REJECTED)
    elif service == "rcl_interfaces/srv/SetParameters":
        # One result per parameter belongs here, but their number is unknown.
        response["results"] = [set_result(reason)]
    else:
        _tell(response, reason)
    return response


def _tell(message: Message, reason: str) -> None:
    for name, value in message.items():
        if isinstance(value, dict):
            _tell(value, reason)
        elif name in _WORDS and isinstance(value, str):
            message[name] = reason
        elif name == "error_code" and isinstance(value, int):
            message[name] = INVALID_GOAL
