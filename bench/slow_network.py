"""TCP over networks as they are, on loopback: what passes is held back, by a process of its own.

Of what a network loses TCP makes a delay: the segment is sent anew once three later ones were
acknowledged, and what came meanwhile waits for it. The order is kept, so jitter only ever makes
gaps and bunches. Each direction has its own chance.
"""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import random
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Final, NamedTuple

SEGMENT_S: Final = 0.008
"""From one segment to the next: a SpaceMouse's reports."""
AT_ONCE: Final = 65536


class Network(NamedTuple):
    """One of the issue's networks, each way."""

    name: str
    delay_s: float
    jitter_s: float
    """Half of the range in which delays are."""
    loss: float
    stall_s: float
    """For so long it stands still, ..."""
    stall_every_s: float
    """... once in so long; 0: never."""
    max_age_s: float
    """Of the driver, as docs/remote.md would have it set."""
    aim_ms: tuple[float, float]
    """Median and p99 from the device to the arm, beyond the delay."""
    rest_s: float
    """Aim from letting go to rest."""

    @property
    def in_words(self) -> str:
        """For a table."""
        words = [f"{1e3 * self.delay_s:g}"]
        if self.jitter_s:
            words[0] += f" ± {1e3 * self.jitter_s:g}"
        words[0] += " ms"
        if self.loss:
            words.append(f"{self.loss:.1%}")
        if self.stall_s:
            words.append(f"{1e3 * self.stall_s:g} ms each {self.stall_every_s:g} s")
        return ", ".join(words)

    @property
    def longest_s(self) -> float:
        """What it delays at most, but for several losses at once."""
        return self.delay_s + self.jitter_s + self.stall_s + 2 * self.delay_s + 3 * SEGMENT_S


NETWORKS: Final = (
    Network("LAN", 0.0003, 0.0, 0.0, 0.0, 0.0, 0.15, (1.0, 3.0), 0.12),
    Network("Wi-Fi", 0.005, 0.005, 0.01, 0.08, 2.0, 0.15, (1.0, 10.0), 0.255),
    Network("LTE", 0.045, 0.02, 0.01, 0.5, 10.0, 0.25, (2.0, 25.0), 0.295),
    Network("Internet", 0.12, 0.01, 0.005, 0.0, 0.0, 0.4, (2.0, 15.0), 0.37),
)


class _Way:
    """One direction of one connection."""

    def __init__(self, network: Network, chosen: random.Random) -> None:
        self._network, self._chosen = network, chosen
        self._arrived_s = 0.0

    def arrives_s(self, now_s: float) -> float:
        """When what is sent now arrives."""
        network, chosen = self._network, self._chosen
        takes_s = network.delay_s + chosen.uniform(-network.jitter_s, network.jitter_s)
        while chosen.random() < network.loss:
            takes_s += 2 * network.delay_s + 3 * SEGMENT_S
        arrives_s = now_s + takes_s
        if network.stall_s and arrives_s % network.stall_every_s < network.stall_s:
            arrives_s += network.stall_s - arrives_s % network.stall_every_s
        self._arrived_s = max(arrives_s, self._arrived_s)
        return self._arrived_s

    async def carry(self, source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
        """Until the end of the connection."""
        loop = asyncio.get_running_loop()
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

        async def deliver() -> None:
            while True:
                at_s, data = await waiting.get()
                await asyncio.sleep(at_s - loop.time())
                sink.write(data)
                if not data:
                    sink.close()
                    return

        delivering = asyncio.create_task(deliver())
        with contextlib.suppress(OSError):
            while data := await source.read(AT_ONCE):
                waiting.put_nowait((self.arrives_s(loop.time()), data))
        waiting.put_nowait((self.arrives_s(loop.time()), b""))
        with contextlib.suppress(OSError):
            await delivering


async def _serve(network: Network, port: int, ready: Connection) -> None:
    chosen = random.Random(0)

    async def joined(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", port)
        there, back = _Way(network, chosen), _Way(network, chosen)
        await asyncio.gather(there.carry(reader, far_writer), back.carry(far_reader, writer))

    server = await asyncio.start_server(joined, "127.0.0.1", 0)
    ready.send(server.sockets[0].getsockname()[1])
    await server.serve_forever()


def _run(network: Network, port: int, ready: Connection) -> None:
    asyncio.run(_serve(network, port, ready))


@contextlib.contextmanager
def between(network: Network, port: int) -> Iterator[int]:
    """A port of this computer, from which the network leads to `port`."""
    spawned = multiprocessing.get_context("spawn")
    here, there = spawned.Pipe()
    process = spawned.Process(target=_run, args=(network, port, there), daemon=True)
    process.start()
    there.close()
    try:
        yield here.recv()
    finally:
        process.terminate()
        process.join()
