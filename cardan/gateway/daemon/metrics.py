"""The server for Prometheus: /metrics with the figures of all sessions and servers. At each scrape
it queries the daemon; sessions keep their own counts, and never wait for it."""

from __future__ import annotations

import asyncio
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from http import HTTPStatus
from typing import Annotated, Any, Final

from websockets.datastructures import Headers

from cardan.common import bounds
from cardan.common.extras import missing_extra
from cardan.common.options import Options
from cardan.errors import CardanError
from cardan.gateway.daemon.client import ControlClient
from cardan.gateway.servers.base import Ready, Server
from cardan.gateway.servers.web import Answer, ListenerOptions, WebSocketListener, serve_until

PORT: Final = 9464
"""Default port of the figures; Prometheus uses it for programs without a port of their own."""

PATH: Final = "/metrics"

ANSWER_S: Final = 5.0
"""Longest wait for the daemon: a scrape of Prometheus ends after 10 s."""


@dataclass(frozen=True, kw_only=True)
class MetricsOptions(ListenerOptions):
    """Address and access of the server for scrapers."""

    port: Annotated[int, bounds.ANY_PORT] = PORT


@dataclass(frozen=True, kw_only=True)
class DaemonAddress(Options):
    """Address of the daemon whose figures are shown."""

    socket: Annotated[str, bounds.PATH] = ""
    """The daemon's socket; empty: that of the daemon that runs this server, else of this user's."""


class MetricsServer:
    """Metrics server in an asyncio loop: ``async with MetricsServer(options, figures): ...``"""

    def __init__(self, options: MetricsOptions, figures: Callable[[], Any]) -> None:
        """`figures` queries the daemon, in a separate thread. Raises ConfigurationError and
        ExtraMissingError."""
        try:
            from prometheus_client.exposition import choose_encoder

            from cardan.gateway.daemon.figures import metrics_of
        except ImportError as error:
            raise missing_extra(
                "the metrics server", "prometheus_client", "metrics", error
            ) from error
        self._encoder, self._metrics_of = choose_encoder, metrics_of
        self._figures = figures
        self.counts: Counter[str] = Counter()
        """Counts of events, such as "denied": refused connections."""
        self._listener = WebSocketListener(options, self.counts, page=self._page)
        self._asking = asyncio.Lock()

    @property
    def port(self) -> int:
        """Port that it listens at."""
        return self._listener.port

    @property
    def clients(self) -> int:
        """0: no client stays connected."""
        return self._listener.clients

    async def __aenter__(self) -> MetricsServer:
        """Listen. Raises AddressError and ConfigurationError."""
        await self._listener.open()
        return self

    async def __aexit__(self, *_exception: object) -> None:
        """Disconnect all clients."""
        await self._listener.close()

    async def _page(self, path: str, headers: Headers) -> Answer | None:
        if path != PATH:
            return None
        try:
            async with self._asking:
                found = await asyncio.to_thread(self._figures)
        except CardanError as error:
            return Answer(
                "text/plain; charset=utf-8", f"{error}\n".encode(), HTTPStatus.SERVICE_UNAVAILABLE
            )
        encode, content_type = self._encoder(", ".join(headers.get_all("Accept")))
        return Answer(content_type, encode(_Collected(self._metrics_of(found))))


class _Collected:
    """Registry of metrics for an encoder."""

    def __init__(self, metrics: Iterable[Any]) -> None:
        self._metrics = list(metrics)

    def collect(self) -> Iterable[Any]:
        """The metrics."""
        return self._metrics


def asked(socket: str) -> Any:
    """Return the daemon's answer to ``figures``. Raises AddressError and ControlError."""
    with ControlClient(socket, timeout_s=ANSWER_S) as client:
        return client.ask("figures")


@dataclass(frozen=True, kw_only=True)
class MetricsServerOptions(Options):
    """The daemon behind the server, and the server."""

    daemon: DaemonAddress = field(default_factory=DaemonAddress)
    server: MetricsOptions = field(default_factory=MetricsOptions)


class Metrics(Server[MetricsServerOptions]):
    """Show Prometheus the figures of all sessions and servers of a daemon, at /metrics."""

    Options = MetricsServerOptions
    page = "daemon.md"
    example = "--port 9464"

    @classmethod
    def serve(cls, options: MetricsServerOptions, ready: Ready, stop: threading.Event) -> None:
        """Serve until `stop` is set. Raises AddressError, ConfigurationError or
        ExtraMissingError."""
        server_options = options.server

        serve_until(
            MetricsServer(server_options, lambda: asked(options.daemon.socket)),
            lambda port: ready(f"{server_options.endpoint(port, 'http')}{PATH}"),
            stop,
        )
