"""Interpretation of texts received over an interface that takes scripts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from cardan.sim_peers.ur_controller.controller import UrController

ORDERS: Final[Mapping[str, Callable[[UrController], object]]] = {
    "power on": UrController.power_on,
    "power off": UrController.power_off,
    "set robotmode run": UrController.release_brakes,
    "set unlock protective stop": UrController.release_protective_stop,
    "stop program": UrController.stop_program,
    "pause program": UrController.pause,
    "resume program": UrController.resume,
}
"""Lines that are not scripts: orders to the controller, as sent by UR's client library."""

_BEGINS: Final = ("def", "sec")
LINE: Final = "line"
"""Name of a one-line program."""


def take(controller: UrController, text: str) -> None:
    """Execute a program or a line."""
    lines = text.splitlines()
    at = next((n for n, line in enumerate(lines) if line.strip() and not _is_comment(line)), None)
    if at is None:
        return
    words = lines[at].partition("#")[0].split()
    order = ORDERS.get(" ".join(words).lower())
    if order is not None and len(lines) == at + 1:
        if controller.remote:
            order(controller)
        else:
            controller.refuse_in_local_control()
        return
    controller.upload(text, "" if words[0] in _BEGINS else LINE)


def is_program(text: str) -> bool:
    """Return True if a text is a program, False for a line."""
    return any(line.split()[:1] and line.split()[0] in _BEGINS for line in text.splitlines())


def _is_comment(line: str) -> bool:
    return line.lstrip().startswith("#")
