"""The Cartesian interface of an arm on the bus, from any computer that reaches it."""

from __future__ import annotations

import contextlib
import re
import time
from dataclasses import replace

from cardan.bus.network import Failure, Handle, NetworkError
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.sockets import is_loopback
from cardan.errors import CardanError, DriverError, MotionLoopError, OptionError
from cardan.gateway.arm.remote_arm import ANSWER_TIMEOUT_S, RemotePacketArm
from cardan.gateway.arm.requests import PacketError, Reply, Request, decode_answer
from cardan.gateway.bus.commands import ASK_SERVICE, ASK_TYPE, MOTIONS_TOPIC, MOTIONS_TYPE
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.protocols.ros2.cdr import Malformed, codec_of
from cardan.protocols.ros2.names import RosNameError, checked_name

MEET_TIMEOUT_S = 5.0
"""Longest wait for the arm to be found on the bus: a router needs a second to tell of it."""

WAIT_TIMEOUT_S = 86_400.0
"""Of `wait` without a limit: Zenoh's calls need one."""

REST_TIMEOUT_S = 5.0
"""How long `close` waits for the arm to be braked to rest."""

LOOK_PERIOD_S = 0.02
"""How often `close` looks whether it is."""

GONE = (
    "the arm has left the network, or the connection is lost; it may still move by a motion that "
    "ends by itself. Close and open it to go on"
)


def parse_address(address: str) -> tuple[str, str]:
    """Zenoh endpoint to meet an arm by, empty where `address` has none, and full name of the arm's
    node. Raises OptionError."""
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
    """Options to join the bus of the peer at `endpoint`: a peer on another computer is joined as
    its client, unless `options` are given."""
    if not endpoint:
        return options or BusOptions()
    if options is not None:
        return replace(options, router=endpoint)
    here = is_loopback(endpoint.partition("/")[2].rpartition(":")[0])
    return BusOptions(router=endpoint, mode="peer" if here else "client")


class RemoteCartesianDevice(RemotePacketArm):
    """An arm that a session shows on the network (``[network]``), with the verbs and the semantics
    of CartesianDevice.

    ::

        with RemoteCartesianDevice("tcp/192.168.1.10:7447") as arm:
            arm.movj([0.4, 0.1, 0.4, 3.14, 0.0, 0.0])
            arm.wait()

    The arm is moved by its own session, with that session's limits, beside other sources. When the
    connection is lost, verbs raise MotionLoopError, `stop` too: motions that end by themselves go
    on then, those without end are braked.
    """

    def __init__(
        self,
        address: str = f"/{DEFAULT_NAME}",
        options: BusOptions | None = None,
        *,
        source: str = "",
    ) -> None:
        """`address`: endpoint to meet the arm by ("tcp/192.168.1.10:7447"), full name of the arm's
        node ("/cell/arm"), or both ("tcp/192.168.1.10:7447/cell/arm"). `source`: name under which
        this asks, which gets the authority; empty: one that no other program has. Raises
        ConfigurationError."""
        number = time.time_ns() % 10**9
        super().__init__(source or f"remote_{number}")
        self.address = address
        endpoint, self._arm = parse_address(address)
        node = re.sub(r"[^A-Za-z0-9]+", "_", self.source)
        self._network = BusNetwork(options_for(endpoint, options), f"cardan_{node}_{number}")
        self._service = f"{self._arm}/{ASK_SERVICE}"
        self._request = codec_of(f"{ASK_TYPE}_Request")
        self._response = codec_of(f"{ASK_TYPE}_Response")
        self._notes = codec_of(MOTIONS_TYPE)
        self._handles: tuple[Handle, ...] = ()
        """Its subscriptions to the arm, while it is open."""

    def open(self) -> None:
        """Join the bus and find the arm; returns when it has answered, after its first state.

        Raises ExtraMissingError, ConfigurationError, DriverError where the bus cannot be joined or
        there is no such arm on it, and MotionLoopError where the arm does not answer.
        """
        if self._handles:
            return
        self._network.open()
        try:
            if not self._network.wait_for_service(self._service, MEET_TIMEOUT_S):
                raise DriverError(self._why_missing())
            topic = f"{self._arm}/{MOTIONS_TOPIC}"
            heard = self._network.subscribe(topic, MOTIONS_TYPE, self._hear)
            self._begin()
            watched = self._network.watch_service(self._service, self._gone)
            self.status()
            self._handles = heard, watched
        except NetworkError as error:
            self._leave()
            raise DriverError(str(error)) from None
        except BaseException:
            self._leave()
            raise

    def _why_missing(self) -> str:
        if self._network.lonely():
            router = self._network.node.options.router
            return (
                f"no other node is on the network at {router or 'no router'}: start a router "
                "(`cardan net server router`, or rmw_zenohd), or name the session's own endpoint "
                "as router"
            )
        there = [name for name in self._network.services() if name.endswith(f"/{ASK_SERVICE}")]
        arms = ", ".join(name.removesuffix(f"/{ASK_SERVICE}") for name in there) or "none"
        return f"there is no arm {self._arm} on the bus that takes commands; there are: {arms}"

    def close(self) -> None:
        """Give up the authority, which brakes its motion to rest, and leave the bus. Never
        raises; twice is fine."""
        if not self._handles:
            return
        with contextlib.suppress(CardanError):
            self.release()
            end_s = time.monotonic() + REST_TIMEOUT_S
            while self.status().braking and time.monotonic() < end_s:
                time.sleep(LOOK_PERIOD_S)
        self._leave()

    def _leave(self) -> None:
        self._handles = ()
        self._end("the arm was closed")
        self._network.close()
        self._close()

    def _gone(self) -> None:
        self._end(GONE, rests=False)

    def _hear(self, data: bytes, _stamp_ns: int) -> None:
        """Handle the notes of motions."""
        message = self._notes.decode(data)
        if not isinstance(message, Malformed):
            self._take(message["data"].encode())

    def _send(self, request: Request, packet: bytes) -> None:
        data = self._request.encode({"request": packet.decode()})

        def answered(reply: bytes | Failure) -> None:
            if isinstance(reply, Failure):
                self._fail(request, reply.reason)
                return
            message = self._response.decode(reply)
            if isinstance(message, Malformed):
                self._fail(request, message.reason)
            else:
                self._take(message["reply"].encode())

        timeout_s = WAIT_TIMEOUT_S if request.verb == "wait" else ANSWER_TIMEOUT_S
        try:
            self._network.call(self._service, ASK_TYPE, data, answered, timeout_s)
        except NetworkError as error:
            self._fail(request, str(error))

    def _take(self, packet: bytes) -> None:
        try:
            answer = decode_answer(packet)
        except PacketError:
            return
        if answer is not None:
            self._take_answer(answer)

    def _fail(self, request: Request, reason: str) -> None:
        """A request has no reply."""
        self._take_answer(Reply(request.id, None, MotionLoopError(reason)))
