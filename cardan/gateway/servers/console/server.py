"""The server of the console: the page and its socket at one port."""

from __future__ import annotations

import asyncio
import datetime
import logging
import sys
import threading
from dataclasses import dataclass, field, replace
from typing import Annotated

from websockets.datastructures import Headers

from cardan.bus.discovery import bus_words, reachable
from cardan.bus.network import Network
from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.common.bounds import ANY_PORT, Range
from cardan.common.options import Options
from cardan.gateway.servers import stats
from cardan.gateway.servers.base import Ready, Server
from cardan.gateway.servers.calls import ServiceCaller
from cardan.gateway.servers.console import camera_topics
from cardan.gateway.servers.console.address import (
    own_names,
    page_address,
    picture,
    reachable_host,
)
from cardan.gateway.servers.console.cameras import Cameras, parse_camera
from cardan.gateway.servers.console.certificate import Own, own_certificate
from cardan.gateway.servers.console.client import PageOperator
from cardan.gateway.servers.console.demos import Demos
from cardan.gateway.servers.console.hold_to_run import LONGEST_S
from cardan.gateway.servers.console.records import records_of
from cardan.gateway.servers.console.site import VISUALS, Site, visual
from cardan.gateway.servers.rosbridge import RosbridgeOptions, RosbridgeServer
from cardan.gateway.servers.rosbridge_client import RosbridgeClient
from cardan.gateway.servers.tokens import Role
from cardan.gateway.servers.web import (
    Answer,
    ListenerConnection,
    Page,
    WebSocketListener,
    serve_until,
)

PORT = 8443
"""Port of the server: https without superuser rights."""

HOLD_S = Range(1, 3600, "s", "shorter ones end while one reads; an hour bounds nothing")

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ConsoleOptions(RosbridgeOptions):
    """Address, access control and allow lists of the page."""

    makes_certificate = True

    port: Annotated[int, ANY_PORT] = PORT
    records: str = ""
    """Folder of the records that pages make and view; it is created. Empty: "records" in the folder
    of the user's (a service's) state."""

    camera: tuple[str, ...] = ()
    """Cameras that pages show: NAME=ADDRESS or ADDRESS, which is the URL of a stream of JPEG
    pictures (MJPEG) or of one picture, or a device of this machine with MJPEG, such as /dev/video0.
    """

    publish_cameras: bool = False
    """Publish the cameras on the bus, too, at /camera/NAME/image_raw/compressed, and read them
    while there is a subscription."""

    hold_s: Annotated[float, HOLD_S] = LONGEST_S
    """Longest jogging of an arm without a sign of the person, s: a pointer that moves, a key that
    repeats itself, or in Chromium the browser itself."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for each in self.camera:
            parse_camera(each)
        if self.publish_cameras:
            camera_topics.check_names([parse_camera(each).name for each in self.camera])

    def with_certificate(self) -> tuple[ConsoleOptions, Own | None]:
        """Return the options with a certificate, made if one is needed and none is given, and that
        certificate; None: none was made. Raises ConfigurationError."""
        if self.certificate or not self.encrypted:
            return self, None
        host = reachable_host(self.host)
        names = list(dict.fromkeys((host, *self.hosts, *own_names())))
        own = own_certificate(names, datetime.datetime.now(datetime.timezone.utc))
        return replace(self, certificate=str(own.certificate), key=str(own.key)), own


class ConsoleServer(RosbridgeServer):
    """The server, in an asyncio loop: ``async with ConsoleServer(network, options): ...``

    Its socket, at /ws, speaks rosbridge, and takes operator frames.
    """

    def __init__(
        self,
        network: Network,
        options: ConsoleOptions | None = None,
        site: Site | None = None,
        bus: BusOptions | None = None,
    ) -> None:
        """`bus`: options of the bus for recorders; None: the defaults. Raises ConfigurationError if
        there is no page: `site`, or the built one."""
        self._site = site or Site()
        options = options or ConsoleOptions()
        self._cameras = Cameras(options.camera)
        self._published = list(self._cameras) if options.publish_cameras else []
        self._publishing: list[asyncio.Task[None]] = []
        self._hold_s = options.hold_s
        self._demos = Demos()
        self._records = records_of(options.records, bus_words(reachable(bus or BusOptions())))
        super().__init__(network, options)

    def _make_listener(self, page: Page | None = None, private: str = VISUALS) -> WebSocketListener:
        return super()._make_listener(page or self._answer, private)

    async def _serve(
        self, client: RosbridgeClient, connection: ListenerConnection, network: Network, role: Role
    ) -> None:
        assert self._mailbox is not None
        operator = PageOperator(
            network,
            ServiceCaller(network, self._mailbox),
            self._mailbox,
            self._allowed,
            role,
            f"console {client.peer}",
            client.send,
            self.counts,
            client.sender.calm,
            self._records,
            self._cameras,
            self._demos,
            self._hold_s,
        )
        async with operator:
            async for frame in connection:
                if not operator.receive(frame, connection.waited_s):
                    client.receive(frame)

    async def __aenter__(self) -> ConsoleServer:
        """Listen. Raises AddressError and ConfigurationError."""
        await super().__aenter__()
        self._publishing = [
            asyncio.create_task(camera_topics.publish(self._network, each))
            for each in self._published
        ]
        return self

    async def __aexit__(self, *exception: object) -> None:
        for task in self._publishing:
            task.cancel()
        await asyncio.gather(*self._publishing, return_exceptions=True)
        if self._records is not None:
            await self._records.close()
        await self._demos.close()
        await super().__aexit__(*exception)

    async def _answer(self, path: str, headers: Headers) -> Answer | None:
        if path.startswith(VISUALS):
            return await asyncio.to_thread(visual, path.removeprefix(VISUALS))
        accepts = ", ".join(headers.get_all("Accept-Encoding"))
        return self._site.answer(path, accepts, ", ".join(headers.get_all("If-None-Match")))


@dataclass(frozen=True, kw_only=True)
class ConsoleServerOptions(Options):
    """The bus behind the page, and the server."""

    bus: BusOptions = field(default_factory=BusOptions)
    server: ConsoleOptions = field(default_factory=ConsoleOptions)


class Console(Server[ConsoleServerOptions]):
    """Serve a page that shows and moves the arms, to browsers of computers, tablets and phones."""

    Options = ConsoleServerOptions
    page = "console.md"
    example = "--host 0.0.0.0"
    epilog = "Prints READY and the page's address, with its token, once it serves."

    @classmethod
    def serve(cls, options: ConsoleServerOptions, ready: Ready, stop: threading.Event) -> None:
        """Serve until `stop` is set. Raises AddressError, ConfigurationError, ExtraMissingError or
        DriverError."""
        server, own = options.server.with_certificate()
        if own is not None and own.why_new:
            _log.warning(
                "a certificate was made, as %s: %s; browsers ask once whether they may trust it",
                own.why_new,
                own.certificate,
            )
        host, scheme = reachable_host(server.host), "https" if server.encrypted else "http"

        def listening(port: int) -> None:
            if own is not None:
                print(f"certificate SHA-256 {own.fingerprint}", flush=True)
            if stats.is_wanted():
                # The output of a daemon's server is kept, and read by others: no token is in it.
                ready(page_address(scheme, host, port, ""))
                return
            address = page_address(scheme, host, port, server.tokens().for_starter())
            ready(address)
            if sys.stdout.isatty():
                print(picture(address), flush=True)

        with BusNetwork(options.bus, "console") as network:
            serve_until(ConsoleServer(network, server, bus=options.bus), listening, stop)
