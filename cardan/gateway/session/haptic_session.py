"""Session of a haptic device on the network without an arm: another program computes its forces. It
has the role of the wrapper in the paper of 2026: a program reads the stylus, drives a robot by any
means, and publishes the haptic feedback. The device's own loop limits all of it."""

from __future__ import annotations

import contextlib
import logging
import math
import time

from cardan.bus.node import BusNode
from cardan.bus.router import RouterKeeper
from cardan.bus.twins import Twins
from cardan.common.haptics import OperatingState
from cardan.common.realtime import ask_for_real_time
from cardan.common.serving import interruptible
from cardan.drivers.haptic import HapticDevice
from cardan.drivers.ihaptic import IHapticDevice
from cardan.errors import DriverError
from cardan.gateway.bus.arm_topics import Diagnostics
from cardan.gateway.bus.device_topics import DeviceTopics
from cardan.gateway.bus.haptic_server import HapticServer
from cardan.gateway.force.input import FADE_IN_S
from cardan.gateway.force.lease import LEASE_S
from cardan.gateway.force.network import PublishedFeedback
from cardan.gateway.force.servo_on import ForceEnabling
from cardan.gateway.session.config import HapticConfig
from cardan.gateway.session.driver_assembly import make_device
from cardan.spatial import scale
from cardan.types import NEVER_S, Vector3

_log = logging.getLogger(__name__)

PERIOD_S = 0.004
"""Period of the loop: a fifth of the 20 ms for which the device renders a command."""

LARGEST_TORQUE_N_M = 1.0
"""Largest accepted torque, three times that of a desktop device's joint: a larger value is in mN·m,
the unit of YARP's own wrapper."""


class LoneFeedback:
    """Feedback published by programs, rendered while it is fresh, and faded in as in a session.
    Time is an argument."""

    why_no_torques = ""

    def __init__(self, device: HapticDevice, haptic: IHapticDevice, max_age_s: float) -> None:
        """`max_age_s`: age limit of a feedback."""
        self._device, self._haptic = device, haptic
        self._published = PublishedFeedback(max_age_s)
        self._enabling = ForceEnabling(device)
        self._engaged = self._rendered = False
        """True while it is rendered, and true once the device has rendered force since."""
        self._share = 0.0
        """Share of the feedback that is faded in."""
        self._cycle_s = NEVER_S
        self._faults = 0
        """Fault count of the device when it was engaged."""
        self._ended = ""
        """Reason for the end of the stream; it is refused until it was stopped or silent."""
        self._heard_s = NEVER_S

    def give(self, publisher: int, sequence: int, asked: Vector3, now_s: float) -> str:
        """Take a feedback. Return why it is not taken, or not rendered."""
        silent = now_s - self._heard_s > LEASE_S
        self._heard_s = now_s
        if silent:
            self._ended = ""
        if self._ended:
            return f"{self._ended}; call stop_feedback, or be silent for {LEASE_S:g} s"
        joint = not self._haptic.is_cartesian_force_mode_enabled()
        if joint and not all(abs(each) <= LARGEST_TORQUE_N_M for each in asked):
            return (
                f"the torques {tuple(asked)} are not within {LARGEST_TORQUE_N_M:g} N·m: in the "
                "mode joint the unit is N·m, not mN·m"
            )
        return self._published.give(publisher, sequence, asked, now_s) or self._enabling.refusal

    def stop(self) -> str:
        """Render no feedback until the next one, from any publisher."""
        self._published.stop()
        self._ended = ""
        self._release()
        return ""

    def cycle(self, now_s: float) -> None:
        """Render the newest feedback, or none. Called several times in the time that the device
        holds a command."""
        dt_s, self._cycle_s = now_s - self._cycle_s, now_s
        asked = None if self._published.stopped else self._published.fresh(now_s)
        if asked is None or self._ended:
            self._release()
            return
        haptic = self._device.haptics()
        if not self._engaged:
            self._engaged, self._faults = True, haptic.faults
            self._rendered, self._share = False, 0.0
            self._enabling.engage(now_s)
        else:
            self._enabling.retry(now_s)
            self._rendered = self._rendered or haptic.rendering
        if self._rendered:
            self._share = min(1.0, self._share + dt_s / FADE_IN_S)
        if haptic.state is OperatingState.FAULT and haptic.faults > self._faults:
            self._end(haptic.reason or "the device's force is in FAULT")
            return
        try:
            self._haptic.set_feedback(scale(asked, self._share))
        except DriverError as error:
            self._end(str(error))

    def _end(self, reason: str) -> None:
        self._ended = f"the force is lost: {reason}"
        self._release()

    def _release(self) -> None:
        if self._engaged:
            self._engaged = False
            self._enabling.release()
            with contextlib.suppress(DriverError):
                self._haptic.stop_feedback()

    def diagnosis(self) -> tuple[str, ...]:
        """Reasons why there is no force, and refusals."""
        words = (self._ended, self._enabling.refusal)
        return (*filter(None, words), *self._published.diagnosis())


def serve_haptic(config: HapticConfig, seconds: float | None = None) -> None:
    """Serve the configured device until `seconds` are over or a signal ends it.

    Prints READY and the name of its node once it serves. Raises DriverError if the device cannot be
    opened or the bus cannot be joined, ConfigurationError if another node has its name,
    ExtraMissingError.
    """
    options = config.network
    device = make_device(config)
    assert isinstance(device, HapticDevice)
    with contextlib.ExitStack() as opened:
        ended = opened.enter_context(interruptible())
        opened.enter_context(device)
        router = opened.enter_context(contextlib.closing(RouterKeeper(options)))
        router.poll()
        node = BusNode(options, options.haptic, f"/{options.namespace}")
        opened.callback(node.close)
        node.join()
        twins = Twins(node, "haptic")
        twins.begin()
        haptic = IHapticDevice(device)
        feedback = LoneFeedback(device, haptic, config.force.max_age_s)
        opened.callback(feedback.stop)
        given = feedback if options.commands else None
        server = HapticServer(node, device, haptic, given, period_s=1.0 / options.rate_hz)
        shown = DeviceTopics(node, device.capabilities.buttons) if options.device else None
        diagnostics = Diagnostics(node)
        ask_for_real_time()
        print(f"READY {node.full_name}", flush=True)
        twin = ""
        end_s = math.inf if seconds is None else time.monotonic() + seconds
        while not ended.is_set() and (now_s := time.monotonic()) < end_s:
            now_ns = time.time_ns()
            said, listens = twins.state()
            if said != twin:
                twin = said
                _log.warning("%s", said or "no other node has this one's name any more")
            server.inhibited = "" if listens else said
            server.poll(now_s)
            feedback.cycle(now_s)
            server.publish(now_s, now_ns)
            if shown is not None:
                shown.offer(device.state(), now_s, now_ns)
            diagnostics.put(lambda: (server.part(),), now_s, now_ns)
            router.poll()
            ended.wait(max(0.0, now_s + PERIOD_S - time.monotonic()))
