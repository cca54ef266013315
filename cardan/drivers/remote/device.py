"""Driver of a device on another computer."""

from __future__ import annotations

import secrets
import socket
import time
from typing import Any, ClassVar

from cardan.bus.node import Publisher
from cardan.common.haptics import (
    MAX_FIXTURES,
    FeedbackLimits,
    HapticCommand,
    HapticState,
    OperatingState,
)
from cardan.drivers.base import OperatorDevice
from cardan.drivers.bus_devices.device import LOOK_S, MEET_S, BusMixin
from cardan.drivers.haptic import HapticDevice
from cardan.drivers.node_options import SIMULATED
from cardan.drivers.remote.core import RemoteCore
from cardan.drivers.remote.options import RemoteOptions
from cardan.drivers.remote.shared import CLAIM_TYPE, Claim, claim_message, flat
from cardan.errors import CommandError, DeviceAccessError
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.zenoh import NEWEST_QOS
from cardan.spatial import is_finite
from cardan.types import DeviceCapabilities, DeviceFeedback, DeviceLink

WAIT_S = 0.01
"""Period at which the reader checks its claim."""


class Remote(BusMixin[RemoteCore], OperatorDevice):
    """Operator device of another computer, published there by `cardan devices share`."""

    Options: ClassVar[type[RemoteOptions]] = RemoteOptions
    summary = "any operator device of another computer, by `cardan devices share`"
    page = "remote.md"
    peer = "spacemouse"
    simulated = SIMULATED
    gives, suits = "what that device gives", "as for that device"
    takes_back = "light, rumble, where that device has them; with `force` force"
    options: RemoteOptions
    _kind = "remote device"

    def __new__(cls, options: RemoteOptions | None = None, **keywords: Any) -> Remote:
        """Make a haptic device if the option `force` is set."""
        force = getattr(options, "force", keywords.get("force", False))
        return super().__new__(RemoteForce if force and cls is Remote else cls)

    def __init__(self, options: RemoteOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._claims: Publisher | None = None
        self._given = DeviceFeedback()
        self._command: HapticCommand | None = None
        """Newest haptic command."""

    def _make_core(self) -> RemoteCore:
        name = f"{self.options.name} at {socket.gethostname()}"
        return RemoteCore(self.options, secrets.randbits(63) | 1, name)

    @property
    def capabilities(self) -> DeviceCapabilities:
        with self._lock:
            return self._core.capabilities

    def _why_missing(self) -> str:
        options = self.options
        return (
            f"no computer shares {options.device} by the router "
            f"{self._on_bus.bus.router or 'none'}: start `cardan devices share` as "
            f"{options.device} on the operator's computer, with --router, or --zenoh-config once "
            "paired"
        )

    def _why_gone(self) -> str:
        # The next attempt to open it tells which of these is the cause.
        return (
            f"{self.options.device} is not shared any more: `cardan devices share` has ended on "
            "the operator's computer, or the router is gone, or the network between them"
        )

    def _feedback(self, feedback: DeviceFeedback) -> None:
        self._check_open("feedback()")
        led, rumble = feedback.led, feedback.rumble
        if led is not None:
            self._given = self._given._replace(led=led)
        if rumble is not None:
            self._given = self._given._replace(rumble=min(1.0, max(0.0, rumble)))

    def _connect(self) -> None:
        super()._connect()
        bus, messages = self._bus, self._messages
        assert bus is not None
        assert messages is not None
        self._claims = bus.publisher(self.options.claim_topic, CLAIM_TYPE, NEWEST_QOS, express=True)
        until_s = time.monotonic() + MEET_S
        while not self._core.leased:
            if time.monotonic() >= until_s:
                raise DeviceAccessError(
                    self._core.refusal
                    or f"{self.options.device} is shared, but does not answer: "
                    + "; ".join(self.diagnosis())
                )
            self._renew()
            self._await_message(messages, LOOK_S)

    def _wait_s(self) -> float:
        with self._lock:
            due_s = self._core.due_s
        return max(0.0, min(WAIT_S, due_s - time.monotonic()))

    def _attend(self) -> None:
        self._renew()
        if refusal := self._core.refusal:
            raise DeviceAccessError(refusal)
        with self._lock:
            played = self._core.play(time.monotonic())
        if played:
            self._notify()

    def _renew(self) -> None:
        with self._lock:
            claim = self._core.claim(time.monotonic(), self._given, self._command)
        if claim is not None:
            self._put(claim)

    def _put(self, claim: Claim) -> None:
        if self._claims is not None:
            data = codec_of(CLAIM_TYPE).encode(claim_message(claim))
            # The next renewal follows a lost one; nothing follows a lost release.
            put = self._claims.put if claim.wanted else self._claims.put_reliably
            put(data, time.time_ns())

    def _release(self) -> None:
        self._put(self._core.final_claim(time.monotonic()))
        self._claims = None
        super()._release()

    def close(self) -> None:
        super().close()
        self._given = DeviceFeedback()
        self._command = None


class RemoteForce(Remote, HapticDevice):
    """Remote device with force feedback. `cardan devices share` has the control law that keeps it
    passive; this side has the newest command, and the state published by the device's computer."""

    _enabled = False
    _last = HapticState()

    def render(self, command: HapticCommand) -> None:
        """Send `command`, and repeat the newest one every 8 ms while it engages."""
        measured = () if command.measured is None else command.measured.force
        if not is_finite(tuple(flat((command.world, command.fixtures, command.force, measured)))):
            raise CommandError(
                f"the command {command.sequence} has values that are not finite: the one before "
                "it stays"
            )
        if len(command.fixtures) > MAX_FIXTURES:
            raise CommandError(f"{len(command.fixtures)} fixtures: at most {MAX_FIXTURES}")
        if command.joint_torques_n_m is not None:
            raise CommandError("joint torques are not sent to a remote device: send a force")
        with self._lock:
            self._command = command if self._enabled else command._replace(engaged=False)

    def haptics(self) -> HapticState:
        """Return the haptic feedback of the newest state. There is no force without one, or while
        it is too old."""
        with self._lock:
            now_s, haptic_feedback = time.monotonic(), self._core.haptic_feedback
            state = self._core.state(now_s)
        if haptic_feedback is None or state.link not in (DeviceLink.LIVE, DeviceLink.NEEDS_NEUTRAL):
            reason = state.reason or f"{self.options.device} gives no force"
            return self._last._replace(stamp_s=now_s, rendering=False, reason=reason)
        self._last = haptic_feedback.state._replace(stamp_s=now_s)
        if not self._enabled:
            self._last = self._last._replace(state=OperatingState.DISABLED, rendering=False)
        return self._last

    def enable(self) -> None:
        """Allow force from the next engaged command on, which enables the remote device."""
        self._check_open("enable()")
        self._enabled = True

    def disable(self) -> None:
        with self._lock:
            self._enabled = False
            if self._command is not None:
                self._command = self._command._replace(engaged=False)

    def pause(self) -> None:
        """Stop the force until resume(). Raises CommandError unless enabled."""
        if not self._enabled:
            raise CommandError("the force is not enabled: call enable() first")
        self.disable()

    def resume(self) -> None:
        """Allow force after pause(). Raises CommandError unless paused."""
        if self._enabled:
            raise CommandError("the force is not paused")
        self.enable()

    @property
    def feedback_limits(self) -> FeedbackLimits:
        """Largest force that the device exerts; 0 while it is unknown."""
        with self._lock:
            haptic_feedback = self._core.haptic_feedback
        return FeedbackLimits(0.0 if haptic_feedback is None else haptic_feedback.largest_n)
