"""A shared device and the remote driver, joined by a network in virtual time."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from typing import NamedTuple

from cardan.bus.node import Received
from cardan.drivers.remote import RemoteOptions
from cardan.drivers.remote.core import RemoteCore
from cardan.drivers.remote.shared import (
    CLAIM_TYPE,
    STATE_TYPE,
    claim_message,
    shared_message,
)
from cardan.gateway.bus.sharing import DeviceEnd, ShareCore
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.names import dds_type
from cardan.protocols.ros2.zenoh import Attachment
from cardan.types import (
    NEUTRAL,
    Axes,
    ButtonEvent,
    DeviceCapabilities,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
)

STEP_S = 0.002
ABLE = DeviceCapabilities(False, ("hold", "grip"), frozenset({"led", "rumble"}), False)


def received(kind, message, sequence=1, sender=1, key_type=None):
    """Return a message in a subscription's form."""
    key = f"0/shared/x/{dds_type(key_type or kind)}/RIHS01_0"
    data = message if isinstance(message, bytes) else codec_of(kind).encode(message)
    return Received(data, key, Attachment(sequence, sequence, bytes([sender]) * 16))


class Link(NamedTuple):
    """One direction of a network."""

    delay_s: float = 0.0003
    jitter_s: float = 0.0
    loss: float = 0.0
    twice: float = 0.0
    in_order: bool = True

    @property
    def slowest_s(self):
        """Longest transit time, without stalls and other traffic."""
        return self.delay_s + self.jitter_s


LAN = Link()

AHEAD_BYTES = 1 << 16
"""Limit on other traffic queued ahead of a state (docs/remote.md, pictures)."""


class Way:
    """Data in transit in one direction."""

    def __init__(self, link, chosen):
        self.link, self._chosen = link, chosen
        self._queue = []
        self._numbers = itertools.count()
        self._last_s = 0.0
        self.stalled_until_s = 0.0
        self.cut = False
        self.rate_bps = math.inf
        self._free_s = 0.0
        """Time at which all data in the queue has been sent."""

    def send(self, item, now_s):
        link, chosen = self.link, self._chosen
        if self.cut or chosen.random() < link.loss:
            return
        if self.rate_bps < math.inf:
            now_s = self._free_s = self._passed_s(len(item.data), now_s)
        for _ in range(1 + (chosen.random() < link.twice)):
            arrives_s = now_s + link.delay_s + chosen.uniform(0.0, link.jitter_s)
            arrives_s = max(arrives_s, self.stalled_until_s)
            if link.in_order:
                arrives_s = self._last_s = max(arrives_s, self._last_s)
            heapq.heappush(self._queue, (arrives_s, next(self._numbers), item))

    def picture(self, size, now_s):
        """Queue `size` bytes of other traffic, or drop them if the queue ahead is too long."""
        passed_s = self._passed_s(size, now_s)
        if (passed_s - now_s) * self.rate_bps <= 8 * AHEAD_BYTES:
            self._free_s = passed_s

    def _passed_s(self, size, now_s):
        return max(self._free_s, now_s) + 8 * size / self.rate_bps

    def stall(self, until_s):
        """Deliver nothing before that time, and then everything."""
        self.stalled_until_s = until_s
        self._queue = [(max(at_s, until_s), n, item) for at_s, n, item in self._queue]
        heapq.heapify(self._queue)

    def arrived(self, now_s):
        while self._queue and self._queue[0][0] <= now_s:
            yield heapq.heappop(self._queue)[2]


