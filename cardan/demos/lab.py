"""Runs the example of a lab without hardware: its simulated peers and ``cardan daemon run`` with
its file, as separate processes, displayed as by ``cardan daemon top``."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from rich.console import Console

from cardan.common.signals import on_ending
from cardan.common.tables import as_toml
from cardan.demos.demo import EXIT_INCOMPLETE, WELL_FOLLOWED_M
from cardan.demos.examples import Demo
from cardan.demos.peers import Peers
from cardan.demos.safety import check_unattended
from cardan.errors import ConfigurationError
from cardan.gateway.daemon import view
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.daemon.config import DaemonConfig, read_daemon_config
from cardan.gateway.daemon.processes import ENDS_WITHIN_S
from cardan.gateway.session.live_display import LivePanel
from cardan.gateway.session.session import EXIT_OK
from cardan.gateway.session.subprocesses import READY_WITHIN_S, CardanSubprocess

POLL_S: Final = 0.1
"""Period of looking at the lab, which is the daemon's own."""

READY_S: Final = 60.0
"""Longest time until all arms are present: the daemon and each session import their arms' models,
on two cores under load."""

SHOWN_S: Final = 0.5
"""Period of the display on a terminal, which is that of ``cardan daemon top``."""

PRINTED_S: Final = 5.0
"""Period of the printed rows without a terminal."""


@contextlib.contextmanager
def simulated_lab(
    demo: Demo, seconds: float
) -> Iterator[tuple[Peers, DaemonConfig, CardanSubprocess]]:
    """Run all programs that the demo launches, and the daemon, for `seconds` and the time of
    starting and ending. Yields the peers, the file's configuration, and the daemon."""
    peers = Peers(demo, READY_WITHIN_S + READY_S + seconds + ENDS_WITHIN_S)
    if "daemon" in peers.tables:
        raise ConfigurationError(f"{demo.file}: daemon", "the demo has a daemon of its own")
    peers.tables["daemon"] = {
        "socket": str(peers.folder / "cardan.sock"),
        "event_log": str(peers.folder / "events.jsonl"),
    }
    with peers:
        file = write_lab(peers)
        config = read_daemon_config([file])
        _check_simulated(demo, peers.tables, config)
        peers.start_all()
        daemon = CardanSubprocess(
            "daemon",
            "run",
            file.name,
            *peers.until,
            folder=peers.folder,
            ready_within_s=READY_S,
            end_within_s=ENDS_WITHIN_S,
        )
        try:
            yield peers, config, daemon
        finally:
            daemon.end()


def write_lab(peers: Peers) -> Path:
    """Write the lab's file into the demo's folder."""
    file = peers.folder / "lab.toml"
    # Replaced atomically: a reader sees the old file or the new one, whole.
    fresh = file.with_suffix(".new")
    fresh.write_text(as_toml(peers.tables), encoding="utf-8")
    return fresh.replace(file)


def _check_simulated(demo: Demo, tables: Mapping[str, Any], config: DaemonConfig) -> None:
    """Raise ConfigurationError unless all that the lab reaches is simulated."""
    if config.servers:
        raise ConfigurationError(f"{demo.file}: servers", "a demo has none: others could reach it")
    for table in tables["sessions"]:
        names = {
            key: f"{key}s.{table[key]}"
            for key in ("device", "robot")
            if isinstance(table.get(key), str)
        }
        check_unattended(demo, config.sessions[table["name"]].config, names)


class ObservedArms:
    """Observations of the arms of these sessions."""

    def __init__(self, sessions: Iterable[str]) -> None:
        self._absent = dict.fromkeys(sessions)
        self._moved = False
        self._errors_m: dict[str, float] = {}

    def take(self, rows: Iterable[view.Row]) -> None:
        """Record the daemon's rows about these sessions."""
        for row in rows:
            snapshot = row["snapshot"]
            if row["robot_link"] == "live":
                self._absent.pop(row["name"], None)
            if snapshot is not None and snapshot["arm"]["phase"]:
                tracking = snapshot["tracking"]
                self._moved |= tracking["path_m"] > 0.0
                before = self._errors_m.get(row["name"], 0.0)
                self._errors_m[row["name"]] = max(before, tracking["error_max_m"])

    @property
    def all_there(self) -> bool:
        """Return True if each robot has been present."""
        return not self._absent

    def problems(self) -> list[str]:
        """Return deviations from the expected course."""
        found = [f"the robot of {name} was never connected" for name in self._absent]
        if not self._moved:
            found.append("no path was commanded")
        found += [
            f"{name} was {1e3 * error_m:.0f} mm away from its reference "
            f"(expected: {1e3 * WELL_FOLLOWED_M:.0f} mm)"
            for name, error_m in self._errors_m.items()
            if error_m > WELL_FOLLOWED_M
        ]
        return found


def run_lab(demo: Demo, seconds: float) -> int:
    """Run the demo for `seconds` after all arms are present; return the exit code."""
    signals: list[int] = []
    console = Console()
    console.print(demo.description, markup=False)
    with (
        on_ending(signals.append),
        simulated_lab(demo, seconds) as (_, config, daemon),
        LivePanel(console, transient=False) as panel,
        ControlClient(daemon.endpoint) as client,
    ):
        seen = ObservedArms(config.sessions)
        end_s, show_s, waiting = time.monotonic() + READY_S, 0.0, True
        while not signals and time.monotonic() < end_s:
            time.sleep(POLL_S)
            rows = client.ask("figures")["units"]
            seen.take(rows)
            if waiting and seen.all_there:
                waiting, end_s = False, time.monotonic() + seconds
            if time.monotonic() >= show_s:
                show_s = time.monotonic() + (SHOWN_S if panel.drawn else PRINTED_S)
                view.show(rows, console, panel)
    if signals:
        console.print("ended early: not judged")
        return EXIT_OK
    problems = seen.problems()
    if daemon.code != EXIT_OK:
        problems.append(f"the daemon ended with status {daemon.code}: {daemon.complaints}")
    for line in problems:
        print(f"cardan demo: {line}", file=sys.stderr)
    if not problems:
        console.print(demo.success_message, markup=False)
    return EXIT_INCOMPLETE if problems else EXIT_OK
