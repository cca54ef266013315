"""Run of all checks, and reports of their findings for users, for programs, and for an issue."""

from __future__ import annotations

import contextlib
import getpass
import json
import os
import platform
import re
import socket
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from cardan import __version__
from cardan.common.plugins import reason
from cardan.common.resource_errors import shortage
from cardan.doctor import registry
from cardan.doctor.base import Check, Finding, FindingLevel, Subject, failure
from cardan.doctor.installation import EXTRAS, installed_version, own_requirements
from cardan.drivers.access import USB_DEVICES

SHORTEST_SECRET: Final = 2
"""Shortest text that is masked: a shorter one identifies nobody."""

_HARDWARE_ADDRESS = re.compile(r"\b(?:[0-9A-Fa-f]{2}[:-]){5}[0-9A-Fa-f]{2}\b")
_BY_ID = re.compile(r"/dev/(?:serial|input)/by-id/\S+")


class Examined(NamedTuple):
    """Finding with its group."""

    group: str
    finding: Finding


def examine(
    subject: Subject, checks: Mapping[str, type[Check]] | None = None
) -> Iterator[Examined]:
    """Yield the findings of all checks, group by group. An error in a check is a finding."""
    if checks is None:
        loaded = registry.load_all()
        checks = {name: loaded.classes[name] for name in registry.names() if name in loaded.classes}
    groups = list(dict.fromkeys(check.group or name for name, check in checks.items()))
    for group in groups:
        for name, check in checks.items():
            if (check.group or name) == group:
                for finding in _looked(name, check, subject):
                    yield Examined(group, finding)


def _looked(name: str, check: type[Check], subject: Subject) -> list[Finding]:
    try:
        found = list(check.look(subject))
        if other := [each for each in found if not isinstance(each, Finding)]:
            raise TypeError(f"{other[0]!r:.60} is not a Finding")
        return found
    except Exception as error:  # Another package's check may raise any error.
        if shortage(error):
            raise
        return [
            failure(
                "check",
                f"the check {name!r} itself failed: {reason(error)}",
                "what it checks is not known",
                "cardan doctor --report, in an issue of its package",
            )
        ]


def worst(found: Iterable[Examined]) -> FindingLevel:
    """Return the highest level of all findings."""
    levels = {each.finding.level for each in found}
    for level in (FindingLevel.FAILURE, FindingLevel.CAUTION):
        if level in levels:
            return level
    return FindingLevel.GOOD


def as_json(found: Iterable[Examined]) -> str:
    """Return all findings as JSON."""
    found = list(found)
    return json.dumps(
        {
            "version": __version__,
            "level": worst(found).value,
            "findings": [_table(each) for each in found],
        }
    )


def _table(each: Examined) -> dict[str, Any]:
    return {"group": each.group, **each.finding._asdict(), "level": each.finding.level.value}


def report(found: Iterable[Examined], secrets: Iterable[str]) -> str:
    """Return a Markdown report for an issue: versions and findings, without anything that
    identifies a person, a computer or a device."""
    lines = ["```", f"cardan {__version__}, Python {platform.python_version()}"]
    lines.append(f"{platform.system()} {platform.release()} {platform.machine()}, {_system()}")
    wanted = {each.name for each in own_requirements() if each.extra in ("", *EXTRAS)}
    names = sorted(wanted - {"cardan"})
    there = [f"{name} {version}" for name in names if (version := installed_version(name))]
    lines += [", ".join(there), ""]
    group = ""
    for each in found:
        if each.group != group:
            group = each.group
            lines.append(group)
        level = (
            ""
            if each.finding.level is FindingLevel.GOOD
            else f"{each.finding.level.value.upper()} "
        )
        lines.append(f"  {level}[{each.finding.code}] {each.finding.what}")
    lines.append("```")
    return masked("\n".join(lines), secrets)


def _system() -> str:
    try:
        return platform.freedesktop_os_release().get("PRETTY_NAME", "")
    except OSError:
        return "of no known name"


def masked(text: str, secrets: Iterable[str]) -> str:
    """Return `text` without these words, hardware addresses, and names of devices that contain
    their serial number."""
    text = _BY_ID.sub("/dev/.../by-id/***", text)
    text = _HARDWARE_ADDRESS.sub("**:**:**:**:**:**", text)
    for each in sorted(set(secrets), key=len, reverse=True):
        if len(each) >= SHORTEST_SECRET:
            bounds = (r"(?<![\w])", r"(?![\w])") if each[0].isalnum() else ("", "")
            text = re.sub(bounds[0] + re.escape(each) + bounds[1], "***", text)
    return text


def secrets_of(subject: Subject) -> set[str]:
    """Return the texts that a report must not contain: names of this user and computer, home, and
    serial numbers of devices that are plugged in or named by the files."""
    found = {socket.gethostname(), os.path.expanduser("~")}
    with contextlib.suppress(KeyError, OSError):  # User without a name.
        found.add(getpass.getuser())
    for each in USB_DEVICES.glob("*/serial"):
        try:
            found.add(each.read_text(errors="replace").strip())
        except OSError:
            continue
    for used in subject.used():
        if isinstance(serial := getattr(used.driver.options, "serial", None), str):
            found.add(serial)
    # Words that identify nobody, and are needed to read a report.
    return found - {"", "/", "root", "/root", "localhost"}
