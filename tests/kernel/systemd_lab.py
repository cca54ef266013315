"""A computer with systemd as its first process, and the service that `cardan daemon service
install` makes.

No part of systemd is simulated: it starts the daemon, gets its notifications, watches and restarts
it. The events of a SpaceMouse pass through the kernel, udev's rules and the unit's hardening.
"""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, TypeVar

import pytest

from cardan.drivers.udev import udev_rules
from cardan.gateway.daemon import service as service_module
from cardan.gateway.daemon.client import SYSTEM_SOCKET, ControlClient
from cardan.gateway.daemon.service import NAME, install, make_service, remove
from cardan.sim_peers.egm_controller import EgmControllerOptions, EgmControllerPeer
from cardan.sim_peers.spacemouse.peer import SpaceMousePeer, SpaceMousePeerOptions
from tests.kernel.waiting import in_a_process, wait_for

_T = TypeVar("_T")

CHECKOUT = Path(__file__).resolve().parents[2]
RULES = Path("/run/udev/rules.d/70-cardan.rules")
LAB, LAB_ID = "lab", 2000
STARTS_WITHIN_S = 200.0
"""Longest wait: an emulated processor starts the daemon and its session in about ten seconds, and
may be busy."""
POLL_S = 0.5
"""Period of polling: each poll starts a program, which slows the awaited event down."""
COMMAND_S = 300.0
"""Longest time of a command: `systemctl start` waits for the daemon."""
PEERS_S = 1500.0
"""Lifetime of the simulated peers; in the emulator the tests take minutes."""
PORT = 6510
PERIOD_S = 0.04
"""Period of the simulated controller; 4 ms are too short for this processor."""

LAYOUT = """
[[sessions]]
name = "gofa"
device = {{ driver = "spacemouse", wait_for_device = true }}
robot = {{ driver = "abb_egm", listen_port = {port} }}
[sessions.mapping]
deadman = "left"
linear_speed_m_s = {speed_m_s}
"""
HAND = """
0.2  axes 0 0 0.2 0 0 0 over 0.1
0.3  neutral over 0.1
1.0  press first
1.2  swing 0 0.3 0 0 0 0 over 2
3.4  release first
4.0  loop
"""


def run(*words: str, check: bool = True) -> str:
    done = subprocess.run(words, capture_output=True, text=True, timeout=COMMAND_S, check=False)
    assert not check or done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
    return done.stdout


def wait(ask: Callable[[], _T]) -> _T:
    """First true result of `ask`, which starts a program."""
    return wait_for(ask, STARTS_WITHIN_S, POLL_S)


def overlay(folder: Path, scratch: Path) -> None:
    """Make `folder` writable on this computer, and accessible to every user."""
    place = scratch / str(folder).strip("/").replace("/", "-")
    for name in ("upper", "work"):
        (place / name).mkdir(parents=True)
        (place / name).chmod(0o755)
    options = f"lowerdir={folder},upperdir={place}/upper,workdir={place}/work"
    run("mount", "-t", "overlay", "overlay", "-o", options, str(folder))


@pytest.fixture(scope="module")
def computer(tmp_path_factory: pytest.TempPathFactory) -> None:
    """A computer with writable folders and a user account for the lab that can read this
    checkout."""
    assert Path("/proc/1/comm").read_text() == "systemd\n"
    from tests.kernel.conftest import load_module

    for name in ("overlay", "uhid", "hid-generic"):
        load_module(name)
    scratch = Path("/run/overlays")
    for folder in ("/etc", "/var"):
        overlay(Path(folder), scratch)
    for path in (CHECKOUT, Path(sys.prefix), Path(sys.executable).resolve()):
        for folder in (*reversed(path.parents), path):
            if folder.is_dir() and not folder.stat().st_mode & stat.S_IXOTH:
                overlay(folder, scratch)
    with open("/etc/passwd", "a") as users, open("/etc/group", "a") as groups:
        users.write(f"{LAB}:x:{LAB_ID}:{LAB_ID}::/run/{LAB}:/bin/sh\n")
        groups.write(f"{LAB}:x:{LAB_ID}:\n")
        known = Path("/etc/group").read_text()
        for number, name in enumerate(("input", "dialout", "plugdev"), LAB_ID + 1):
            if f"\n{name}:" not in known:
                groups.write(f"{name}:x:{number}:\n")
    for folder, owner in (("/etc/cardan", 0), (f"/run/{LAB}", LAB_ID)):
        os.mkdir(folder, 0o755)
        os.chown(folder, owner, owner)
    # A service's user has no seat: the edit that the head of `cardan devices udev` describes.
    RULES.write_text(udev_rules().replace('MODE="0660"', 'MODE="0660", GROUP="plugdev"'))
    run("udevadm", "control", "--reload")


