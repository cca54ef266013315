"""Checks of operator devices: permission to open them, and other programs that hold them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from cardan.doctor.base import Check, Finding, Subject, Used, caution, failure, good
from cardan.doctor.processes import Holder, holders, named
from cardan.drivers.base import FoundDevice
from cardan.drivers.udev import udev_rules

GROUP = "devices"

RULES_FOLDERS: Final = (
    "etc/udev/rules.d",
    "run/udev/rules.d",
    "usr/lib/udev/rules.d",
    "lib/udev/rules.d",
)
RULES_FILE: Final = "70-cardan.rules"

INSTALL_RULES: Final = (
    f"cardan devices udev | sudo tee /etc/udev/rules.d/{RULES_FILE} && sudo udevadm control "
    "--reload, then plug the device in again"
)

THREE_D_DRIVERS: Final = frozenset({"spacemouse", "spacemouse_serial"})
"""Drivers whose devices spacenavd opens exclusively; the second is a plug-in's."""


def check_devices(found: Sequence[FoundDevice], wanted: Iterable[Used]) -> Iterator[Finding]:
    """Check that plugged-in devices can be opened. `wanted`: the devices of the files."""
    use = {each.name: each for each in wanted if each.key == "device"}
    for device in found:
        where = f" at {device.path}" if device.path else ""
        what = f"{device.name or device.driver}{where}"
        if not device.obstacle:
            yield good("device", f"{what} can be opened")
            continue
        make = failure if device.driver in use else caution
        why = (
            f"the device of {use[device.driver].session} is read by {device.driver!r}"
            if device.driver in use
            else f"the driver {device.driver!r} cannot use it; no given file asks for it"
        )
        yield make("device", f"{what}: {device.obstacle}", why, _mend(device.obstacle))
    if not found:
        yield good("device", "no device is plugged in that Cardan detects")


def _mend(obstacle: str) -> str:
    if "no permission" in obstacle or "cardan devices udev" in obstacle:
        return INSTALL_RULES
    if "another program" in obstacle:
        return "cardan doctor, as the superuser, names the program: sudo cardan doctor"
    if "set the switch" in obstacle:
        return obstacle[obstacle.index("set the switch") :]
    if "pip install" in obstacle:
        return obstacle[obstacle.index("pip install") :]
    return "unplug it and plug it in again, then: cardan devices"


def check_paths(
    wanted: Iterable[tuple[str, str]], exists: Mapping[str, bool], writable: Mapping[str, bool]
) -> Iterator[Finding]:
    """Check that device nodes named by files exist. `wanted`: session and path of each."""
    for session, path in wanted:
        if not exists[path]:
            yield failure(
                "node",
                f"there is no {path}",
                f"the device of {session} is to be there",
                "plug it in, then: cardan devices; serial ports: ls -l /dev/serial/by-id",
            )
        elif not writable[path]:
            mend = (
                "sudo usermod -aG dialout $USER, then log in again"
                if os.path.basename(path).startswith(("tty", "usb-"))
                else INSTALL_RULES
            )
            yield failure("node", f"no permission for {path}", f"{session} reads it", mend)
        else:
            yield good("node", f"{path} of {session} can be opened")


def check_rules(installed: Mapping[str, str], wanted: str) -> Finding:
    """Check that the udev rules are installed. `installed`: contents of rule files by path."""
    lines = [each for each in wanted.splitlines() if each and not each.startswith("#")]
    if not lines:
        return good("udev", "no driver needs a udev rule")
    there = {line.strip() for text in installed.values() for line in text.splitlines()}
    if missing := [line for line in lines if line not in there]:
        several = len(missing) < len(lines)
        return caution(
            "udev",
            f"{len(missing)} of {len(lines)} udev rules are not installed"
            if several
            else "the udev rules are not installed",
            "only the superuser may open such a device; rules of another release, or changed ones, "
            "count as missing",
            INSTALL_RULES,
        )
    return good("udev", "the udev rules are installed")


def check_spacenavd(pids: Sequence[int], found: Iterable[str], wanted: Iterable[str]) -> Finding:
    """Check that spacenavd does not hold a SpaceMouse. `found` and `wanted`: the drivers of
    plugged-in devices, and of the files."""
    if not pids:
        return good("spacenavd", "spacenavd does not run")
    what = f"spacenavd runs (pid {pids[0]})"
    mend = 'sudo systemctl stop spacenavd, or use its socket: driver = "spnav"'
    if THREE_D_DRIVERS & set(wanted):
        why = "it reads the SpaceMouse, too: its programs get the robot operator's motion"
        return caution("spacenavd", what, why, mend)
    if THREE_D_DRIVERS & set(found):
        return good("spacenavd", f'{what}: driver = "spnav" reads its devices')
    return good("spacenavd", what)


def check_holders(held: Mapping[str, Holder]) -> Iterator[Finding]:
    """Report programs that have device nodes open, by the nodes' paths."""
    for path, holder in held.items():
        if holder.is_ours:
            yield good("holder", f"{path} is read by Cardan: {holder}")
        else:
            yield caution(
                "holder",
                f"{path} is open in {holder}",
                "it gets the device's motion, too; some programs lock others out",
                f"kill {holder.pid}",
            )


class PluggedIn(Check):
    """Plugged-in devices, and the nodes that files name."""

    group, tells = GROUP, ("device", "node")

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        used = list(subject.used())
        yield from check_devices(subject.devices(), used)
        wanted = [(each.session, path) for each in used for path in _nodes(each)]
        exists = {path: os.path.exists(path) for _, path in wanted}
        writable = {path: os.access(path, os.R_OK | os.W_OK) for _, path in wanted}
        yield from check_paths(wanted, exists, writable)


def _nodes(used: Used) -> list[str]:
    """Return the device nodes in a driver's options."""
    path = getattr(used.driver.options, "path", None)
    return [path] if isinstance(path, str) and path.startswith("/dev/") else []


class UdevRules(Check):
    """Udev rules that let the user at the console open devices."""

    group, tells = GROUP, ("udev",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        paths = [
            path for each in RULES_FOLDERS for path in sorted((subject.root / each).glob("*.rules"))
        ]
        texts = {str(path): subject.read_path(path) for path in paths}
        return [check_rules(texts, udev_rules())]


class Holders(Check):
    """Other programs that have a device open, spacenavd among them."""

    group, tells = GROUP, ("spacenavd", "holder")

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        used, found = list(subject.used()), subject.devices()
        yield check_spacenavd(
            named("spacenavd", subject.root),
            [each.driver for each in found],
            [each.name for each in used if each.key == "device"],
        )
        nodes = [each.path for each in found if each.path.startswith("/dev/")]
        nodes += [str(Path(path).resolve()) for each in used for path in _nodes(each)]
        yield from check_holders(holders(nodes, subject.root))
