"""``cardan devices share``: an operator device for a session on another computer.

The core decides which session has the device, and keeps the edges of its buttons until they are
acknowledged; it has no I/O, and time is an argument. A single session has the device at a time: the
first to claim it, until it gives it back, or LEASE_S after its newest claim.
"""

from __future__ import annotations

import contextlib
import math
import secrets
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial

from cardan.bus.node import BusNode, Received, zenoh_config
from cardan.bus.options import BusOptions
from cardan.bus.tls import TlsWatch, tls_obstacle
from cardan.common.haptics import HapticCommand, HapticState, MeasuredForce
from cardan.common.options import Options, require
from cardan.common.realtime import ask_for_real_time, keep_processors_awake
from cardan.drivers.base import OperatorDevice
from cardan.drivers.haptic import HapticDevice
from cardan.drivers.registry import DriverTable
from cardan.drivers.remote.shared import (
    CLAIM_PERIOD_S,
    CLAIM_TYPE,
    FEEDBACK,
    MOST_EDGES,
    STATE_TYPE,
    Claim,
    Edge,
    HapticFeedback,
    RemoteHapticCommand,
    Shared,
    SharedEncoder,
    UnusableError,
    claim_topic,
    read_claim,
    state_topic,
)
from cardan.drivers.ros2_nodes.core import MOST_BYTES
from cardan.errors import AddressError, DriverError, OptionError
from cardan.gateway.force.passive import DevicePort, share_left
from cardan.gateway.force.servo_on import ForceEnabling
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.protocols.ros2.names import RosNameError, checked_name, dds_type
from cardan.protocols.ros2.zenoh import NEWEST_QOS, PUBLISHER
from cardan.spatial import add
from cardan.types import (
    NEUTRAL,
    NEVER_S,
    ZERO3,
    ButtonEvent,
    DeviceCapabilities,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
)

LEASE_S = 1.0
"""Silence of the lessee after which other sessions may get the device."""

SHORTEST_S = 0.004
"""Shortest time between two new states, unless a button changes: a SpaceMouse reports each 8 to 16
ms."""

LONGEST_S = 0.02
"""Longest time between two states of a leased device, also at rest: its newest state must be
recent."""

OF_LATENESS = 0.25
"""Share of the delay of the newest received state, by claims and their silence, for which the next
state waits: a congested link would only queue it, and delay newer ones. A motion's first state and
its last do not wait."""

TURN_S = 0.1
"""Shortest time between two of those: a hand makes some ten a second, and a trembling hand must not
fill a link."""

FREE_S = 0.25
"""Time between states of a free device, which only report that it is free."""

MAX_CLAIMS = 32
"""Most claims that wait for their turn; beyond, the oldest are dropped."""

MEET_S = 0.5
"""Duration of the search for other nodes that share under the same name: a router takes some 0.1 s
to report them."""

LOOK_S = 0.02

FORCE_S = 0.004
"""Shortest time between two forces for the hand."""

MAX_GIVEN = 64
"""Most commands that the device may not have rendered yet."""

NEWS_S = 0.5
"""Period of checks for the router, and for other nodes of the same name."""

STOOD_STILL_S = 0.1
"""Delay of a state's offer that shows a pause of this process or its computer. Input of the device
from that time is read only afterwards, as if it were new."""

SETTLE_S = 0.1
"""Time after such a pause in which input may be old: a device's reader catches up."""

MOST_KINDS = 32
"""Most kinds of refused claims that are counted separately: their text is the sender's choice."""


@dataclass(frozen=True, kw_only=True)
class SharedConfig(Options):
    """Tables that are read of a session's file; a robot is not needed."""

    device: DriverTable


@dataclass(frozen=True, kw_only=True)
class ShareOptions(Options):
    """Name of the shared device, and its network."""

    name: str
    """Name of the device for the robot's session."""
    bus: BusOptions = field(default_factory=BusOptions)

    def __post_init__(self) -> None:
        super().__post_init__()
        require("/" not in self.name, "name", self.name, "a name without /")
        try:
            checked_name(state_topic(self.name))
        except RosNameError as error:
            raise OptionError("name", self.name, f"a name of ROS 2 ({error})") from None


