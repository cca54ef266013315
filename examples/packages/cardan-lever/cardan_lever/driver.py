"""The lever's driver: a thread that reads the port, and a core that interprets the lines."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from cardan.drivers.core import DeviceCore
from cardan.drivers.reader_thread import ReadDevice
from cardan.drivers.serial_port import SerialPort
from cardan.drivers.shaping import Shaper, ShapingOptions
from cardan.drivers.simulated import OWN
from cardan.types import NEUTRAL, NEVER_S, Axes, DeviceCapabilities, DeviceLink

from cardan_lever.protocol import BAUD, LineReader, Report

SILENCE_S = 0.15
"""Time of seven missing lines in a row."""
SETTLE_S = 0.04
"""Time after a silence in which lines may be old ones from a queue."""


@dataclass(frozen=True, kw_only=True)
class LeverOptions(ShapingOptions):
    """Options of :class:`Lever`. Raises OptionError for a value that is not allowed."""

    path: str = "/dev/ttyUSB0"
    """Its serial port."""
    wait_for_device: bool = False
    """open() succeeds without a lever, which is picked up once it is plugged in."""


class LeverCore(DeviceCore):
    """Interpretation of the lever's lines. It is live from its first rest until it falls silent."""

    def __init__(self, options: LeverOptions) -> None:
        super().__init__()
        self._shaper = Shaper(options)
        self._reader = LineReader()
        self._deflection = NEUTRAL
        self._last_s = NEVER_S
        """Time of opening or of the last line, s."""

    def on_opened(self, now_s: float) -> None:
        """Reset: the port was opened (again)."""
        self._reader = LineReader()
        self._last_s = now_s
        self._begin("not seen at rest yet: let go of the lever once", now_s)

    def on_bytes(self, data: bytes, now_s: float) -> None:
        """Process `data` from the lever."""
        for report in self._reader.feed(data):
            if report is None:
                self._counts["malformed_lines"] += 1
            else:
                self._on_report(report, now_s)

    def _on_report(self, report: Report, now_s: float) -> None:
        self._watch(now_s)
        if self._link is DeviceLink.STALE:
            self._resume("the lever fell silent: let go of it once", SETTLE_S, now_s)
        self._heard, self._stamp_s, self._last_s = True, now_s, now_s
        self._deflection = self._shaper((report.forward, report.left, 0.0, 0.0, 0.0, report.twist))
        self._buttons.set(["trigger"] if report.trigger else [], now_s)
        at_rest = not any(self._deflection) and now_s >= self._ignore_rest_until_s
        if self._link is DeviceLink.NEEDS_NEUTRAL and at_rest:
            self._link = DeviceLink.LIVE
        self._cached = None

    @property
    def _counters(self) -> Mapping[str, str]:
        return {
            "silences": f"silences of more than {SILENCE_S:g} s",
            "malformed_lines": "lines that are none of a lever's, ignored",
        }

    def _watch(self, now_s: float) -> None:
        silent = now_s - self._last_s > SILENCE_S
        if self._open and silent and self._link is not DeviceLink.STALE:
            self._fall_silent(f"no line for {SILENCE_S:g} s: check its cable", now_s)

    def _drop_input(self, now_s: float) -> None:
        self._deflection = NEUTRAL

    def _axes(self, now_s: float) -> Axes:
        return self._deflection


class Lever(ReadDevice[LeverCore]):
    """A three-axis lever with a trigger at a serial port."""

    Options: ClassVar[type[LeverOptions]] = LeverOptions
    summary = "three-axis lever"
    page = "https://lever.example/cardan"
    peer = "lever"
    simulated = ({"path": OWN},)  # Only the simulated lever is at a path of the demo.
    gives, suits = "three deflections, a trigger", "rate, base frame"
    options: LeverOptions

    def __init__(self, options: LeverOptions | None = None, **keywords: Any) -> None:
        super().__init__(options, **keywords)
        self._core = LeverCore(self.options)
        self._port: SerialPort | None = None

    @property
    def capabilities(self) -> DeviceCapabilities:
        return DeviceCapabilities(
            gives_pose=False, buttons=("trigger",), feedback=frozenset(), battery=False
        )

    def _connect(self) -> None:
        self._port = SerialPort(self.options.path, BAUD)
        with self._lock:
            self._core.on_opened(time.monotonic())

    def _serve(self, stop: threading.Event) -> None:
        assert self._port is not None
        while not stop.is_set():
            if data := self._port.read():
                with self._lock:
                    self._core.on_bytes(data, time.monotonic())
                self._notify()

    def _release(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None
