"""Acceptance test of a lab of four arms and three devices.

The simulated devices and robots, and `cardan daemon run` with the lab's file, run as processes,
started as any other program would start them. This module does the work of the lab's users from
outside: it unplugs a device and plugs it in again, kills a session, changes a key of the file, and
passes a device on. It judges the result by the published state.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, NamedTuple

from cardan.common.text_sanitizer import printable
from cardan.demos.demo import WELL_FOLLOWED_M, choose_demo
from cardan.demos.examples import Demo
from cardan.demos.lab import POLL_S, READY_S, simulated_lab, write_lab
from cardan.demos.peers import Peers
from cardan.errors import ConfigurationError, MotionLoopError, MotionRefusedError
from cardan.gateway.arm.verb_results import Motion, Outcome
from cardan.gateway.daemon import view
from cardan.gateway.daemon.changes import Change
from cardan.gateway.daemon.client import RELOAD_S, ControlClient, daemon_arm
from cardan.gateway.daemon.config import DaemonConfig, sharers
from cardan.gateway.daemon.services import ENGAGED
from cardan.gateway.session.session import EXIT_OK

STEP_S: Final = 30.0
"""Longest time for one thing to happen: 5 s, on a computer with nothing else to do."""

STEPS: Final = 12
"""Number of steps of the test."""

UNPLUGGED_S: Final = 1.5
"""Time for which a device stays unplugged."""

MOVED_M: Final = 0.01
"""Least motion of each arm's TCP: a stroke is 4 cm."""

STOOD_M: Final = 0.001
"""Greatest motion of the TCP of an arm at rest: noise of its encoders."""

SETTLES_S: Final = 1.0
"""Time until a disarmed arm has settled within about 0.1 mm: the position law of EGM removes two
thirds of an error of 2 mm in 0.3 s."""

LIFT_M: Final = 0.05
"""Distance of the motion that the verb commands."""

SLOWER: Final = 0.8
"""Factor that the changed configuration applies to a speed."""


class Roles(NamedTuple):
    """Session or device of each role."""

    unplugged: str
    """The session whose device is unplugged and plugged in again."""
    device: str
    """The device that is unplugged."""
    killed: str
    """The session whose process is killed; it does not share its device."""
    shared: str
    """A device that two sessions share."""
    first: str
    """The session that has the shared device first, and whose configuration is changed."""
    second: str
    """The session that gets the shared device later; until then verbs move its arm."""


class NotSeenError(Exception):
    """An expected event did not happen in time."""


def live_in_lab(say: Callable[[str], None] = print) -> list[str]:
    """Run the lab example through all steps; `say` receives progress messages. Returns a list of
    problems."""
    demo, problems = choose_demo("lab"), []
    with (
        simulated_lab(demo, STEPS * STEP_S) as (peers, config, daemon),
        ControlClient(daemon.endpoint) as client,
    ):
        lab = Lab(Hardware(demo, peers, config), daemon.endpoint, client, say)
        try:
            lab.perform()
        except NotSeenError as error:
            problems.append(str(error))
    if daemon.code != EXIT_OK:
        problems.append(f"the daemon ended with status {daemon.code}: {daemon.complaints}")
    for line in lab.summary():
        say(line)
    return [*problems, *lab.problems, *lab.left_behind(peers.folder)]


class Hardware:
    """Simulated hardware of the lab, and the lab's file."""

    def __init__(self, demo: Demo, peers: Peers, config: DaemonConfig) -> None:
        self.sessions = tuple(config.sessions)
        self.roles = _roles_of(demo, config)
        self._peers = peers

    def unplug(self, device: str) -> None:
        """Unplug a device."""
        self._peers.end(self._of(device))

    def plug(self, device: str) -> None:
        """Plug it in again."""
        self._peers.start(self._of(device))

    def change(self, session: str) -> None:
        """Lower the speed of a session's operator device in the lab's file."""
        (table,) = (each for each in self._peers.tables["sessions"] if each["name"] == session)
        speed_m_s = table["mapping"]["linear_speed_m_s"]
        table["mapping"]["linear_speed_m_s"] = round(speed_m_s * SLOWER, 6)
        write_lab(self._peers)

    def _of(self, device: str) -> int:
        """Index of the command that simulates a device, found by the device's path."""
        path = self._peers.tables["devices"][device]["path"]
        return next(
            index
            for index, words in enumerate(self._peers.commands)
            if any(word.endswith(f"={path}") for word in words)
        )


def _roles_of(demo: Demo, config: DaemonConfig) -> Roles:
    alone = [
        (name, entry.device)
        for name, entry in config.sessions.items()
        if entry.device and not any(name in names for names in sharers(config.sessions).values())
    ]
    shared = [(device, *names) for device, names in sharers(config.sessions).items()]
    if len(alone) < 2 or not shared:
        raise ConfigurationError(
            f"{demo.file}: sessions",
            "this demo needs two sessions with a device for itself, and two that share one",
        )
    return Roles(*alone[0], alone[1][0], *shared[0][:3])