class ShareCore:
    """The lease of a shared device, and the messages to its holder. Times are monotonic, s."""

    def __init__(self, driver: str, run: int) -> None:
        """`run`: a nonzero number that no other process has."""
        self._driver, self._run = driver, run
        self._codec, self._dds_type = codec_of(CLAIM_TYPE), dds_type(CLAIM_TYPE)
        self._claim: Claim | None = None
        """The newest claim of the lessee."""
        self._owner = b""
        """Id of its publisher."""
        self._heard_s = NEVER_S
        self._leases = 0
        """Count of leases so far."""
        self._ended: Claim | None = None
        """The newest claim of the last lease: claims before it are late."""
        self._ended_owner = b""
        self._edges: deque[Edge] = deque()
        self._number = 0
        self._pressed: set[str] = set()
        """Buttons that are down according to their edges."""
        self._sent_s = self._new_sent_s = self._turn_sent_s = NEVER_S
        """Times of the last published state, of the last new one, and of the last that began or
        ended motion."""
        self._last: DeviceState | None = None
        """State that was published last."""
        self._changed = self._turned = False
        """True if the state has changed since, and true if motion began or ended by it."""
        self._asked = False
        """True if a claim is to be answered."""
        self._shown: DeviceFeedback | None = None
        """Feedback given to the operator last; None if unknown."""
        self._lost = False
        self._offered_s, self._next_s = NEVER_S, math.inf
        """Time of the last offer of a state, and of the next."""
        self._settled_s, self._before_s = NEVER_S, NEVER_S
        """After a pause of the process: time until which input may be old, and time of the
        pause."""
        self._still = ""
        """Reason why the device counts as lost until then."""
        self.counts: Counter[str] = Counter()
        """Refused claims and dropped edges, by kind."""

    def lessee(self, now_s: float) -> str:
        """Return the holder of the lease; empty: none."""
        self._expire(now_s)
        return "" if self._claim is None else self._claim.name or "a session"

    def on_received(self, received: Received, now_s: float) -> None:
        """Handle a claim. Never raises."""
        self._expire(now_s)
        attachment = received.attachment
        if attachment is None or received.key.split("/")[-2:-1] != [self._dds_type]:
            self.counts["claims that cannot be decoded"] += 1
            return
        if len(received.data) > MOST_BYTES:
            self.counts[f"claims of more than {MOST_BYTES} bytes"] += 1
            return
        message = self._codec.decode(received.data)
        if isinstance(message, MalformedCdr):
            self.counts["claims that are cut short"] += 1
            return
        try:
            claim = read_claim(message)
        except UnusableError as error:
            what = f"claims {error}"
            if what not in self.counts and len(self.counts) >= MOST_KINDS:
                what = "claims that are wrong in yet other ways"
            self.counts[what] += 1
            return
        self._asked |= self._take(claim, attachment.gid, now_s)

    def order(self, now_s: float) -> tuple[RemoteHapticCommand | None, float, int]:
        """Return the haptic order, None if there is none or no session has the device; its time of
        arrival, and the number of the lease."""
        self._expire(now_s)
        return (None if self._claim is None else self._claim.order), self._heard_s, self._leases

    def _take(self, claim: Claim, owner: bytes, now_s: float) -> bool:
        """Handle a claim; return whether it is to be answered."""
        known = self._claim
        if known is None:
            if not claim.wanted:
                return False
            ended = self._ended
            if (
                ended is not None
                and (claim.lessee, owner) == (ended.lessee, self._ended_owner)
                and claim.asked_s <= ended.asked_s
            ):
                self.counts["duplicate or late claims"] += 1
                return False
            self._edges.clear()
            self._leases += 1
        elif (claim.lessee, owner) != (known.lessee, self._owner):
            self.counts["claims while another session has it"] += 1
            return True
        elif claim.asked_s <= known.asked_s:
            self.counts["duplicate or late claims"] += 1
            return False
        if not claim.wanted:
            self._claim = claim
            self._end()
            return True
        self._claim, self._owner, self._heard_s = claim, owner, now_s
        while self._edges and self._edges[0].number <= claim.edges:
            self._edges.popleft()
        return True

    def _expire(self, now_s: float) -> None:
        if self._claim is not None and now_s - self._heard_s > LEASE_S:
            self.counts["leases that were not renewed"] += 1
            self._end()

    def _end(self) -> None:
        self._ended, self._ended_owner = self._claim, self._owner
        self._claim, self._owner = None, b""
        self._edges.clear()

    @property
    def due_s(self) -> float:
        """Latest time of the next offer of a state."""
        if self._claim is None:
            return self._sent_s + FREE_S
        soonest_s = self._new_sent_s + SHORTEST_S
        late_s = self._claim.late_s + self._sent_s - self._heard_s - CLAIM_PERIOD_S
        due_s = soonest_s if self._changed else self._sent_s + LONGEST_S
        due_s = max(due_s, self._sent_s + OF_LATENESS * late_s)
        if self._turned:
            return min(due_s, max(soonest_s, self._turn_sent_s + TURN_S))
        return due_s

    def offer(
        self,
        state: DeviceState,
        edges: Iterable[ButtonEvent],
        able: DeviceCapabilities,
        now_s: float,
        haptic_feedback: HapticFeedback | None = None,
    ) -> Shared | None:
        """Return the message to publish now, if one is due; `state` and `edges`, oldest first, were
        taken before `now_s`; `haptic_feedback`: that of a device with force."""
        self._expire(now_s)
        self._lost = state.link is DeviceLink.LOST
        if self._lost:
            self._shown = None
        shared = self._offer(*self._settled(state, edges, now_s), able, now_s)
        self._offered_s, self._next_s = now_s, self.due_s
        return shared if shared is None else shared._replace(haptic_feedback=haptic_feedback)

    def _offer(
        self,
        state: DeviceState,
        edges: Iterable[ButtonEvent],
        able: DeviceCapabilities,
        now_s: float,
    ) -> Shared | None:
        urgent = self._keep(edges) or self._asked
        if not state.buttons <= self._pressed:
            # Pressed after the edges were taken: its edge comes with the next state. Down without
            # an edge it would count for nothing until it is let go.
            state = state._replace(buttons=state.buttons & self._pressed)
        last = self._last
        self._changed = state != last
        self._turned = last is not None and any(state.axes) is not any(last.axes)
        if not urgent and now_s < self.due_s:
            return None
        answer, claim = self._asked, self._claim
        if self._changed:
            self._new_sent_s = now_s
        if self._turned:
            self._turn_sent_s = now_s
        self._sent_s, self._last = now_s, state
        self._changed = self._turned = self._asked = False
        return Shared(
            self._run,
            now_s,
            0 if claim is None else claim.lessee,
            "" if claim is None else claim.name,
            NEVER_S if claim is None else claim.asked_s,
            state,
            tuple(self._edges),
            self._driver,
            able if answer else None,
        )

    def _settled(
        self, state: DeviceState, edges: Iterable[ButtonEvent], now_s: float
    ) -> tuple[DeviceState, Iterable[ButtonEvent]]:
        """Return state and edges; with input from a pause of this process, the device as lost and
        edges as old."""
        if now_s - self._next_s > STOOD_STILL_S:
            # If it stalled again meanwhile, input may be from the first time.
            if now_s >= self._settled_s:
                self._before_s = self._offered_s
            self._settled_s = now_s + SETTLE_S
            self._still = f"`cardan devices share` stalled for {now_s - self._offered_s:.1f} s"
        if now_s >= self._settled_s:
            return state, edges
        if state.link is not DeviceLink.LOST:
            state = DeviceState(
                state.stamp_s, DeviceLink.STALE, NEUTRAL, frozenset(), reason=self._still
            )
        return state, [
            event._replace(stamp_s=min(event.stamp_s, self._before_s)) for event in edges
        ]

    def _keep(self, edges: Iterable[ButtonEvent]) -> bool:
        """Keep edges for the lessee; return whether there are new ones."""
        is_new = False
        for stamp_s, button, pressed in edges:
            self._number += 1
            self._pressed = self._pressed | {button} if pressed else self._pressed - {button}
            if self._claim is None:
                continue
            if len(self._edges) == MOST_EDGES:
                self._edges.popleft()
                self.counts["edges that were not acknowledged in time"] += 1
            self._edges.append(Edge(self._number, stamp_s, button, pressed))
            is_new = True
        return is_new

    def feedback(self, now_s: float) -> DeviceFeedback:
        """Return the operator's feedback: none while no session has the device."""
        self._expire(now_s)
        return DeviceFeedback(False, 0.0) if self._claim is None else self._claim.feedback

    def feedback_due(self, now_s: float) -> DeviceFeedback | None:
        """Return the feedback if it is due: once, and again for a device that was lost."""
        feedback = self.feedback(now_s)
        if self._lost or feedback == self._shown:
            return None
        self._shown = feedback
        return feedback