class Bench:
    """Operator's computer, network, and driver of a session.

    `lie_s` is an offset of the operator's clock.
    """

    def __init__(
        self,
        down=LAN,
        up=None,
        seed=1,
        offset_s=1000.0,
        drift=0.0,
        haptic=None,
        now_s=50.0,
        **options,
    ):
        chosen = random.Random(seed)
        self.down, self.up = Way(down, chosen), Way(down if up is None else up, chosen)
        self.offset_s, self.drift, self.lie_s = offset_s, drift, 0.0
        self.now_s = now_s
        self.options = RemoteOptions(device="x", **options)
        self.core = RemoteCore(self.options, 7, "arm at robot")
        self.numbers, self.sender = itertools.count(1), 1
        self.claim_numbers, self.claimant = itertools.count(1), 9
        self.sent = {}
        """Send time of each state and the claim that it answers, by its number."""
        self.came = []
        """Arrival time of each state, its send time and the claim that it answers: by the session's
        clock."""
        self.direction = (1.0, 0.0, 0.0)
        """Direction of the deflection by move()."""
        self.share = ShareCore("spacemouse", 11)
        self.device = DeviceState(self.there_s, DeviceLink.LIVE, NEUTRAL, frozenset())
        self.edges = []
        self.given = DeviceFeedback()
        self.haptic, self.command = haptic, None
        self.force_end = None if haptic is None else DeviceEnd(haptic)
        self.heard = []
        """Button edges that the driver returned."""
        self.frozen = False
        """True while the sharing process is stopped."""
        self.asleep = False
        """True while the operator's computer sleeps, and its monotonic clock with it
        (CLOCK_MONOTONIC of Linux)."""
        self.mangle = lambda message: message
        self.core.on_opened(self.now_s)

    @property
    def there_s(self):
        """Time by the operator's clock."""
        return self.now_s * (1.0 + self.drift) + self.offset_s + self.lie_s

    @property
    def state(self):
        return self.core.state(self.now_s)

    def count(self, name):
        return self.core.metrics(self.now_s)[name]

    def move(self, x=0.0, link=DeviceLink.LIVE, reason=""):
        axes = Axes(*(x * part for part in self.direction), 0.0, 0.0, 0.0)
        buttons = self.device.buttons if link is DeviceLink.LIVE else frozenset()
        self.device = DeviceState(self.there_s, link, axes, buttons, reason=reason)

    def press(self, button="hold", pressed=True):
        self.edges.append(ButtonEvent(self.there_s, button, pressed))
        buttons = self.device.buttons
        buttons = buttons | {button} if pressed else buttons - {button}
        self.device = self.device._replace(stamp_s=self.there_s, buttons=buttons)

    def run(self, seconds, each=lambda: None):
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s += STEP_S
            each()
            self.operator()
            for item in self.down.arrived(self.now_s):
                self.came.append((self.now_s, *self.sent[item.attachment]))
                self.core.on_received(item, self.now_s)
            claim = self.core.claim(self.now_s, self.given, self.command)
            if claim is not None:
                self.up.send(self.claimed(claim), self.now_s)
            self.heard += self.core.events()

    def operator(self):
        """Run a step of the sharing computer."""
        if self.asleep:
            self.lie_s -= STEP_S * (1.0 + self.drift)
        if self.asleep or self.frozen:
            return
        for item in self.up.arrived(self.now_s):
            self.share.on_received(item, self.there_s)
        edges, self.edges = self.edges, []
        haptic_feedback = None
        if self.force_end is not None:
            self.force_end.cycle(*self.share.order(self.there_s), self.there_s)
            haptic_feedback = self.force_end.haptic_feedback
        shared = self.share.offer(self.device, edges, ABLE, self.there_s, haptic_feedback)
        if shared is not None:
            message = self.mangle(shared_message(shared))
            item = received(STATE_TYPE, message, next(self.numbers), self.sender)
            self.sent[item.attachment] = self.now_s, shared.asked_s
            self.down.send(item, self.now_s)

    def claimed(self, claim, sender=None):
        sender = self.claimant if sender is None else sender
        return received(CLAIM_TYPE, claim_message(claim), next(self.claim_numbers), sender)

    def live(self):
        """Run until the device is live."""
        self.run(1.0)
        assert self.state.link is DeviceLink.LIVE, self.state.reason
        return self


def in_age(bench, bound_s, seconds, each=lambda: None):
    """Run with a deflection that encodes its own time; check that no used state is older than
    `bound_s`.

    Returns the number of steps with a used state.
    """
    began_s, counted = bench.now_s, 0

    def step():
        nonlocal counted
        each()
        bench.move(0.1 + 0.8 * (bench.now_s - began_s) / seconds)
        x = bench.state.axes.x
        if x:
            counted += 1
            made_s = began_s + (x - 0.1) / 0.8 * seconds
            assert bench.now_s - made_s <= bound_s, f"{bench.now_s - made_s:.3f} s old"

    bench.run(seconds, step)
    return counted