class Arm:
    """Observed state of an arm."""

    def __init__(self) -> None:
        self.row: view.Row = {}
        self.first: list[float] = []
        """Initial position of the TCP, m."""
        self.moved_m = 0.0
        """Largest distance from the initial position so far, m."""
        self.moved_by: set[str] = set()
        self.error_max_m = 0.0
        self.phases: list[str] = []
        """Phases of the process that runs now."""
        self.trips = 0

    @property
    def position(self) -> list[float]:
        """Position of the TCP, m; empty if unknown."""
        snapshot = self.row["snapshot"]
        pose: list[float] = [] if snapshot is None else snapshot["robot"]["pose"]
        return pose[:3]

    def take(self, row: view.Row) -> None:
        if row["pid"] != self.row.get("pid"):
            self.phases.clear()
        self.row = row
        snapshot = row["snapshot"]
        if snapshot is None or not (arm := snapshot["arm"])["phase"]:
            return
        if self.phases[-1:] != [arm["phase"]]:
            self.phases.append(arm["phase"])
        self.error_max_m = max(self.error_max_m, snapshot["tracking"]["error_max_m"])
        self.trips = max(self.trips, arm["trips"])
        if row["robot_link"] == "live" and len(self.position) == 3:
            self.first = self.first or self.position
            self.moved_m = max(self.moved_m, math.dist(self.first, self.position))
        if arm["phase"] == "moving":
            self.moved_by.add(arm["authority"])