class DeviceEnd:
    """The device's end of a remote force: renders it. Fixtures are rendered locally, as in a
    session; forces pass through `DevicePort`."""

    def __init__(self, device: HapticDevice) -> None:
        self._device = device
        self._enabling = ForceEnabling(device)
        self._port: DevicePort | None = None
        """Passivity port of this engagement; None: there is none."""
        self._sequence = 0
        self._given: deque[tuple[int, int]] = deque(maxlen=MAX_GIVEN)
        """Commands by the device's count, and by the session's."""
        self._cycled_s = NEVER_S
        self._lease = 0
        self._refusal = ""

    @property
    def due_s(self) -> float:
        """Time of the next cycle; inf: no haptic feedback."""
        return math.inf if self._port is None else self._cycled_s + FORCE_S

    def cycle(
        self, order: RemoteHapticCommand | None, heard_s: float, lease: int, now_s: float
    ) -> None:
        """Render `order`, received at `heard_s` in the `lease` of this number; None: nothing. Never
        raises."""
        if lease != self._lease:  # The one before may have ended while this process stalled.
            self._lease = lease
            self.end(now_s)
        if now_s < self._cycled_s + FORCE_S:
            return
        self._cycled_s = now_s
        haptic = self._device.haptics()
        # An order that answers a future state of the device is none.
        if order is None or not order.command.engaged or order.answers_s > now_s:
            self.end(now_s)
            return
        command = order.command
        if self._port is None:
            self._port = DevicePort()
            self._enabling.engage(now_s)
        else:
            self._enabling.retry(now_s)
        force, measured = command.force, command.measured
        if measured is not None:
            force = add(force, measured.force)
        if haptic.pose is None:
            return
        if not haptic.rendering:
            self._port.rest()
        left = share_left(now_s - heard_s, now_s - order.answers_s)
        absorbed_j = 0.0 if measured is None else measured.absorbed_j
        force = self._port.step(haptic.pose.position, force, absorbed_j, left, now_s)
        self._give(
            command._replace(
                stamp_s=now_s,
                measured=MeasuredForce(force, now_s, position=haptic.pose.position),
                force=ZERO3,
                force_scale=command.force_scale * self._port.share,
            ),
            command.sequence,
            haptic,
        )

    def end(self, now_s: float) -> None:
        """End the engagement: no force. Never raises."""
        if self._port is not None:
            self._port = None
            self._enabling.release()
            self._give(HapticCommand(0, now_s), 0, self._device.haptics())

    def _give(self, command: HapticCommand, number: int, haptic: HapticState) -> None:
        self._sequence = max(self._sequence, haptic.command_sequence) + 1
        try:
            self._device.render(command._replace(sequence=self._sequence))
        except DriverError as error:
            self._refusal = f"the haptic device takes no command: {error}"
        else:
            self._refusal = ""
            self._given.append((self._sequence, number))

    @property
    def haptic_feedback(self) -> HapticFeedback:
        """Haptic feedback of the device."""
        haptic = self._device.haptics()
        number = 0
        for own, theirs in self._given:
            if own <= haptic.command_sequence:
                number = theirs
        reason = self._enabling.refusal or self._refusal or haptic.reason
        state = haptic._replace(command_sequence=number, reason=reason)
        return HapticFeedback(state, self._device.feedback_limits.force_n)


