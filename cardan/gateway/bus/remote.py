"""The Cartesian interface of an arm on the bus, from any computer in reach of it."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from cardan.bus.network import Failure, NetworkError
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.sockets import is_loopback
from cardan.errors import CardanError, DriverError, OptionError
from cardan.gateway.arm.remote_arm import ANSWER_TIMEOUT_S, RemoteArm, Send
from cardan.gateway.arm.requests import PacketError, Request
from cardan.gateway.bus.commands import ASK_SERVICE, ASK_TYPE, MOTIONS_TOPIC, MOTIONS_TYPE
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.names import RosNameError, checked_name

MEET_TIMEOUT_S = 5.0
"""Longest wait for the arm to be found on the bus: a router takes a second to report it."""

WAIT_TIMEOUT_S = 86_400.0
"""Time limit of `wait` without a limit: Zenoh's calls need one."""

REST_TIMEOUT_S = 5.0
"""Longest wait of `close` for the arm to be braked to rest."""

LOOK_PERIOD_S = 0.02
"""Period at which `close` checks whether the arm is at rest."""

GONE = (
    "the arm has left the network, or the connection is lost; it may still move by a motion that "
    "ends by itself. Close and open it to go on"
)


def parse_address(address: str) -> tuple[str, str]:
    """Return the Zenoh endpoint of an arm, empty if `address` has none, and the full name of the
    arm's node. Raises OptionError."""
    endpoint, name = "", address
    if ":" in address:  # As no name of ROS has, and every endpoint with a port.
        protocol, _, rest = address.partition("/")
        where, _, name = rest.partition("/")
        endpoint = f"{protocol}/{where}"
    try:
        return endpoint, checked_name(name or DEFAULT_NAME)
    except RosNameError as error:
        allowed = f"ENDPOINT, NAME or ENDPOINT/NAME, as tcp/192.168.1.10:7447/{DEFAULT_NAME}"
        raise OptionError("address", address, f"{allowed}: {error}") from None


def options_for(endpoint: str, options: BusOptions | None) -> BusOptions:
    """Return options to join the bus of the peer at `endpoint`: a peer on another computer is
    joined as its client, unless `options` are given."""
    if not endpoint:
        return options or BusOptions()
    if options is not None:
        return replace(options, router=endpoint)
    here = is_loopback(endpoint.partition("/")[2].rpartition(":")[0])
    return BusOptions(router=endpoint, mode="peer" if here else "client")


def network_arm(
    address: str = f"/{DEFAULT_NAME}", options: BusOptions | None = None, *, source: str = ""
) -> RemoteArm:
    """An arm that a session shows on the network (``[network]``), with the verbs and the semantics
    of CartesianDevice.

    ::

        with network_arm("tcp/192.168.1.10:7447") as arm:
            arm.movj([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])
            arm.wait()

    The arm is moved by its own session, with that session's limits, beside other sources. When the
    connection is lost, verbs raise MotionLoopError, `stop` too: motions that end by themselves
    continue, those without end are braked. `close` gives up the authority, which brakes a motion
    under it to rest.

    `address`: endpoint to meet the arm by ("tcp/192.168.1.10:7447"), full name of the arm's node
    ("/cell/arm"), or both ("tcp/192.168.1.10:7447/cell/arm"). `source`: name of this client, which
    gets the authority; empty: a unique one. Raises ConfigurationError.

    `open` returns when the arm has answered, after its first state. It raises ExtraMissingError,
    ConfigurationError, DriverError if the bus cannot be joined or there is no such arm on it, and
    MotionLoopError if the arm does not answer.
    """
    number = time.time_ns() % 10**9
    source = source or f"remote_{number}"
    endpoint, name = parse_address(address)
    node = re.sub(r"[^A-Za-z0-9]+", "_", source)
    network = BusNetwork(options_for(endpoint, options), f"cardan_{node}_{number}")
    return RemoteArm(partial(_connect, network, name), source)


def _connect(network: BusNetwork, name: str, arm: RemoteArm) -> Callable[[], None]:
    """Join the bus and find the arm with the node `name`; return the function that brings the arm
    to rest and leaves."""
    service = f"{name}/{ASK_SERVICE}"
    notes = codec_of(MOTIONS_TYPE)

    def hear(data: bytes, _stamp_ns: int) -> None:
        message = notes.decode(data)
        if not isinstance(message, MalformedCdr):
            _take(arm, message["data"])

    network.open()
    try:
        with contextlib.ExitStack() as undone:
            undone.callback(network.close)
            undone.callback(arm.end, "the arm was closed")
            if not network.wait_for_service(service, MEET_TIMEOUT_S):
                raise DriverError(_why_missing(network, name))
            heard = network.subscribe(f"{name}/{MOTIONS_TOPIC}", MOTIONS_TYPE, hear)
            undone.callback(heard.close)
            arm.begin(_sender(network, service, arm))
            watched = network.watch_service(service, lambda: arm.end(GONE, rests=False))
            undone.callback(watched.close)
            arm.status()
            undone.callback(_rest, arm)
            return undone.pop_all().close
    except NetworkError as error:
        raise DriverError(str(error)) from None


def _rest(arm: RemoteArm) -> None:
    """Give up the authority, and wait until a motion under it is braked to rest."""
    with contextlib.suppress(CardanError):
        arm.release()
        end_s = time.monotonic() + REST_TIMEOUT_S
        while arm.status().braking and time.monotonic() < end_s:
            time.sleep(LOOK_PERIOD_S)


def _why_missing(network: BusNetwork, name: str) -> str:
    if network.lonely():
        router = network.node.options.router
        return (
            f"no other node is on the network at {router or 'no router'}: start a router "
            "(`cardan net server router`, or rmw_zenohd), or name the session's own endpoint "
            "as router"
        )
    there = [each for each in network.services() if each.endswith(f"/{ASK_SERVICE}")]
    arms = ", ".join(each.removesuffix(f"/{ASK_SERVICE}") for each in there) or "none"
    return f"there is no arm {name} on the bus that takes commands; there are: {arms}"


def _sender(network: BusNetwork, service: str, arm: RemoteArm) -> Send:
    """Return a function that sends requests to the arm's service, and passes it the replies."""
    requests, responses = codec_of(f"{ASK_TYPE}_Request"), codec_of(f"{ASK_TYPE}_Response")

    def send(request: Request, packet: bytes) -> None:
        def answered(reply: bytes | Failure) -> None:
            message = reply if isinstance(reply, Failure) else responses.decode(reply)
            if isinstance(message, (Failure, MalformedCdr)):
                arm.fail(request.id, message.reason)
            else:
                _take(arm, message["reply"])

        data = requests.encode({"request": packet.decode()})
        timeout_s = WAIT_TIMEOUT_S if request.verb == "wait" else ANSWER_TIMEOUT_S
        try:
            network.call(service, ASK_TYPE, data, answered, timeout_s)
        except NetworkError as error:
            arm.fail(request.id, str(error))

    return send


def _take(arm: RemoteArm, packet: str) -> None:
    with contextlib.suppress(PacketError):
        arm.take(packet.encode())
