"""A run of the soak: start the lab, run devices, programs and faults in it, and stop everything."""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from bench.soak import rules
from bench.soak.clients import Clients
from bench.soak.faults import Faults
from bench.soak.lab import DEVICES_OF
from bench.soak.rules import Violation
from bench.soak.sampling import left_behind
from bench.soak.watch import Watch
from cardan.common.signals import signal_name

REPORT_S: Final = 30.0

READY_WITHIN_S: Final = 120.0
"""Timeout for the start of all processes."""

PARTS_END_S: Final = 20.0
"""Timeout for the current action at the end."""

ENDS_WITHIN_S: Final = 20.0
"""Timeout for the end of all processes."""


class Soak:
    """A run of the soak."""

    def __init__(self, folder: Path, seed: int, hours: float) -> None:
        self.watch = watch = Watch(folder, seed, hours)
        self.report, self.stop = watch.report, watch.stop
        self._hours = hours
        self._clients, self._faults = Clients(watch), Faults(watch)

    def end(self, number: int) -> None:
        """End the run early because of this signal."""
        self.report.cut = f"by {signal_name(number)}"
        self.stop.set()

    def run(self) -> int:
        """Run until the time is over or `stop` is set; return the number of violations."""
        watch = self.watch
        try:
            watch.lab.start()
            self._wait_until_ready()
            self._clients.find_homes()
            self.report.begin()
            parts: list[Callable[[], None]] = [
                watch.poll, watch.sample, self._clients.run, self._faults.run, self._faults.operate,
                *(functools.partial(watch.device, device) for device in DEVICES_OF),
            ]  # fmt: skip
            threads = [
                threading.Thread(target=self._guarded, args=(each,), daemon=True) for each in parts
            ]
            for thread in threads:
                thread.start()
            end_s = time.monotonic() + 3600.0 * self._hours
            while (left_s := end_s - time.monotonic()) > 0.0:
                if self.stop.wait(min(left_s, REPORT_S)):
                    break
                self._write()
            self.stop.set()
            give_up_s = time.monotonic() + PARTS_END_S
            for thread in threads:
                thread.join(max(0.0, give_up_s - time.monotonic()))
            watch.sample_once()
        finally:
            self.stop.set()
            stubborn = watch.lab.end()
            left = left_behind(watch.folder, watch.mark, watch.mapped, ENDS_WITHIN_S)
            for each in (*stubborn, *left):
                watch.found(Violation(time.monotonic(), "nothing is left", "at the end", each))
            self.report.over = True
            self._write()
            self.report.close()
        grown = sum(each.exceeded for each in self.report.drifts())
        return len(self.report.violations) + grown

    def _guarded(self, call: Callable[[], None]) -> None:
        """Run a part of the soak; an error in it is reported and ends the run."""
        try:
            call()
        except Exception as error:
            if not self.stop.is_set():
                self.report.broken(f"{call}: {error!r}")
                self.stop.set()
                raise

    def _write(self) -> None:
        watch = self.watch
        with watch.lock:
            moves = {name: (each.moves, each.moving_s) for name, each in watch.arms.items()}
            self.report.write(moves, list(watch.recovery.took_s))

    def _wait_until_ready(self) -> None:
        give_up_s = time.monotonic() + READY_WITHIN_S
        while True:
            rows = self.watch.ask("units")
            # A device becomes live after its first deflection.
            if all(not rules.problem_of(row, False) for row in rows):
                return
            if time.monotonic() > give_up_s or self.stop.wait(0.2):
                raise TimeoutError(f"not all of the lab runs: {rows}")