class Lab:
    """The service, and a client of it."""

    def __init__(self, socket: str, *systemctl: str, **options: Any) -> None:
        self.socket = socket
        self._systemctl, self._options = systemctl, options

    def systemctl(self, *words: str) -> str:
        done = subprocess.run(
            ["systemctl", *self._systemctl, *words],
            capture_output=True, text=True, timeout=COMMAND_S, check=False, **self._options,
        )  # fmt: skip
        assert done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
        return done.stdout

    def shows(self, name: str) -> str:
        return self.systemctl("show", "--value", "-p", name, NAME).strip()

    def ask(self, *words: Any) -> Any:
        with ControlClient(self.socket) as client:
            return client.ask(*words)

    def row(self) -> dict[str, Any]:
        return self.ask("units", "gofa")[0]

    def until(self, *phases: str) -> dict[str, Any]:
        """Wait until the session's arm is in one of these phases; return its row."""

        def found() -> dict[str, Any] | None:
            try:
                row = self.row()
            except Exception:  # the daemon is still starting
                return None
            return row if row["phase"] in phases else None

        try:
            return wait(found)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{explained()}") from None

    @property
    def pid(self) -> int:
        return int(self.shows("MainPID"))


def journal(unit: str, *matches: str) -> list[dict[str, Any]]:
    out = run("journalctl", "--no-pager", "-o", "json", f"_SYSTEMD_UNIT={unit}", *matches)
    return [json.loads(line) for line in out.splitlines()]


def explained() -> str:
    """Return the messages of the service, systemd and the processes, to explain a failed test."""
    said = ("journalctl", "--no-pager", "-n", "60", "_TRANSPORT=stdout", "+", "_TRANSPORT=journal")
    shown = ("ps", "-eo", "pid,ppid,user,stat,time,supgrp,args", "--ppid", "2", "-N")
    node = ("sh", "-c", "ls -l /dev/hidraw*; udevadm info --query=all /dev/hidraw0")
    return "\n".join(
        run(*words, check=False)
        for words in (said, ("systemctl", "--no-pager", "status", NAME), shown, node)
    )


def systemds_words() -> str:
    """Return systemd's own messages about the service."""
    return run("journalctl", "--no-pager", "-o", "cat", "_PID=1", f"UNIT={NAME}")


@pytest.fixture(scope="module")
def hardware(computer: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A simulated SpaceMouse at the kernel and a simulated GoFa; yields the path of the lab's
    file."""
    script = tmp_path_factory.mktemp("hand") / "script"
    script.write_text(HAND)
    # A Bluetooth model: with uhid there is no USB device whose ids the rules for USB could match.
    bluetooth = "spacemouse-wireless-bt"
    puck = SpaceMousePeerOptions(uhid=True, model=bluetooth, script=str(script))
    arm = EgmControllerOptions(pc_port=PORT, period_s=PERIOD_S)
    with ExitStack() as peers:
        for peer in (SpaceMousePeer(puck), EgmControllerPeer(arm)):
            peers.enter_context(in_a_process(peer, PEERS_S))
        yield "/etc/cardan/lab.toml"


def write_layout(file: str, speed_m_s: float) -> None:
    Path(file).write_text(LAYOUT.format(port=PORT, speed_m_s=speed_m_s))


@pytest.fixture(scope="module")
def lab(hardware: str) -> Iterator[Lab]:
    write_layout(hardware, 0.1)
    settings = f"[Service]\nTimeoutStartSec={COMMAND_S:.0f}\n"
    with pytest.MonkeyPatch.context() as patch:
        if any(Path(sys.executable).is_relative_to(each) for each in service_module.OWN_FOLDERS):
            # A checkout below /tmp: a service with a private /tmp would not find the program.
            patch.setattr(service_module, "OWN_FOLDERS", ())
            settings += "PrivateTmp=no\n"
        service = make_service([Path(hardware)], system=True, account=LAB)
    drop_in = service.path.with_name(f"{NAME}.d") / "test.conf"
    drop_in.parent.mkdir(parents=True)
    drop_in.write_text(settings)
    lab = Lab(SYSTEM_SOCKET)
    try:
        install(service)
        yield lab
    finally:
        if sys.exc_info()[0] is not None:
            print(explained())
    remove(service)
    assert not Path(SYSTEM_SOCKET).exists()
