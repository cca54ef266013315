"""``cardan net``: nodes and topics of the network, and access to it; ``cardan net pair``:
certificates for two computers, from a code that is typed once."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from cardan.cli.bus import echo, hz, messages, network
from cardan.cli.common import print_problem
from cardan.cli.installed import OpenGroup
from cardan.cli.recording import plot, record, replay
from cardan.cli.server import server
from cardan.common.text_sanitizer import printable
from cardan.errors import OptionError

PORT = 7449

net = typer.Typer(
    name="net",
    cls=OpenGroup,
    help="See, join, serve and record the network of sessions and ROS 2 nodes.",
    no_args_is_help=True,
)


net.add_typer(server)
net.command("list")(network)
for _command in (echo, hz, messages, record, replay, plot):
    net.command()(_command)


@net.command()
def pair(
    host: Annotated[
        str | None,
        typer.Argument(
            metavar="[HOST]",
            help="On the operator's computer: name or address of the robot's computer. On the "
            "robot's computer: none; it waits five minutes for the other.",
            show_default=False,
        ),
    ] = None,
    code: Annotated[
        str, typer.Option(metavar="CODE", help="Code on the robot's computer; default: asks.")
    ] = "",
    address: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Address where the robot's computer waits.")
    ] = "0.0.0.0",
    port: Annotated[
        int, typer.Option(min=1, max=65535, help="TCP port where it waits; the same on both.")
    ] = PORT,
    replace: Annotated[
        bool, typer.Option("--replace", help="Pair again, and replace the old certificates.")
    ] = False,
    quic: Annotated[
        bool,
        typer.Option(
            "--quic",
            help="On the operator's computer: join by QUIC (UDP), for networks that lose packets.",
        ),
    ] = False,
) -> None:
    """Pair the operator's computer with the robot's, by TLS or QUIC.

    Makes a certificate for each and Zenoh's configuration, and prints what to type next. No private
    key leaves its computer."""
    from cardan.bus.pairing import pair_with, wait_for_operator
    from cardan.gateway.servers.console.address import reachable_host

    if host is None and code:
        raise OptionError("HOST", "", "given with --code: the name or address of the robot's")
    if host is None and quic:
        raise OptionError("HOST", "", "given with --quic: the name or address of the robot's")
    if host is not None:
        words = f"Code that {printable(host)} shows"
        ask = lambda: code or str(typer.prompt(words, err=True))  # noqa: E731
        config = shlex.quote(str(pair_with(host, port, replace, ask, quic=quic)))
        print(
            f"paired; now:\n  cardan devices share spacemouse --zenoh-config {config}", flush=True
        )
        return
    there = reachable_host(address) + ("" if port == PORT else f" --port {port}")

    def show(fresh: str) -> None:
        print(f"code {fresh}; on the operator's computer: cardan net pair {there}", flush=True)

    config = shlex.quote(str(wait_for_operator((address, port), replace, show, print_problem)))
    print(
        f"paired; now:\n  cardan net server router --zenoh-config {config}\nand in the session's "
        f"file:\n"
        '  [device]\n  driver = "remote"\n  device = "spacemouse"',
        flush=True,
    )
