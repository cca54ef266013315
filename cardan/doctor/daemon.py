"""Checks of the daemon: state, and failures of its units."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from cardan.doctor.base import Check, Finding, Subject, caution, failure, good
from cardan.errors import CardanError
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.daemon.restart_policy import UnitState
from cardan.gateway.daemon.service import SystemdUnit, installed, is_outdated

GROUP = "daemon"


def check_units(rows: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Yield findings about the daemon's sessions and servers. `rows`: of `cardan daemon ps`."""
    for row in rows:
        who = f"{row['kind']} {row['name']}"
        reason = f": {row['reason']}" if row["reason"] else ""
        if row["state"] == UnitState.FAILED.value:
            yield failure(
                "unit-failed",
                f"{who} has failed{reason}",
                "the daemon does not start it again by itself",
                f"cardan daemon log {row['name']}, then: cardan daemon restart {row['name']}",
            )
        elif row["state"] == UnitState.WAITING.value:
            yield caution(
                "unit-waiting",
                f"{who} waits for its restart{reason}",
                "something that it needs is missing, or it has crashed",
                f"cardan daemon log {row['name']}",
            )
        else:
            yield good("unit", f"{who} is {row['state']}{reason}")


def check_absent(why: str, services: Sequence[SystemdUnit]) -> Finding:
    """Return the finding for a daemon that does not answer. `services`: its installed units."""
    if services:
        systemctl = " ".join(services[0].systemctl)
        return failure(
            "service",
            f"the service {services[0].path} is installed, and its daemon does not answer: {why}",
            "none of its sessions runs",
            f"{systemctl} status cardan, then: {systemctl} restart cardan",
        )
    if why.startswith("no daemon runs"):
        return good("daemon", "no daemon runs")
    return failure("daemon", why, "it cannot be asked", "ls -l its socket; the group of [daemon]")


def check_unit(service: SystemdUnit) -> Finding:
    """Return the finding for a unit that starts the daemon by its old name."""
    install = (
        "cardan daemon service install"
        if service.user
        else ("sudo cardan daemon service install --system")
    )
    return failure(
        "service-outdated",
        f"the service {service.path} was written before 0.2.0",
        "the command that it starts has another name now: it fails the next time it is started",
        f"{install} FILE..., with the files behind ExecStart= there",
    )


class Running(Check):
    """Daemon of this user or of this computer: state and failures."""

    group, tells = (
        GROUP,
        ("daemon", "service", "service-outdated", "unit", "unit-failed", "unit-waiting"),
    )

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        there = [each for each in map(installed, (False, True)) if each.path.exists()]
        yield from map(check_unit, filter(is_outdated, there))
        try:
            with ControlClient(subject.socket) as client:
                rows = client.ask("units")
        except CardanError as error:
            yield check_absent(str(error), there)
            return
        yield good("daemon", f"the daemon at {client.path} runs")
        yield from check_units(rows)