class Lab:
    """The running lab: actions of its users, and its observed state."""

    def __init__(
        self, hardware: Hardware, socket: str, client: ControlClient, say: Callable[[str], None]
    ) -> None:
        self.problems: list[str] = []
        self._hardware, self._socket, self._client, self._say = hardware, socket, client, say
        self._arms = {name: Arm() for name in hardware.sessions}
        self._pids: set[int] = set()
        self._parked: dict[str, list[float]] = {}
        """Arms that must not move: position by session."""
        self._done: list[str] = []

    # -- events ----------------------------------------------------------------------------------

    def perform(self) -> None:
        """Carry out all steps."""
        roles, arms = self._hardware.roles, self._arms
        self._until(
            f"all {len(arms)} robots are there",
            lambda: all(each.row.get("robot_link") == "live" for each in arms.values()),
            READY_S,
        )
        self._say(f"all {len(arms)} arms are there; hands move three of them, a verb the fourth")
        self._move_by_verb(roles.second)
        self._until(
            "each arm has moved", lambda: all(each.moved_m >= MOVED_M for each in arms.values())
        )
        self._done.append("each arm moved")
        self._unplug(roles.unplugged, roles.device)
        unplugged_s = time.monotonic()
        pid = self._kill(roles.killed)
        old_pid = self._reload(roles.first)
        self._until("the device stays away", lambda: time.monotonic() >= unplugged_s + UNPLUGGED_S)
        self._plug(roles.unplugged, roles.device)
        self._pass_on(roles.shared, roles.first, roles.second)
        self._came_back(roles.killed, pid)
        self._until(
            f"{roles.first} was restarted with its changed configuration",
            lambda: (
                arms[roles.first].row["pid"] not in (old_pid, None)
                and arms[roles.first].row["phase"] == "disarmed"
            ),
        )
        self._done.append(f"{roles.first} was restarted with what was changed")

    def _move_by_verb(self, name: str) -> None:
        with daemon_arm(name, path=self._socket) as arm:
            pose = list(arm.stat().pose)
            pose[2] += LIFT_M
            motions: list[Motion] = []

            def moved() -> bool:
                if motions and not motions[-1].over:
                    return False
                if not motions or motions[-1].outcome is not Outcome.DONE:
                    # A busy computer sometimes brakes the arm; a second request completes the
                    # motion.
                    with contextlib.suppress(MotionRefusedError):
                        motions.append(arm.movl(pose))
                    return False
                return True

            self._until(f"the verb has moved {name}", moved)
            # The session carries out a release even if its response is late.
            with contextlib.suppress(MotionLoopError):
                arm.release()

    def _unplug(self, name: str, device: str) -> None:
        arm = self._arms[name]
        self._say(f"{device}, the device of {name}, is unplugged")
        self._hardware.unplug(device)
        self._until(f"{name} stops", lambda: arm.row["phase"] == "disarmed" and not _live(arm))
        stopped_s = time.monotonic()
        self._until("its servos settle", lambda: time.monotonic() >= stopped_s + SETTLES_S)
        self._parked[name] = arm.position
        self._done.append(f"{name} stopped when its device was unplugged")

    def _plug(self, name: str, device: str) -> None:
        arm = self._arms[name]
        self._say(f"{device} is plugged in again: the dead-man has to be pressed anew")
        self._hardware.plug(device)
        plugged_s = time.monotonic()
        self._until(f"{device} is found again", lambda: _live(arm))
        found_s = time.monotonic() - plugged_s
        self._parked.pop(name, None)
        if _armed_by_plugging(self._client.ask("events", name)):
            self.problems.append(f"plugging {device} in armed {name}")
        self._until(f"{name} moves again", lambda: arm.row["phase"] == "moving")
        self._done.append(
            f"{device} was found {found_s:.1f} s after it was plugged in; "
            f"{name} stood until the dead-man was pressed"
        )

    def _kill(self, name: str) -> int:
        pid: int = self._arms[name].row["pid"]
        self._say(f"the process of {name} is killed (SIGKILL, {pid})")
        os.kill(pid, signal.SIGKILL)
        return pid

    def _came_back(self, name: str, pid: int) -> None:
        arm = self._arms[name]
        self._until(f"{name} comes back", lambda: arm.row["pid"] not in (pid, None))
        self._until(f"{name} moves again", lambda: arm.row["phase"] == "moving")
        # The new process must report "disarmed" before it is armed.
        before = arm.phases[: next(i for i, each in enumerate(arm.phases) if each in ENGAGED)]
        if "disarmed" not in before:
            self.problems.append(f"{name} came back armed: {', '.join(arm.phases)}")
        self._done.append(f"{name} was killed, came back disarmed, and was armed by its hand")

    def _reload(self, name: str) -> int:
        pid: int = self._arms[name].row["pid"]
        self._say(f"a key of {name} is changed, then `cardan daemon reload`:")
        self._hardware.change(name)
        with ControlClient(self._socket, RELOAD_S) as client, ThreadPoolExecutor(1) as beside:
            reported = beside.submit(client.ask, "reload", value=False)
            self._until("the reload is over", reported.done, RELOAD_S)
            changes = [Change(**each) for each in reported.result()]
        for change in changes:
            self._say(f"  {printable(change.in_words)}")
        if [change.name for change in changes] != [name]:
            self.problems.append(f"one key of {name} was changed, and reload told {changes}")
        self._done += [f"reload: {printable(change.in_words)}" for change in changes]
        return pid

    def _pass_on(self, device: str, first: str, second: str) -> None:
        one, other = self._arms[first], self._arms[second]
        self._say(f"`cardan daemon switch {device} {second}`: it goes from {first} to {second}")
        self._client.ask("switch", device, second)
        self._until(
            f"{second} has {device}",
            lambda: other.row["device_held"] and not one.row["device_held"] and _live(other),
        )
        self._until(f"the hand moves {second}", lambda: "device" in other.moved_by)
        self._done.append(f"{device} went from {first} to {second}")

    # -- observations ----------------------------------------------------------------------------

    def _until(self, what: str, found: Callable[[], bool], within_s: float = STEP_S) -> None:
        give_up_s = time.monotonic() + within_s
        self._poll()
        while not found():
            if time.monotonic() >= give_up_s:
                raise NotSeenError(f"this did not happen within {within_s:.0f} s: {what}")
            self._poll()

    def _poll(self) -> None:
        time.sleep(POLL_S)
        rows = self._client.ask("figures")["units"]
        for row in rows:
            if row["pid"] is not None:
                self._pids.add(row["pid"])
            if row["name"] in self._arms:
                self._arms[row["name"]].take(row)
        for name, where in self._parked.items():
            arm = self._arms[name]
            # On a busy computer, the first row that has the device again may already have the arm
            # armed.
            if _live(arm):
                continue
            if arm.row["phase"] in ENGAGED or math.dist(where, arm.position) > STOOD_M:
                self.problems.append(f"{name} moved, though its device was away")
                del self._parked[name]
                break

    def left_behind(self, folder: Path) -> list[str]:
        """List files and processes that are left after the end, and the errors of each arm."""
        found = [
            f"{name} was {1e3 * arm.error_max_m:.0f} mm away from its reference"
            for name, arm in self._arms.items()
            if arm.error_max_m > WELL_FOLLOWED_M
        ]
        if left := sorted(pid for pid in self._pids if _runs(pid)):
            found.append(f"processes were left behind: {left}")
        if folder.exists():
            found.append(f"{folder} was left behind")
        return found

    def summary(self) -> list[str]:
        """Return the events as lines of text."""
        lines = ["what happened:", *(f"  {each}" for each in self._done)]
        for name, arm in self._arms.items():
            by = " and ".join(sorted(arm.moved_by - {""})) or "nobody"
            lines.append(
                f"  {name}: {1e3 * arm.moved_m:.0f} mm by {by}, "
                f"at most {1e3 * arm.error_max_m:.1f} mm from its reference"
            )
        return lines


def _armed_by_plugging(events: Sequence[Mapping[str, Any]]) -> bool:
    """True if the arm was armed between the loss of its device and its return."""
    order = [(each["event"], each["what"]) for each in events]
    gone = max((i for i, each in enumerate(order) if each == ("device", "lost")), default=0)
    until_back = itertools.takewhile(lambda each: each != ("device", "live"), order[gone:])
    return any(each in (("arm", "holding"), ("arm", "moving")) for each in until_back)


def _live(arm: Arm) -> bool:
    return bool(arm.row["device_link"] == "live")


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:  # The id belongs to another user's process.
        return False
    return True