class News:
    """Status lines for the operator, one for each change."""

    def __init__(self, router: str, *, routed: bool) -> None:
        """`router`: its endpoint; `routed`: whether this process is connected to one."""
        self._router, self._routed, self._has_router = router, routed, routed
        self._lessee = self._missing = ""
        self._reported: set[str] = set()
        self._others: set[str] = set()
        self._obstacle = ""

    def of(self, state: DeviceState, lessee: str, counts: Mapping[str, int]) -> list[str]:
        """Return lines about the device's metrics, its lessee, and new entries in `counts`."""
        lines = []
        missing = state.reason or "lost" if state.link is DeviceLink.LOST else ""
        if missing != self._missing:
            self._missing = missing
            lines.append(f"there is no device: {missing}" if missing else "the device is there")
        if lessee != self._lessee:
            self._lessee = lessee
            lines.append(f"used by {lessee}" if lessee else "not in use")
        new = [what for what in counts if what not in self._reported]
        self._reported.update(new)
        lines += [f"refused: {what}" if what.startswith("claims") else what for what in new]
        return lines

    def of_bus(self, others: Iterable[str], *, routed: bool, obstacle: str = "") -> list[str]:
        """Return lines about the router, an `obstacle` to TLS with it, and other nodes that share a
        device under the same name."""
        lines = []
        there = set(others)
        lines += [
            f"the node {each} shares under this name, too: the robot's side takes the one that it "
            "heard first; end one of the two, or give it another --name"
            for each in sorted(there - self._others)
        ]
        self._others = there
        if self._has_router and routed is not self._routed:
            where = f" {self._router}" if self._router else ""
            lines.append(
                f"the router{where} is there again"
                if routed
                else f"the router{where} cannot be reached, and nothing moves the arm: start it "
                "again, or repair the network; this process then reconnects by itself; for a "
                "router with another address share again"
            )
        if obstacle and obstacle != self._obstacle:
            self._obstacle = obstacle
            lines.append(obstacle)
        if routed:
            self._obstacle = ""
        self._has_router = self._has_router or routed
        self._routed = routed
        return lines


