"""Phantom Omni driver: a tick in the library's own loop, and a thread that monitors it."""

from __future__ import annotations

import atexit
import contextlib
import dataclasses
import functools
import math
import os
import threading
import time
import weakref
from pathlib import Path
from typing import Any, ClassVar

from cardan import spatial
from cardan.common.haptics import FeedbackLimits, HapticCommand, HapticState, OperatingState
from cardan.drivers.access import UDEV_HINT, usb_devices
from cardan.drivers.base import FoundDevice
from cardan.drivers.haptic import HapticDevice
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.simulated import LAUNCHED
from cardan.errors import CommandError, DeviceAccessError, DriverError, NotOpenError
from cardan.types import (
    ZERO3,
    DeviceCapabilities,
    DeviceFeedback,
    DeviceState,
    Frame,
    Pose,
    Vector3,
)
from cardan_omni.driver import library
from cardan_omni.driver.core import BUTTONS, Identity, OmniCore
from cardan_omni.driver.library import LibHD, error_words
from cardan_omni.driver.limits import WORKSPACE_LOWER_M, WORKSPACE_UPPER_M, TickLimits
from cardan_omni.driver.options import OmniOptions
from cardan_omni.driver.servo import Servo
from cardan_omni.driver.tick import Tick
from cardan_omni.driver.values import TickDetails
from cardan_omni.protocol import Capability, Info, State, to_hand

WATCH_PERIOD_S = 0.01
"""Period at which the thread checks the tick, the calibration, and for its own end."""

DEAD_AFTER_S = 0.5
"""Time without a tick after which the device is closed and opened again."""

EDGE_M = 0.01
"""Distance from the end of the device's workspace at which the spring at the edge begins."""

OMNI_WORKSPACE_M = (WORKSPACE_LOWER_M, WORKSPACE_UPPER_M)

RELEASE_TIMEOUT_S = 0.1
"""Longest wait for zero force and the end of the callback, before the loop is stopped."""

USB_IDS = {
    ("2988", "0302"): "Touch (USB)",
    ("0301", "2988"): "Touch (USB)",
    ("2988", "0304"): "Touch (USB, HID)",
}
"""Vendor and product ids of the haptic devices that identify themselves by USB."""

NO_PRIORITY = (
    "the force loop has no real-time priority, and ticks late on a busy machine: give the user the "
    "permission (`rtprio 99` in /etc/security/limits.conf, or CAP_SYS_NICE)"
)

LIGHT_ON, LIGHT_OFF = 6, 2
"""Values of the status light: steadily green, slowly blinking green."""


