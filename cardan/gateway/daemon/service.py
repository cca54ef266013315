"""The daemon as a service of systemd: its unit, and the unit's path."""

from __future__ import annotations

import grp
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from cardan.errors import ConfigurationError, DriverError
from cardan.gateway.session.session import EXIT_CONFIGURATION

NAME: Final = "cardan.service"

WATCHDOG_S: Final = 10
"""Longest time between watchdog messages of a daemon whose sessions all answer, before it is
restarted."""

STOP_S: Final = 20
"""Longest time for all arms to brake and all sessions to leave."""

ABORT_S: Final = 2
"""Longest time for a daemon that has not fed its watchdog to end by SIGABRT: one that is stopped
(SIGSTOP) does not."""

GROUPS: Final = ("input", "dialout", "plugdev")
"""Groups to which udev's rules give operator devices, if this computer has them."""

OWN_FOLDERS: Final = (Path("/tmp"), Path("/var/tmp"))
"""Folders that a service of the computer has private copies of."""

_UNIT = """[Unit]
Description=Cardan: teleoperation of robot arms
{after}
[Service]
Type=notify
ExecStart={command}
ExecReload=/bin/kill -HUP $MAINPID
{account}Restart=always
RestartSec=1
# A configuration that is wrong stays so.
RestartPreventExitStatus={misconfigured}
WatchdogSec={watchdog_s}
TimeoutAbortSec={abort_s}
# However the daemon ends, its sessions are asked to end, too, and have this time to brake.
TimeoutStopSec={stop_s}
KillMode=control-group
# The loops ask for real-time scheduling, and for memory that stays where it is.
LimitRTPRIO=90
LimitMEMLOCK=infinity
# It opens devices and networks, and needs nothing else of the system.
NoNewPrivileges=yes
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM
RestrictNamespaces=yes
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK AF_BLUETOOTH AF_CAN
{hardening}
[Install]
WantedBy={target}
"""

_SYSTEM_HARDENING = """RuntimeDirectory=cardan
RuntimeDirectoryMode=0755
Environment=XDG_RUNTIME_DIR=/run/cardan
ProtectSystem=strict
ProtectHome=read-only
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectKernelTunables=yes
ProtectControlGroups=yes
ProtectHostname=yes
ProtectProc=invisible
PrivateTmp=yes
RestrictSUIDSGID=yes
LockPersonality=yes
StateDirectory=cardan
LogsDirectory=cardan
# Devices stay as they are: udev's rules say who may open them (`cardan devices udev`). What names
# classes of devices (DevicePolicy=, PrivateDevices=, ProtectClock=) would keep those away whose
# driver the kernel loads when one is plugged in.
{groups}"""


class SystemdUnit(NamedTuple):
    """A unit, and its path."""

    path: Path
    text: str
    user: bool
    """True for the user's own service manager."""

    @property
    def systemctl(self) -> list[str]:
        """Command that controls its service manager."""
        return ["systemctl", *(["--user"] if self.user else [])]


def make_service(files: Sequence[Path], *, system: bool, account: str) -> SystemdUnit:
    """Make the service that serves `files`: of the system, as the user `account`, or of this user.
    Raises ConfigurationError for missing files."""
    for file in files:
        if not file.exists():
            raise ConfigurationError("FILE", f"there is no {file}")
    if system:
        for path in (*(file.resolve() for file in files), Path(sys.executable)):
            _check_found(path)
    if not files:
        raise ConfigurationError("FILE", "which files is the daemon to serve?")
    words = [
        sys.executable,
        "-m",
        "cardan",
        "daemon",
        "run",
        *(str(file.resolve()) for file in files),
    ]
    text = _UNIT.format(
        command=" ".join(_quoted(word) for word in words),
        after="After=network-online.target\nWants=network-online.target\n" if system else "",
        account=f"User={account}\n" if system else "",
        watchdog_s=WATCHDOG_S,
        stop_s=STOP_S,
        abort_s=ABORT_S,
        misconfigured=EXIT_CONFIGURATION,
        hardening=_SYSTEM_HARDENING.format(groups=_groups()) if system else "",
        target="multi-user.target" if system else "default.target",
    )
    return SystemdUnit(_folder(system) / NAME, text, user=not system)


def _check_found(path: Path) -> None:
    for folder in OWN_FOLDERS:
        if path.is_relative_to(folder):
            raise ConfigurationError(
                "FILE",
                f"a service of the computer has a {folder} of its own and would not find {path}: "
                "put it elsewhere, /etc/cardan for one",
            )


def _groups() -> str:
    """Return the setting that joins the groups of operator devices: systemd starts nothing with a
    missing one."""
    known = {group.gr_name for group in grp.getgrall()}
    names = [name for name in GROUPS if name in known]
    return f"SupplementaryGroups={' '.join(names)}\n" if names else ""


def _quoted(word: str) -> str:
    """Quote a word of a command line according to systemd.service(5)."""
    word = word.replace("%", "%%").replace("$", "$$")
    return word if word == shlex.quote(word) else '"' + word.replace('"', '\\"') + '"'


def _folder(system: bool) -> Path:
    if system:
        return Path("/etc/systemd/system")
    home = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    return Path(home) / "systemd" / "user"


def installed(system: bool) -> SystemdUnit:
    """Return the service that is installed, or would be."""
    return SystemdUnit(_folder(system) / NAME, "", user=not system)


def is_outdated(service: SystemdUnit) -> bool:
    """Return whether the installed unit starts the daemon by its name before 0.2.0, which ends at
    once; False if it cannot be read."""
    try:
        text = service.path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return re.search(r"^ExecStart=.*\bcardan\b.*\sserve(\s|$)", text, re.MULTILINE) is not None


def install(service: SystemdUnit) -> list[str]:
    """Write the unit and start it, now and with the computer; return the steps, in lines. Raises
    DriverError if that is refused."""
    try:
        service.path.parent.mkdir(parents=True, exist_ok=True)
        service.path.write_text(service.text)
    except OSError as error:
        advice = "" if service.user else ": run it with sudo, or leave --system out"
        raise DriverError(f"cannot write {service.path}: {error.strerror}{advice}") from None
    done = [f"wrote {service.path}"]
    for words in (["daemon-reload"], ["enable", "--now", NAME]):
        _run([*service.systemctl, *words])
        done.append(" ".join([*service.systemctl, *words]))
    return done


def remove(service: SystemdUnit) -> list[str]:
    """End the service and remove its unit; return the steps, in lines. Raises DriverError."""
    if not service.path.exists():
        raise DriverError(f"there is no {service.path}: nothing was installed")
    _run([*service.systemctl, "disable", "--now", NAME])
    try:
        service.path.unlink()
    except OSError as error:
        raise DriverError(f"cannot remove {service.path}: {error.strerror}") from None
    _run([*service.systemctl, "daemon-reload"])
    return [f"removed {service.path}"]


def _run(words: list[str]) -> None:
    try:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        raise DriverError(
            f"there is no {words[0]}: this computer has no systemd; run `cardan daemon run` by "
            "what it starts its services with"
        ) from None
    if done.returncode:
        raise DriverError(f"`{' '.join(words)}`: {done.stderr.strip() or done.returncode}")