def share_until(
    device: OperatorDevice,
    driver: str,
    options: ShareOptions,
    ready: Callable[[str], None],
    stop: threading.Event,
    end_s: float = math.inf,
    tell: Callable[[str], None] = lambda _words: None,
) -> None:
    """Open `device` and share it until `stop` is set, or the monotonic time `end_s`. `ready` is
    called with the topic once it is shared, `tell` with a line for each change of the device, its
    lessee, refusals, and the router. Raises DriverError, ConfigurationError, or AddressError if the
    name is taken."""
    core = ShareCore(driver, secrets.randbits(63) | 1)
    topic = state_topic(options.name)
    ask_for_real_time()  # Before the threads that opening starts.
    with contextlib.ExitStack() as stack:
        node = stack.enter_context(BusNode(options.bus, f"cardan_share_{options.name}"))
        others = node.presence(PUBLISHER, topic)
        until_s = time.monotonic() + MEET_S
        while time.monotonic() < until_s and not stop.wait(LOOK_S):
            if there := others.others():
                raise AddressError(
                    f"{options.name} is shared already, by the node {there[0].full_node}: end "
                    "that, or choose another --name"
                )
        stack.enter_context(device)
        claims = node.waiting_subscription(claim_topic(options.name), CLAIM_TYPE, MAX_CLAIMS)
        publisher = node.publisher(topic, STATE_TYPE, NEWEST_QOS, express=True)
        router = "" if options.bus.zenoh_config else options.bus.router
        news = News(router, routed=bool(node.neighbors()[0]))
        tls = TlsWatch(partial(tls_obstacle, zenoh_config(options.bus)))
        look_s = time.monotonic()
        stack.callback(keep_processors_awake, awake=False)
        encoder = SharedEncoder()
        force_end = DeviceEnd(device) if isinstance(device, HapticDevice) else None
        turn = threading.Lock()
        due_s = math.inf

        def offer() -> DeviceState:
            """Publish the newest state if that is due; return it."""
            edges, state = device.button_events(), device.state()
            haptic_feedback = None if force_end is None else force_end.haptic_feedback
            able, now_s = device.capabilities, time.monotonic()  # After its input.
            shared = core.offer(state, edges, able, now_s, haptic_feedback)
            if shared is not None:
                publisher.put(encoder.encode(shared), time.time_ns())
            return state

        def on_state(_state: DeviceState) -> None:
            with turn:
                offer()
            if core.due_s < due_s:
                claims.wake()

        stack.callback(
            device.on_state(on_state, own_thread=False)
            if force_end is None
            else device.on_state(lambda _state: claims.wake())
        )
        ready(topic)
        while not stop.is_set() and (now_s := time.monotonic()) < end_s:
            force_due_s = math.inf if force_end is None else force_end.due_s
            due_s = min(core.due_s, end_s, now_s + FREE_S, force_due_s)
            received = claims.wait(max(0.0, due_s - now_s))
            with turn:
                for _ in range(MAX_CLAIMS):
                    if received is None:
                        break
                    core.on_received(received, time.monotonic())
                    received = claims.poll()
                now_s = time.monotonic()
                if force_end is not None:
                    force_end.cycle(*core.order(now_s), now_s)
                state, lessee = offer(), core.lessee(now_s)
                feedback, counts = core.feedback_due(now_s), dict(core.counts)
            keep_processors_awake(awake=bool(lessee))
            if feedback is not None:
                _give(device, feedback)
            lines = news.of(state, lessee, counts)
            if now_s >= look_s:
                look_s = now_s + NEWS_S
                others_there = [each.full_node for each in others.others()]
                routed = bool(node.neighbors()[0])
                obstacle = tls.obstacle(now_s, routed=routed)
                lines += news.of_bus(others_there, routed=routed, obstacle=obstacle)
            for line in lines:
                tell(line)
        if force_end is not None:
            force_end.end(time.monotonic())
        _give(device, DeviceFeedback(False, 0.0))


def _give(device: OperatorDevice, feedback: DeviceFeedback) -> None:
    """Send `feedback` by the channels that the device has, and that are passed on."""
    able = device.capabilities.feedback & FEEDBACK
    given = DeviceFeedback(
        feedback.led if "led" in able else None, feedback.rumble if "rumble" in able else None
    )
    if given != DeviceFeedback():
        with contextlib.suppress(DriverError):  # A device that is unplugged shows nothing.
            device.feedback(given)
