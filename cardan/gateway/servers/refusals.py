"""Reports of refused commands to the clients of a server, such as of a stream while another source
has the authority: a topic has no answer of its own."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Iterator
from functools import partial

from cardan.bus.network import Handle, Network, NetworkError
from cardan.gateway.servers.calls import Mailbox
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of

RESULT = "cardan_msgs/msg/CommandResult"

LOOK_S = 0.5
"""Period of checks for new arms: the graph is cached, so a check is cheap, and an arm's session
takes longer to begin."""

Refused = Callable[[str, str], None]
"""Called with a client's command, and why it was refused."""


class Refusals:
    """Subscriber to the results of all arms on the network while there are clients. For one
    loop."""

    def __init__(self, network: Network, mailbox: Mailbox) -> None:
        self._network, self._mailbox = network, mailbox
        self._callbacks: dict[str, Refused] = {}
        self._heard: dict[str, Handle] = {}
        self._looking: asyncio.Task[None] | None = None

    def begin(self) -> None:
        """Look for arms from now on."""
        self._looking = asyncio.get_running_loop().create_task(self._look())

    def end(self) -> None:
        """Unsubscribe from all arms."""
        if self._looking is not None:
            self._looking.cancel()
        for handle in self._heard.values():
            handle.close()
        self._heard.clear()

    @contextlib.contextmanager
    def telling(self, node: str, callback: Refused) -> Iterator[None]:
        """Call `callback` for refusals of the client with this node on the network."""
        self._callbacks[node] = callback
        self._listen()
        try:
            yield
        finally:
            del self._callbacks[node]

    async def _look(self) -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            with contextlib.suppress(NetworkError):  # The network is being left.
                self._listen()

    def _listen(self) -> None:
        """Subscribe to the present arms only."""
        topics = self._network.topics()
        arms = [
            name
            for name, topic in topics.items()
            if self._callbacks and topic.type == RESULT and topic.publishers
        ]
        for name in self._heard.keys() - set(arms):
            self._heard.pop(name).close()
        for name in arms:
            if name not in self._heard:
                with contextlib.suppress(NetworkError):  # It is leaving; the next look shows it.
                    self._heard[name] = self._network.subscribe(name, RESULT, self._hear)

    def _hear(self, cdr: bytes, _stamp_ns: int) -> None:
        """Handle a result. In any thread."""
        result = codec_of(RESULT).decode(cdr)
        if isinstance(result, MalformedCdr) or result["outcome"] != "refused":
            return
        # "ros2 /NODE", and a mark where two have that name.
        node = f"/{result['source'].partition(' /')[2].partition('#')[0]}"
        callback = self._callbacks.get(node)
        if callback is not None:
            self._mailbox.put(partial(callback, result["command"], result["reason"]))