class Omni(ReadDevice[OmniCore], HapticDevice):
    """Phantom Omni, Geomagic Touch or 3D Systems Touch, by the vendor's library libHD.

    The force is made by compiled code in the library's own loop; this class sends it commands and
    reads its measurements. After a loss the device is reopened automatically; its force stays off
    until enable().
    """

    Options: ClassVar[type[OmniOptions]] = OmniOptions
    summary = "Phantom Omni, Geomagic Touch, 3D Systems Touch"
    page = "../plugins/cardan-omni/README.md"
    peer = "omni"
    simulated = ({"library": LAUNCHED},)
    gives = "pose of the stylus, buttons; its displacement as deflections"
    takes_back = "force at 1 kHz, light"
    suits = "position, base frame"
    udev_matches = (
        "# Older ones of the Touch are serial ports, which the vendor's driver reads.",
        'SUBSYSTEM=="tty", ATTRS{idVendor}=="2988", ATTRS{idProduct}=="0302"',
        'SUBSYSTEM=="tty", ATTRS{idVendor}=="0301", ATTRS{idProduct}=="2988"',
        'SUBSYSTEM=="hidraw", ATTRS{idVendor}=="2988", ATTRS{idProduct}=="0304"',
    )
    options: OmniOptions
    _kind = "haptic device"

    def __init__(self, options: OmniOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = OmniCore(self.options)
        self._commands = threading.Lock()
        """Lock for commands to the tick: one source at a time."""
        self._hd: LibHD | None = None
        self._handle: int | None = None
        self._scheduled: int | None = None
        self._tick: Tick | None = None
        self._servo: Servo | None = None
        self._has_light = False
        self._force_allowed = False
        """True while the motors are on."""
        self._inhibited_s = math.inf
        """Time when the tick was told that the motors will be off."""
        self._ticks_seen = 0
        self._sequence = 0
        self._disabled = 0
        """Number of calls of disable()."""
        self._at_exit = functools.partial(_close_at_exit, weakref.ref(self))

    @classmethod
    def find(cls) -> list[FoundDevice]:
        """Return the devices that identify themselves by USB, and the library; opens and loads
        nothing."""
        path, missing = library.presence()
        found = [
            FoundDevice(
                USB_IDS[ids], ":".join(ids), "usb", "", missing or _usb_obstacle(usb.folder)
            )
            for usb in usb_devices()
            if (ids := (usb.vendor_id, usb.product_id)) in USB_IDS
        ]
        if found or not path:
            return found
        words = missing or "its device (FireWire, Ethernet, simulated) shows when it is opened"
        return [FoundDevice("libHD, the library of Omni and Touch", "", "library", path, words)]

    @property
    def capabilities(self) -> DeviceCapabilities:
        """Describe the capabilities: a pose, deflections, two buttons, forces, and the status light
        if it can be set."""
        return DeviceCapabilities(
            gives_pose=True,
            buttons=BUTTONS,
            feedback=frozenset({"wrench", "led"} if self._has_light else {"wrench"}),
            battery=False,
            gives_axes=True,
        )

    @property
    def identity(self) -> Identity:
        """Identity that the device reported when it was last opened."""
        return self._core.identity

    # -- open and close ------------------------------------------------------------------------

    def open(self) -> None:
        """Open the device, start its loop and monitor it; the force is disabled.

        Raises DeviceNotFoundError or DeviceAccessError, unless `wait_for_device` is set;
        NativeMissingError if Cardan's compiled part is missing.
        """
        with self._opening:
            if self._opened:
                return
            if self._tick is None:
                self._tick = Tick(self.options.limits())
            try:
                super().open()
            except BaseException:
                self._forget_tick()
                raise
            atexit.register(self._at_exit)
        deadline_s = time.monotonic() + self.options.calibration_wait_s
        while (now_s := time.monotonic()) < deadline_s:
            with self._lock:
                if not self._opened or self._core.calibration.usable(now_s):
                    return
            time.sleep(WATCH_PERIOD_S)

    def close(self) -> None:
        """Ramp the force down, end the loop and close the device. Never raises."""
        with self._opening:
            if not self._opened:
                return
            with contextlib.suppress(Exception):
                with self._commands:
                    self._opened_tick().disable()
                self._await_no_force()
            super().close()
            atexit.unregister(self._at_exit)
            self._forget_tick()

    # -- what it measures ----------------------------------------------------------------------

    def state(self) -> DeviceState:
        """Return the newest state, from the newest tick."""
        with self._lock:
            return self._core.state(self._look())

    def haptics(self) -> HapticState:
        """Return the newest snapshot of the tick; without force, and with the reason, if it is too
        old or the device must not give force."""
        with self._lock:
            return self._core.taken(self._look())

    def details(self) -> TickDetails:
        """Return the newest tick's details: encoders, joint torques, errors of the library.

        Raises NotOpenError.
        """
        with self._lock:
            tick = self._opened_tick()
            self._look()
            return tick.details()

    def measured_pose(self) -> Pose:
        """Return the stylus's pose, whatever the state of buttons and inkwell. Raises DriverError
        if it is unknown."""
        with self._lock:
            pose, reason = self._core.measured(self._look())
        if pose is None:
            kind = DriverError if self._opened else NotOpenError
            raise kind(f"the haptic device has no position to give: {reason}")
        return pose

    # -- what it renders -----------------------------------------------------------------------

    def render(self, command: HapticCommand) -> None:
        """Render `command` from the next tick on."""
        with self._commands:
            self._opened_tick().command(command, time.monotonic())
            self._sequence = max(self._sequence, command.sequence)

    def next_sequence(self) -> int:
        """Return the highest sequence so far plus one."""
        return self._sequence + 1

    @property
    def feedback_limits(self) -> FeedbackLimits:
        """Return the force capability from the options and the device's nominal forces."""
        limits = self._limits()
        return FeedbackLimits(limits.clamp_n, limits.torque_limit_n_m, limits.energy_budget_j)

    def enable(self, wait_s: float = 0.0) -> None:
        """Enable the force; after a latched fault this tries again.

        Raises CommandError at once while that is impossible. Right after opening, or after the
        inkwell, the obstacle passes by itself ("not ready yet"): `wait_s` is the longest wait for
        that, s; disable() ends the wait.
        """
        deadline_s, disabled = time.monotonic() + wait_s, self._disabled
        while True:
            with self._commands:
                tick = self._opened_tick()
                if self._disabled != disabled:
                    raise CommandError("the force is not enabled: it was disabled meanwhile")
                with self._lock:
                    now_s = self._look()
                    obstacle = self._core.force_obstacle(now_s)
                    settling = self._core.settling(now_s)
                if not obstacle:
                    tick.enable()
                    return
            if not settling or now_s >= deadline_s:
                yet = "not ready yet, " if settling else ""
                raise CommandError(f"the force cannot be enabled: {yet}{obstacle}")
            time.sleep(WATCH_PERIOD_S)

    def disable(self) -> None:
        """Ramp the force to zero, until enable()."""
        with self._commands:
            self._disabled += 1
            self._opened_tick().disable()

    def pause(self) -> None:
        """Ramp the force to zero, until resume()."""
        with self._commands:
            self._opened_tick().pause()

    def resume(self) -> None:
        """Resume after pause()."""
        with self._commands:
            self._opened_tick().resume()

    def _feedback(self, feedback: DeviceFeedback) -> None:
        """Render a wrench's force until the next one or until it times out; its torque is ignored.
        Has no effect while the device is missing."""
        if feedback.led is not None:
            self._light(LIGHT_ON if feedback.led else LIGHT_OFF)
        if feedback.wrench is None:
            return
        force = feedback.wrench.force
        if feedback.wrench.frame is Frame.TOOL:
            with self._lock:
                pose, _ = self._core.measured(self._look())
            if pose is None:
                return  # The stylus's orientation is not known.
            force = spatial.rotate(pose.orientation, force)
        with self._commands:
            if self._tick is not None:
                self._sequence += 1
                now_s = time.monotonic()
                self._tick.command(HapticCommand(self._sequence, now_s, True, force=force), now_s)

    # -- inside: commands ----------------------------------------------------------------------

    def _opened_tick(self) -> Tick:
        if self._tick is None:
            raise NotOpenError("the haptic device is not open")
        return self._tick

    def _light(self, value: int) -> None:
        with self._lock:
            hd, handle = self._hd, self._handle
        if hd is not None and handle is not None:
            hd.set_integer(handle, State.USER_STATUS_LIGHT, value)

    def _forget_tick(self) -> None:
        with self._commands, self._lock:
            if self._tick is None or self._servo is not None or self._ending is not None:
                return  # Frees nothing while the library may still step it.
            self._tick.close()
            self._tick = None
            self._core.forget_tick()

    # -- inside: the device --------------------------------------------------------------------

    def _connect(self) -> None:
        options = self.options
        with self._commands:
            tick = self._opened_tick()
        with self._lock:
            self._core.numbers_hint = library.numbers_hint()
        hd = library.load(options.library)
        handle = hd.init_device(options.device)
        self._hd, self._handle = hd, handle
        self._force_allowed, self._inhibited_s = False, math.inf
        tick.allow(False)
        hd.enable(handle, Capability.FORCE_OUTPUT, False)
        identity = _identity(hd, handle)
        self._has_light = options.status_light and _light_works(hd, handle)
        with self._commands:
            tick.set_limits(self._limits(identity))
        self._servo = Servo(
            tick,
            hd.functions,
            handle,
            joint_torque=options.drive_by == "joint_torques",
            realtime=options.realtime,
        )
        with self._lock:
            self._core.on_opened(identity, time.monotonic())
        self._scheduled = hd.schedule(self._servo.callback, self._servo.user, handle)

    def _serve(self, stop: threading.Event) -> None:
        while not stop.is_set():
            self._watch()
            self._notify()
            stop.wait(WATCH_PERIOD_S)

    def _watch(self) -> None:
        """Check the device once. Raises DeviceAccessError if it is gone."""
        hd, handle, scheduled, tick = self._hd, self._handle, self._scheduled, self._tick
        if hd is None or handle is None or scheduled is None or tick is None:
            raise DeviceAccessError("the device was let go")
        with self._lock:
            now_s = self._look()
            snapshot = self._core.snapshot
            details = tick.details()
            self._core.errors, self._core.bad_readings = details.errors, details.bad_readings
        if not hd.scheduled(scheduled):
            with self._lock:
                self._look()  # Errors may have been added since.
            details = tick.details()
            if details.error:
                raise DeviceAccessError(error_words(details.error, details.internal_error))
            raise DeviceAccessError("the library ended the force loop without an error")
        if now_s - snapshot.stamp_s > DEAD_AFTER_S and self._core.open_for_s(now_s) > DEAD_AFTER_S:
            if snapshot.ticks != self._ticks_seen:
                words = f"the device could not be read for {DEAD_AFTER_S:g} s"
                if details.error:
                    words += f": {error_words(details.error, details.internal_error)}"
                raise DeviceAccessError(words)
            raise DeviceAccessError(
                f"the library's loop has stalled for {DEAD_AFTER_S:g} s without an error"
            )
        self._ticks_seen = snapshot.ticks
        with self._lock:
            update = self._core.take_update()
            allowed = not self._core.force_obstacle(now_s)
            style = self._core.calibration.style
            if details.realtime is False:
                self._core.hint = NO_PRIORITY
        self._switch(hd, handle, tick, snapshot, allowed)
        if update:
            hd.update_calibration(handle, style)

    def _switch(
        self, hd: LibHD, handle: int, tick: Tick, snapshot: HapticState, allowed: bool
    ) -> None:
        """Switch the motors on or off, only while the tick sends no force."""
        if allowed:
            if not self._force_allowed:
                hd.enable(handle, Capability.FORCE_OUTPUT, True)
            self._force_allowed, self._inhibited_s = True, math.inf
            tick.allow(True)
        elif self._force_allowed:
            tick.allow(False)
            self._inhibited_s = min(self._inhibited_s, time.monotonic())
            # A later tick has seen it; the tick in progress at that time may not have.
            if (
                snapshot.stamp_s > self._inhibited_s + WATCH_PERIOD_S / 2
                and snapshot.force == ZERO3
            ):
                hd.enable(handle, Capability.FORCE_OUTPUT, False)
                self._force_allowed, self._inhibited_s = False, math.inf

    def _lose(self, reason: str) -> None:
        if self._scheduled is not None:
            # In all cases: a device that is reopened has no force until it is enabled.
            with contextlib.suppress(DriverError), self._commands:
                self._opened_tick().lose()
        super()._lose(reason)

    def _release(self) -> None:
        hd, handle, scheduled, servo = self._hd, self._handle, self._scheduled, self._servo
        with self._lock:
            self._hd = self._handle = self._scheduled = None
        if hd is None or handle is None:
            return
        with contextlib.suppress(Exception):
            if servo is not None and scheduled is not None:
                servo.stop()
                deadline_s = time.monotonic() + RELEASE_TIMEOUT_S
                while hd.scheduled(scheduled) and time.monotonic() < deadline_s:
                    time.sleep(0.001)
                hd.unschedule(scheduled, handle)
            if servo is not None:
                # Only here: what the library may still call is never freed.
                servo.close()
                self._servo = None
        with contextlib.suppress(Exception):
            hd.enable(handle, Capability.FORCE_OUTPUT, False)
        with contextlib.suppress(Exception):
            hd.disable_device(handle)

    def _look(self) -> float:
        """Read the newest snapshot, with `_lock` held; return the time after it."""
        if self._tick is None:
            return time.monotonic()
        snapshot = self._tick.snapshot()
        now_s = time.monotonic()
        self._core.on_snapshot(snapshot, now_s)
        return now_s

    def _limits(self, identity: Identity | None = None) -> TickLimits:
        """Return the tick's limits, none above the device's own."""
        identity = self._core.identity if identity is None else identity
        limits = self.options.limits()
        lower, upper = identity.reach_lower_m, identity.reach_upper_m
        if (limits.workspace_lower_m, limits.workspace_upper_m) == OMNI_WORKSPACE_M and all(
            high - low > 4.0 * EDGE_M for low, high in zip(lower, upper, strict=True)
        ):
            x, y, z = lower
            a, b, c = upper
            limits = dataclasses.replace(
                limits,
                workspace_lower_m=(x + EDGE_M, y + EDGE_M, z + EDGE_M),
                workspace_upper_m=(a - EDGE_M, b - EDGE_M, c - EDGE_M),
            )
        if identity.max_force_n > 0.0:
            limits = dataclasses.replace(limits, clamp_n=min(limits.clamp_n, identity.max_force_n))
        if identity.continuous_force_n > 0.0:
            limits = dataclasses.replace(
                limits, continuous_n=min(limits.continuous_n, identity.continuous_force_n)
            )
        return limits

    def _await_no_force(self) -> None:
        deadline_s = time.monotonic() + RELEASE_TIMEOUT_S
        while time.monotonic() < deadline_s:
            with self._lock:
                now_s = self._look()
                snapshot = self._core.snapshot
            if snapshot.state is OperatingState.DISABLED and snapshot.force == ZERO3:
                return
            if now_s - snapshot.stamp_s > 0.02:  # Nothing ticks, so no force goes out.
                return
            time.sleep(0.001)


def _identity(hd: LibHD, handle: int) -> Identity:
    def doubles(what: int, count: int) -> tuple[float, ...]:
        values = hd.doubles(handle, what, count)
        return values if all(map(math.isfinite, values)) else (0.0,) * count

    firmware = doubles(Info.DEVICE_FIRMWARE_VERSION, 1)[0]
    usable = _box(doubles(Info.USABLE_WORKSPACE_DIMENSIONS, 6))
    reach = _box(doubles(Info.MAX_WORKSPACE_DIMENSIONS, 6))
    found = Identity(
        model=hd.string(handle, Info.DEVICE_MODEL_TYPE),
        serial=hd.string(handle, Info.DEVICE_SERIAL_NUMBER),
        vendor=hd.string(handle, Info.DEVICE_VENDOR),
        api_version=hd.string(handle, Info.VERSION),
        driver_version=hd.string(handle, Info.DEVICE_DRIVER_VERSION),
        firmware=f"{firmware:g}" if firmware else "",
        max_force_n=doubles(Info.NOMINAL_MAX_FORCE, 1)[0],
        continuous_force_n=doubles(Info.NOMINAL_MAX_CONTINUOUS_FORCE, 1)[0],
        max_stiffness_n_m=1e3 * doubles(Info.NOMINAL_MAX_STIFFNESS, 1)[0],
        max_damping_n_s_m=1e3 * doubles(Info.NOMINAL_MAX_DAMPING, 1)[0],
        usable_lower_m=usable[0],
        usable_upper_m=usable[1],
        reach_lower_m=reach[0],
        reach_upper_m=reach[1],
        input_dof=hd.integer(handle, Info.INPUT_DOF),
        output_dof=hd.integer(handle, Info.OUTPUT_DOF),
        calibration_styles=hd.integer(handle, Info.CALIBRATION_STYLE),
    )
    hd.errors()  # Errors about features that this device does not have.
    return found


def _box(mm: tuple[float, ...]) -> tuple[Vector3, Vector3]:
    """Return the lowest and highest corner along the hand's axes, m, of a box along HDAPI's, mm."""
    a, b = to_hand(mm[:3]), to_hand(mm[3:])
    lower, upper = (
        Vector3(*(1e-3 * pick(pair) for pair in zip(a, b, strict=True))) for pick in (min, max)
    )
    return lower, upper


def _light_works(hd: LibHD, handle: int) -> bool:
    """Return True if the status light can be set; call it before other code reads the errors."""
    hd.errors()
    hd.enable(handle, State.USER_STATUS_LIGHT, True)
    hd.set_integer(handle, State.USER_STATUS_LIGHT, LIGHT_OFF)
    return not hd.errors()


def _usb_obstacle(device: Path) -> str:
    """Return why this user cannot open the nodes of a USB device; empty if that works."""
    for kind, folder in (("tty", "tty*"), ("hidraw", "hidraw*")):
        for node in sorted(device.glob(f"*/**/{kind}/{folder}")):
            path = Path("/dev") / node.name
            if path.exists() and not os.access(path, os.R_OK | os.W_OK):
                return f"no permission for {path}: {UDEV_HINT}"
    return ""


def _close_at_exit(device: weakref.ref[Omni]) -> None:
    found = device()
    if found is not None:
        found.close()
