"""The dashboard server of the simulated controller: a line in, a line out."""

from __future__ import annotations

from cardan.protocols.ur import dashboard
from cardan.sim_peers.ur_controller.controller import UrController

_REMOTE_ONLY = frozenset(
    (
        dashboard.POWER_ON,
        dashboard.POWER_OFF,
        dashboard.BRAKE_RELEASE,
        dashboard.UNLOCK_PROTECTIVE_STOP,
        dashboard.STOP,
        "play",
        "pause",
        "restart safety",
        "shutdown",
    )
)
"""An e-Series in local control refuses these."""


def answer(controller: UrController, line: str) -> str:
    """The reply to a request, without its end."""
    request = " ".join(line.split())
    words = request.lower()
    options = controller.options
    if options.e_series and not controller.remote and words in _REMOTE_ONLY:
        return f"'{request}' is not allowed in local control"
    if words == dashboard.REMOTE_CONTROL and options.e_series:
        return "true" if controller.remote else "false"
    done = _done(controller, words)
    if done:
        return done
    first, _, rest = request.partition(" ")
    if first.lower() in ("load", "popup", "addtolog") and rest:
        return {
            "load": f"File not found: {rest}",
            "popup": "showing popup",
            "addtolog": "Added log message",
        }[first.lower()]
    return _told(controller, words) or f"could not understand: '{request}'"


def _done(controller: UrController, words: str) -> str:
    """The reply to what changes something; empty: it is another request."""
    if words == dashboard.POWER_ON:
        controller.power_on()
    elif words == dashboard.POWER_OFF:
        controller.power_off()
    elif words == dashboard.BRAKE_RELEASE:
        controller.release_brakes()
    elif words == dashboard.UNLOCK_PROTECTIVE_STOP:
        return controller.unlock_protective_stop()
    elif words == dashboard.STOP:
        controller.stop_program("stopped over the dashboard")
    elif words == "restart safety":
        controller.release_emergency_stop()
        controller.power_off()
        return "Restarting safety"
    elif words == "pause":
        return "Pausing program" if controller.pause() else "Failed to execute: pause"
    elif words == "play":
        return "Starting program" if controller.resume() else "Failed to execute: play"
    elif words == "close popup":
        controller.popups.close()
        return "closing popup"
    return dashboard.GRANTED.get(words, "")


def _told(controller: UrController, words: str) -> str:
    """The reply to what only asks; empty: it is not understood."""
    options, runs = controller.options, controller.has_program
    name = controller.program_name if runs else ""
    version = ".".join(str(number) for number in options.version)
    state = controller.runtime.name if runs else "STOPPED"
    return {
        dashboard.ROBOT_MODE: f"Robotmode: {controller.mode.name}",
        dashboard.SAFETY_STATUS: f"Safetystatus: {controller.safety.name}",
        "safetymode": f"Safetymode: {controller.safety.name}",
        "running": f"Program running: {'true' if runs else 'false'}",
        "programstate": f"{state} {name}".rstrip(),
        "get loaded program": "No program loaded",
        "isprogramsaved": "true",
        "polyscopeversion": f"URSoftware {version} (simulated)",
        "version": version,
        "get robot model": options.robot.upper().rstrip("E"),
        "get serial number": "20000000000",
        "get operational mode": "NONE",
    }.get(words, "")
