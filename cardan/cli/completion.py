"""Shell completion of names: demos, drivers, sessions, devices, topics, verbs, codes.

A shell waits for it while the user types: it ends quickly, and is silent if nothing is found.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import typer
from typer import _completion_classes

from cardan.errors import CardanError

if TYPE_CHECKING:
    from cardan.bus.options import BusOptions

# Typer takes helps for rich markup: it drops words in brackets and breaks lines at 80 columns. fish
# offers the second line as another word.
_completion_classes._sanitize_help_text = lambda text: text

ANSWER_S: Final = 0.5
"""Longest wait for the daemon's answer; it takes a millisecond."""

TOPICS_S: Final = 1.0
"""Longest search for topics; a quiet computer needs a third of it."""

SETTLED_S: Final = 0.15
"""The graph arrives in parts; after this time without a new one it is taken as complete."""

LOOK_S: Final = 0.02

Offered = list[tuple[str, str]]
"""Words with their help, which some shells show."""


def demos(incomplete: str) -> Offered:
    """Names of demos."""
    from cardan.demos.examples import find_demos

    return [
        (name, demo.description)
        for name, demo in find_demos().items()
        if name.startswith(incomplete)
    ]


def drivers(incomplete: str) -> Offered:
    """Names of drivers, those of other packages included."""
    from cardan.drivers import registry

    return [(name, "") for name in registry.names() if name.startswith(incomplete)]


def codes(incomplete: str) -> Offered:
    """Codes of messages."""
    from cardan.common.troubles import troubles

    return [
        (code, trouble.words[0])
        for code, trouble in troubles().items()
        if code.startswith(incomplete.upper())
    ]


def robots(incomplete: str) -> Offered:
    """Names of Cardan's arms."""
    from cardan.robots import arm_names

    return [(name, "") for name in arm_names() if name.startswith(incomplete)]


def units(context: typer.Context, incomplete: str) -> Offered:
    """Sessions and servers of the running daemon."""
    return [
        (row["name"], f"{row['kind']}, {row['state']}")
        for row in _rows(context)
        if row["name"].startswith(incomplete)
    ]


def sessions(context: typer.Context, incomplete: str) -> Offered:
    """Sessions of the running daemon."""
    return [
        (row["name"], row["state"])
        for row in _rows(context)
        if row["kind"] == "session" and row["name"].startswith(incomplete)
    ]


def devices(context: typer.Context, incomplete: str) -> Offered:
    """Devices that sessions of the daemon share."""
    return [
        (each["name"], f"serves {each['holder']}")
        for each in _asked(context, "devices")
        if each["name"].startswith(incomplete)
    ]


def sharers(context: typer.Context, incomplete: str) -> Offered:
    """Sessions that share the device in the preceding argument."""
    device = context.params.get("device")
    names = [
        name
        for each in _asked(context, "devices")
        if each["name"] == device
        for name in each["sessions"]
    ]
    return [(name, "") for name in names if name.startswith(incomplete)]


def topics(context: typer.Context, incomplete: str) -> Offered:
    """Topics on the bus that the preceding arguments select, as far as they are found in time."""
    from cardan.cli.bus import bus_options

    session = context.params.get("session")
    try:
        options = bus_options(
            session and Path(session), context.params.get("router") or "", quiet=True
        )
        found = _topics(options)
    except CardanError:
        return []
    return [(name, each) for name, each in sorted(found.items()) if name.startswith(incomplete)]


def _topics(options: BusOptions) -> dict[str, str]:
    """Return names and types of topics, once none is new for SETTLED_S; at most after TOPICS_S."""
    from cardan.bus.router import is_served, router_address
    from cardan.bus.zenoh_network import BusNetwork

    address = router_address(options)
    if address is not None and not is_served(address):
        return {}  # Discovery of nodes would take longer than a shell waits.
    with BusNetwork(options, f"cardan_completion_{time.time_ns() % 10**9}") as network:
        end_s = time.monotonic() + TOPICS_S
        changes, changed_s = network.changes, time.monotonic()
        while (now_s := time.monotonic()) < end_s:
            if network.changes != changes:
                changes, changed_s = network.changes, now_s
            if network.topics() and now_s - changed_s > SETTLED_S:
                break
            time.sleep(LOOK_S)
        return {name: topic.type for name, topic in network.topics().items()}


def verbs(incomplete: str) -> Offered:
    """Verbs of an arm."""
    from cardan.cli.verbs import offered

    return [(name, takes.words) for name, takes in offered().items() if name.startswith(incomplete)]


def _rows(context: typer.Context) -> list[Any]:
    """Return the rows that `cardan daemon ps` would list."""
    return _asked(context, "units")


def _asked(context: typer.Context, do: str) -> list[Any]:
    """Return the daemon's answer; empty if no daemon answers."""
    from cardan.gateway.daemon.client import ControlClient

    try:
        with ControlClient(context.params.get("socket") or "", ANSWER_S) as client:
            found: list[Any] = client.ask(do)
    except CardanError:
        return []
    return found
