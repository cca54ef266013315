"""Declaration of the options with which a driver reaches only simulated hardware.

A demo moves a robot unattended, so it runs only drivers with such a declaration::

    class MyRobot(RobotDriver):
        simulated = ({"transport": ("tcp",), "host": LOOPBACK, "port": OWN},)

Each mapping is one way: options by name, and what each must be. ``({},)`` says that there is no
hardware at all. Inherited declarations do not count. A driver or a filter without the attribute is
held to the strictest rule: every text among its options is empty, a loopback address, or a file of
the demo's own, and a driver has at least one file or port of the demo's own.
"""

from __future__ import annotations

import dataclasses
import enum
import ipaddress
from collections.abc import Callable, Iterator, Mapping
from pathlib import PurePath
from typing import Any

from cardan.common.bounds import Host
from cardan.common.options import hints
from cardan.common.sockets import is_loopback


class Only(enum.Enum):
    """Requirement on an option of a simulated way that is not a list of values."""

    OWN = "a path or a port of the demo's own (`files`, `ports`)"
    LOOPBACK = "an address of this computer only, such as 127.0.0.1"
    LAUNCHED = "empty, with the device inside `launcher`"


OWN, LOOPBACK, LAUNCHED = Only

Way = Mapping[str, Only | tuple[object, ...]]
"""Options by name, each with its only allowed value, or one of several."""


def stays_here(text: object) -> bool:
    """True if a host, or HOST:PORT, is only on this computer; also for None (no host)."""
    if text is None:
        return True
    host = str(text)
    return is_loopback(host.partition(":")[0] if host.count(":") == 1 else host)


def is_elsewhere(text: str) -> bool:
    """True for an IP address, with or without a port, that other computers may have."""
    host = text.partition(":")[0] if text.count(":") == 1 else text
    try:
        address = ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    return not (address.is_loopback or address.is_multicast)


def why_not_simulated(
    driver: Any, options: Any, own: Callable[[str], bool], *, launched: bool, needs_own: bool = True
) -> tuple[str, str]:
    """Return the option by which `driver` may reach hardware, and the reason; both empty if it
    cannot.

    `own` tells whether the demo gives an option a value of its own, `launched` whether the device
    is inside the demo's launcher.
    """
    values = {each.name: getattr(options, each.name) for each in dataclasses.fields(options)}
    for name, value in values.items():
        if not own(name) and any(map(is_elsewhere, _texts(value))):
            return name, f"{value!r} is an address that other computers have"
        if _is_host(options, name) and not stays_here(value):
            return name, f"{value!r} is not {LOOPBACK.value}"
    # A subclass may reach its hardware otherwise: an inherited declaration does not count.
    ways: tuple[Way, ...] | None = vars(driver).get("simulated")
    if ways is None:
        return _why_strictly_not(values, own, needs_own)
    found = []
    for way in ways:
        for name, only in way.items():
            value = values[name]
            if only is OWN:
                good, allowed = own(name), OWN.value
            elif only is LOOPBACK:
                good, allowed = value is not None and stays_here(value), LOOPBACK.value
            elif only is LAUNCHED:
                good, allowed = launched and not value, LAUNCHED.value
            else:
                assert isinstance(only, tuple)
                good, allowed = value in only, " or ".join(repr(each) for each in only)
            if not good:
                found.append((name, f"{value!r} may reach hardware; it must be {allowed}"))
                break
        else:
            return "", ""
    return found[0] if found else ("", "it has no way to simulated hardware only")


def _why_strictly_not(
    values: Mapping[str, object], own: Callable[[str], bool], needs_own: bool
) -> tuple[str, str]:
    """Return the same for a driver without a declaration."""
    declare = "its driver may declare the option harmless (`simulated`)"
    for name, value in values.items():
        if not own(name) and not all(not text or stays_here(text) for text in _texts(value)):
            return name, (
                f"{value!r} may reach hardware; it must be {OWN.value}, or {LOOPBACK.value}; "
                f"or {declare}"
            )
    if needs_own and not any(map(own, values)):
        return "", f"none of its options is {OWN.value}; or {declare}"
    return "", ""


def _texts(value: object) -> Iterator[str]:
    """Yield the texts in a value."""
    if isinstance(value, enum.Enum):
        yield from _texts(value.value)
    elif isinstance(value, (str, PurePath)):
        yield str(value)
    elif isinstance(value, bytes):
        yield repr(value)
    elif isinstance(value, Mapping):
        for each in value.items():
            yield from _texts(each)
    elif isinstance(value, (tuple, list, set, frozenset)):
        for each in value:
            yield from _texts(each)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from _texts(getattr(value, field.name))


def _is_host(options: Any, name: str) -> bool:
    """True if the annotation of an option marks it as a host."""
    hint = hints(options.__class__).get(name)
    notes = (*getattr(hint, "__metadata__", ()),)
    for inner in getattr(hint, "__args__", ()):
        notes += (*getattr(inner, "__metadata__", ()),)
    return any(isinstance(note, Host) for note in notes)
