"""Commands of the bus: ``cardan net list``, ``cardan net echo``, ``cardan net hz`` and
``messages``."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from cardan.bus.options import BusOptions
from cardan.cli import completion
from cardan.cli.common import EXIT_INCOMPLETE, AsJson, Seconds, print_json
from cardan.common.inbox import Inbox, InboxEmptyError
from cardan.common.text_sanitizer import printable
from cardan.errors import ConfigurationError

if TYPE_CHECKING:
    from cardan.bus.network import Topic

MAX_MESSAGES: Final = 1000
"""Largest number of messages that wait to be printed; beyond it some are dropped."""

SHOWN_S: Final = 1.0
"""Period at which `hz` prints its counts."""

Session = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Configuration file with the [network] to join; default: the defaults.",
    ),
]
Router = Annotated[
    str,
    typer.Option(
        metavar="ENDPOINT",
        help="Zenoh router to join by, such as tcp/127.0.0.1:7447; default: "
        "the file's, else your only one on this computer.",
    ),
]
TopicName = Annotated[
    str,
    typer.Argument(
        metavar="TOPIC", help="In full: /joint_states.", autocompletion=completion.topics
    ),
]


def bus_options(
    session: Path | None, router: str = "", *, quiet: bool = False, publishes: bool = False
) -> BusOptions:
    """Return the options to join the bus of a session's file, or by a router. Without both: the
    defaults, or the only router of this user on this computer, which is printed unless `quiet`.
    With `publishes`, only a named router is joined. Raises ConfigurationError."""
    from cardan.bus.discovery import reachable
    from cardan.gateway.session.assembly import load_config

    if router:
        if session is not None:
            raise ConfigurationError("session's file, --router", "give one of them")
        return BusOptions(router=router)
    if session is None:
        options = BusOptions() if publishes else met_here(BusOptions())
        if options != BusOptions() and not quiet:
            print(f"cardan: joins by the router at {options.router}", file=sys.stderr)
        return options
    configured = load_config(session).network
    if configured is None:
        raise ConfigurationError("network", f"{session} has no table [network]: add one")
    return reachable(configured)


def met_here(options: BusOptions) -> BusOptions:
    """Return `options`, or those of the only router of this computer if none serves at their
    address. Raises ConfigurationError if there are several."""
    from cardan.bus.router import is_served, router_address, routers_here

    address = router_address(options)
    if address is None or is_served(address):
        return options
    found = routers_here()
    if len(found) > 1:
        raise ConfigurationError(
            "--router",
            f"several routers run on this computer, and none at {options.router}: give one of "
            + ", ".join(found),
        )
    return replace(options, router=found[0]) if found else options


def network(
    file: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FILE]",
            help="Configuration file with the [network] to join; default: the defaults.",
        ),
    ] = None,
    router: Router = "",
    as_json: AsJson = False,
) -> None:
    """List the nodes, topics and services that are on the bus.

    Joins it, waits two seconds, and prints advice if it finds no node."""
    from cardan.bus.discovery import discover, remedies, unseen

    options = bus_options(file, router)
    found = discover(options)
    if advice := remedies(options, found):
        for each in advice:
            print(f"cardan: {each}", file=sys.stderr)
        raise typer.Exit(EXIT_INCOMPLETE)
    if remark := unseen(found):
        print(f"cardan: {remark}", file=sys.stderr)
    if as_json:
        print_json(
            {
                "nodes": found.nodes,
                "topics": {
                    name: {"type": each.type, "publishers": each.publishers}
                    for name, each in found.topics.items()
                },
                "services": {
                    name: {"type": each.type, "servers": each.servers}
                    for name, each in found.services.items()
                },
            }
        )
        return
    # No table: names are to be copied, and a narrow terminal would cut them.
    for name in found.nodes:
        print(f"node     {name}")
    for name, topic in found.topics.items():
        print(f"topic    {name}  {topic.type}{_by(topic.publishers)}")
    for name, service in found.services.items():
        print(f"service  {name}  {service.type}{_by(service.servers)}")


def _by(nodes: Sequence[str]) -> str:
    return f"  by {', '.join(nodes)}" if nodes else ""


def echo(
    topic: TopicName,
    count: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="End after this number of messages.")
    ] = None,
    seconds: Seconds = None,
    session: Session = None,
    router: Router = "",
) -> None:
    """Print the messages of a topic as JSON, one a line, until Ctrl-C."""
    from cardan.protocols.ros2.cdr import MalformedCdr, decoded
    from cardan.protocols.ros2.interfaces import InterfaceError
    from cardan.protocols.ros2.messages import json_text

    printed = 0
    for data, known in _heard(topic, bus_options(session, router), seconds):
        try:
            name, message = decoded(known.type, data)
        except InterfaceError as error:
            raise ConfigurationError(topic, f"its messages cannot be read: {error}") from None
        text = (
            f"cardan: no message of {name}: {message.reason}"
            if isinstance(message, MalformedCdr)
            else json_text(name, message)
        )
        print(printable(text), flush=True)
        printed += 1
        if count is not None and printed >= count:
            return
    if not printed:
        raise typer.Exit(EXIT_INCOMPLETE)


def hz(
    topic: TopicName,
    seconds: Seconds = None,
    session: Session = None,
    router: Router = "",
    as_json: AsJson = False,
) -> None:
    """Print rate and jitter of a topic.

    Once a second, until Ctrl-C."""
    from cardan.common.histogram import LatencyHistogram

    gaps = LatencyHistogram()
    began_s = reported_s = last_s = None
    messages = size = 0
    for data, _ in _heard(topic, bus_options(session, router), seconds):
        now_s = time.monotonic()
        if last_s is not None:
            gaps.add(now_s - last_s)
        last_s = now_s
        if began_s is None or reported_s is None:
            began_s = reported_s = now_s
            continue
        messages, size = messages + 1, size + len(data)
        if now_s - reported_s >= SHOWN_S:
            reported_s = now_s
            p50, p99 = (1e3 * gaps.percentile(share) for share in (50, 99))
            rate, each = messages / (now_s - began_s), size / messages
            if as_json:
                print_json(
                    {
                        "rate_hz": rate,
                        "gap_p50_s": 1e-3 * p50,
                        "gap_p99_s": 1e-3 * p99,
                        "gap_max_s": gaps.max,
                        "bytes": each,
                    }
                )
                continue
            print(
                f"{rate:.2f} Hz, between two {p50:.2f} ms (p50), {p99:.2f} ms (p99), "
                f"{1e3 * gaps.max:.2f} ms at most; {each:.0f} bytes each",
                flush=True,
            )
    if last_s is None:
        raise typer.Exit(EXIT_INCOMPLETE)


def _heard(name: str, options: BusOptions, seconds: float | None) -> Iterator[tuple[bytes, Topic]]:
    """Yield the messages of a topic as they arrive, for `seconds`. Raises ConfigurationError if the
    topic does not appear."""
    from cardan.bus.discovery import published
    from cardan.bus.zenoh_network import BusNetwork

    heard: Inbox[bytes] = Inbox()

    def take(data: bytes, _stamp_ns: int) -> None:
        if len(heard) < MAX_MESSAGES:
            heard.put(data)

    end_s = None if seconds is None else time.monotonic() + seconds
    with BusNetwork(options, f"cardan_echo_{time.time_ns() % 10**9}") as network:
        topic = published(network, name, "TOPIC")
        network.subscribe(name, topic.type, take)
        while (left_s := 3600.0 if end_s is None else end_s - time.monotonic()) > 0.0:
            try:
                yield heard.get(left_s), topic
            except InboxEmptyError:
                continue


def messages(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="A workspace's src folder; made if missing.")
    ],
) -> None:
    """Write the ROS 2 packages of Cardan's own messages.

    No distribution has them: build them with colcon, and standard programs can use all functions of
    an arm."""
    from cardan.bus.message_packages import write_packages

    for place in write_packages(folder):
        print(place)
