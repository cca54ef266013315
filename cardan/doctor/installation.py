"""Checks of the installation: packages, plug-ins."""

from __future__ import annotations

import importlib.metadata
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, Final, NamedTuple

from cardan.bus import transports
from cardan.bus.options import BusOptions
from cardan.common.plugins import Loaded
from cardan.doctor.base import Check, Finding, Subject, caution, failure, good
from cardan.drivers import registry as drivers
from cardan.drivers.hid import load_hid
from cardan.errors import DriverError, install_command
from cardan.gateway.operator.filters import registry as filters
from cardan.gateway.servers import registry as servers

GROUP = "installation"

EXTRAS: Final = ("arm", "network", "can", "record", "foxglove", "dissect", "ruckig")
"""Extras that change functions here; the others are for developers."""

_EXTRA_OF_DRIVER: Final = {"sim_arm": "arm"}
_EXTRA_OF_SERVER: Final = {"foxglove": "foxglove"}

_REQUIREMENT = re.compile(
    r"(?P<name>[\w.-]+)(?:\[(?P<extras>[\w,.-]+)\])?[<>=!~\d.*,\s]*(?:;(?P<marker>.*))?"
)
_EXTRA = re.compile(r"extra\s*==\s*['\"]([\w.-]+)['\"]")
_OLDER_PYTHON = re.compile(r"python_version\s*<\s*['\"](\d+)\.(\d+)['\"]")


class PackageRequirement(NamedTuple):
    """A package that Cardan needs."""

    name: str
    extras: tuple[str, ...]
    extra: str
    """Extra of Cardan that needs it; empty: Cardan itself."""


def read_requirements(
    lines: Iterable[str], python: tuple[int, int] = sys.version_info[:2]
) -> list[PackageRequirement]:
    """Read requirements of a package's metadata (``Requires-Dist``) that hold for `python`."""
    found = []
    for line in lines:
        if (match := _REQUIREMENT.fullmatch(line.strip())) is None:
            continue
        marker = match["marker"] or ""
        older = _OLDER_PYTHON.search(marker)
        if older is not None and python >= (int(older[1]), int(older[2])):
            continue
        extra = _EXTRA.search(marker)
        extras = tuple(match["extras"].split(",")) if match["extras"] else ()
        found.append(PackageRequirement(match["name"], extras, extra[1] if extra else ""))
    return found


def lacking(
    requirements: Iterable[PackageRequirement], extra: str, version: Callable[[str], str | None]
) -> list[str]:
    """Describe the packages missing for `extra` (empty: for Cardan itself). `version` returns the
    version of an installed package, or None."""
    requirements = list(requirements)
    missing = []
    for each in requirements:
        if each.extra != extra:
            continue
        if each.name == "cardan":
            for other in each.extras:
                missing += lacking(requirements, other, version)
        elif version(each.name) is None:
            missing.append(f"{each.name} is missing")
    return missing


def installed_version(name: str) -> str | None:
    """Return the version of an installed package; None if it is missing."""
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def own_requirements() -> list[PackageRequirement]:
    """Return the requirements of the installed Cardan; empty if it runs from a source tree."""
    try:
        return read_requirements(importlib.metadata.requires("cardan") or ())
    except importlib.metadata.PackageNotFoundError:
        return []


def needed_extras(subject: Subject) -> dict[str, str]:
    """Return the extras that the files need, each with its first user."""
    needed: dict[str, str] = {}
    for name, entry in subject.sessions.items():
        if entry.config.arm is not None:
            needed.setdefault("arm", f"[arm] of {name}")
        if entry.config.network is not None:
            needed.setdefault("network", f"[network] of {name}")
    for each in subject.used():
        who = f"{each.key} {each.name!r} of {each.session}"
        if isinstance(each.driver.options, BusOptions):
            needed.setdefault("network", who)
        if extra := _EXTRA_OF_DRIVER.get(each.name):
            needed.setdefault(extra, who)
    for name, server in subject.servers.items():
        needed.setdefault(_EXTRA_OF_SERVER.get(server.server, "network"), f"server {name}")
    return needed


def check_packages(
    requirements: Iterable[PackageRequirement],
    needed: Mapping[str, str],
    version: Callable[[str], str | None],
) -> Iterator[Finding]:
    """Check that all needed packages are installed. `needed`: from :func:`needed_extras`."""
    requirements = list(requirements)
    if missing := lacking(requirements, "", version):
        yield failure(
            "package", "; ".join(missing), "Cardan needs it", "pip install --upgrade cardan"
        )
    else:
        yield good("package", "all required packages are installed")
    absent = []
    for extra in EXTRAS:
        missing = lacking(requirements, extra, version)
        if not missing:
            continue
        if extra not in needed:
            absent.append(extra)
            continue
        yield failure(
            "extra",
            f"cardan[{extra}]: {'; '.join(missing)}",
            f"{needed[extra]} needs it",
            install_command(extra),
        )
    there = [extra for extra in EXTRAS if not lacking(requirements, extra, version)]
    without = f"; without {', '.join(absent)}, which nothing here needs" if absent else ""
    yield good("extra", f"extras: {', '.join(there) or 'none'}{without}")


class Packages(Check):
    """The packages and extras that the files need."""

    group, tells = GROUP, ("package", "extra", "hidapi")

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        yield from check_packages(own_requirements(), needed_extras(subject), installed_version)
        try:
            load_hid("hid")
        except DriverError as error:
            why = "devices by hidraw, such as a SpaceMouse, are read by it"
            yield failure("hidapi", str(error), why, "pip install --force-reinstall hidapi")


class PlugIns(Check):
    """Drivers, filters, servers and checks of other packages."""

    group, tells = GROUP, ("plug-in",)

    @classmethod
    def look(cls, subject: Subject) -> Iterable[Finding]:
        from cardan.doctor import registry as checks

        return list(
            check_plug_ins(
                [
                    ("driver", drivers.load_all()),
                    ("filter", filters.load_all()),
                    ("server", servers.load_all()),
                    ("transport", transports.load_all()),
                    ("check", checks.load_all()),
                ]
            )
        )


def check_plug_ins(found: Iterable[tuple[str, Loaded[Any]]]) -> Iterator[Finding]:
    """Report plug-ins that cannot be used. `found`: loaded classes by the noun for their kind."""
    bad = False
    lacking: dict[str, list[str]] = {}
    for word, loaded in found:
        for name, extra in loaded.lacking.items():
            lacking.setdefault(extra, []).append(f"{word} {name!r}")
        for name in sorted(loaded.refused.keys() - loaded.lacking.keys()):
            bad, why = True, loaded.refused[name]
            yield failure(
                "plug-in",
                f"{word} {name!r} {why}",
                "its package is broken, or made for another Cardan",
                "pip install --upgrade its package, or pip uninstall it",
            )
        for note in loaded.notes:
            bad = True
            yield caution(
                "plug-in",
                note,
                "two packages provide this name",
                "pip uninstall one of the two",
            )
    for extra, names in lacking.items():  # If the files need it, the failure "extra" reports it.
        yield good("plug-in", f"not installed: {install_command(extra)} for {', '.join(names)}")
    if not bad:
        others = "all other" if lacking else "all"
        yield good("plug-in", f"{others} drivers, filters, servers and checks can be loaded")
