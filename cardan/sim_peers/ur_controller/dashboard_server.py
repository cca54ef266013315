"""The dashboard server of the simulated controller: a line in, a line out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from cardan.protocols.ur import dashboard
from cardan.sim_peers.ur_controller.controller import UrController
from cardan.sim_peers.ur_controller.pendant import (
    OPERATIONAL_MODES,
    SERIAL_NUMBER,
    UNNAMED,
    USER_ROLES,
    Pendant,
)

V = TypeVar("V")

_REMOTE_ONLY = frozenset(
    (
        dashboard.POWER_ON,
        dashboard.POWER_OFF,
        dashboard.BRAKE_RELEASE,
        dashboard.UNLOCK_PROTECTIVE_STOP,
        dashboard.STOP,
        "load",
        "load installation",
        "play",
        "pause",
        "restart safety",
        dashboard.SHUTDOWN,
    )
)
"""Requests that an e-Series in local control refuses."""
_Version = tuple[int, int]
_SINCE: Mapping[str, tuple[_Version | None, _Version | None]] = {
    "clear operational mode": (None, (5, 0)),
    "generate flight report": ((3, 13), (5, 8)),
    "generate support file": ((3, 13), (5, 8)),
    "get operational mode": (None, (5, 6)),
    "get robot model": ((3, 12), (5, 6)),
    "get serial number": ((3, 12), (5, 6)),
    "getuserrole": ((3, 1), None),
    "help": ((3, 1), None),
    dashboard.REMOTE_CONTROL: (None, (5, 6)),
    "restart safety": ((3, 7), (5, 1)),
    dashboard.SAFETY_STATUS: ((3, 11), (5, 4)),
    "savelog": ((3, 13), (5, 8)),
    "set operational mode": (None, (5, 0)),
    "setuserrole": ((3, 1), None),
    "version": (None, (5, 0)),
}
"""First versions of CB3 and e-Series with a request; None: never. Others are in all versions."""
_ALWAYS: Mapping[bool, _Version] = {False: (3, 0), True: (5, 0)}


def _bare(answer: Callable[[], str]) -> Callable[[], str]:
    """Return the answer without the words before its value."""
    return lambda: answer().rpartition(": ")[2]


class Dashboard:
    """Answers the requests of a dashboard client."""

    def __init__(self, controller: UrController, pendant: Pendant) -> None:
        self._controller, self._pendant = controller, pendant
        self._e_series = controller.options.e_series
        questions = self._questions()
        if controller.options.faults.get("bare-answers", 0.0):
            questions = {words: _bare(answer) for words, answer in questions.items()}
        self._exact = self._known(self._orders() | questions)
        self._begins = self._known(
            {
                "load installation": pendant.load_installation,
                "load": pendant.load,
                "popup": self._popup,
                "addtolog": self._add_to_log,
                "setuserrole": self._set_role,
                "set operational mode": self._set_mode,
                "generate flight report": pendant.flight_report,
                "generate support file": pendant.support_file,
            }
        )

    def answer(self, line: str) -> str:
        """Return the reply to a request, without its line end."""
        request = " ".join(line.split())
        words = request.lower()
        begun = self._beginning(words)
        local = self._e_series and not self._controller.remote
        if local and not _REMOTE_ONLY.isdisjoint((words, begun)):
            return f"'{request}' is not allowed in local control"
        exact = self._exact.get(words)
        if exact is not None:
            return exact()
        if begun:
            return self._begins[begun](request[len(begun) + 1 :])
        return f"could not understand: '{request}'"

    def _known(self, table: Mapping[str, V]) -> dict[str, V]:
        """Return the entries of `table` that this version has."""
        version, always = self._controller.options.version[:2], _ALWAYS[self._e_series]
        found = {}
        for words, made in table.items():
            since = _SINCE.get(words, (always, always))[self._e_series]
            if since is not None and version >= since:
                found[words] = made
        return found

    def _beginning(self, words: str) -> str:
        """Return the request that takes an argument, and has one here."""
        found = (begin for begin in self._begins if words.startswith(f"{begin} "))
        return max(found, key=len, default="")

    # -- requests that change something -----------------------------------------------------------

    def _orders(self) -> dict[str, Callable[[], str]]:
        controller, pendant = self._controller, self._pendant

        def granted(words: str, action: Callable[[], object]) -> Callable[[], str]:
            def do() -> str:
                action()
                return dashboard.GRANTED[words]

            return do

        return {
            dashboard.POWER_ON: granted(dashboard.POWER_ON, controller.power_on),
            dashboard.POWER_OFF: granted(dashboard.POWER_OFF, controller.power_off),
            dashboard.BRAKE_RELEASE: granted(dashboard.BRAKE_RELEASE, controller.release_brakes),
            dashboard.UNLOCK_PROTECTIVE_STOP: controller.unlock_protective_stop,
            dashboard.CLOSE_SAFETY_POPUP: granted(dashboard.CLOSE_SAFETY_POPUP, lambda: None),
            dashboard.STOP: granted(
                dashboard.STOP, lambda: controller.stop_program("stopped over the dashboard")
            ),
            dashboard.SHUTDOWN: granted(dashboard.SHUTDOWN, controller.power_off),
            "restart safety": self._restart_safety,
            "pause": lambda: (
                "Pausing program" if controller.pause() else "Failed to execute: pause"
            ),
            "play": lambda: "Starting program" if pendant.play() else "Failed to execute: play",
            "close popup": self._close_popup,
            "clear operational mode": self._clear_mode,
            "savelog": pendant.save_log,
            "generate flight report": lambda: pendant.flight_report(""),
            "addtolog": lambda: "No log message to add",
        }

    def _restart_safety(self) -> str:
        self._controller.release_emergency_stop()
        self._controller.power_off()
        return "Restarting safety"

    def _popup(self, text: str) -> str:
        self._pendant.note(f"popup: {text}")
        return "showing popup"

    def _add_to_log(self, text: str) -> str:
        self._pendant.note(text)
        return "Added log message"

    def _close_popup(self) -> str:
        self._controller.popups.close()
        self._pendant.note("the popup is closed")
        return "closing popup"

    def _set_role(self, role: str) -> str:
        if role.upper() not in USER_ROLES:
            return f"Failed setting user role: {role}"
        self._pendant.user_role = role.upper()
        return f"Setting user role: {role}"

    def _set_mode(self, mode: str) -> str:
        if mode.upper() not in OPERATIONAL_MODES[1:]:
            return f"Failed setting operational mode: {mode}"
        self._pendant.operational_mode = mode.upper()
        return f"Operational mode {mode} is set"

    def _clear_mode(self) -> str:
        self._pendant.operational_mode = "NONE"
        return "No longer controlling the operational mode. Current operational mode: 'NONE'."

    # -- queries ----------------------------------------------------------------------------------

    def _questions(self) -> dict[str, Callable[[], str]]:
        controller, pendant, options = self._controller, self._pendant, self._controller.options
        version = ".".join(str(number) for number in options.version)
        return {
            dashboard.REMOTE_CONTROL: lambda: "true" if controller.remote else "false",
            dashboard.ROBOT_MODE: lambda: f"Robotmode: {controller.mode.name}",
            dashboard.SAFETY_STATUS: lambda: f"Safetystatus: {controller.safety.name}",
            "safetymode": lambda: f"Safetymode: {controller.safety.name}",
            "running": lambda: f"Program running: {'true' if controller.has_program else 'false'}",
            "programstate": self._program_state,
            "get loaded program": lambda: (
                f"Loaded program: {pendant.loaded}" if pendant.loaded else "No program loaded"
            ),
            "isprogramsaved": lambda: f"true {pendant.program_name}".rstrip(),
            "polyscopeversion": lambda: f"URSoftware {version} (simulated)",
            "version": lambda: version,
            "get robot model": lambda: options.robot.upper().rstrip("E"),
            "get serial number": lambda: SERIAL_NUMBER,
            "get operational mode": lambda: pendant.operational_mode,
            "getuserrole": lambda: pendant.user_role,
            "help": self._help,
        }

    def _program_state(self) -> str:
        controller = self._controller
        state = controller.runtime.name if controller.has_program else "STOPPED"
        return f"{state} {self._pendant.program_name or UNNAMED}"

    def _help(self) -> str:
        return f"Available commands: {', '.join(sorted({*self._exact, *self._begins}))}"
