"""Cost of one SpaceMouse report: Cardan's core against PySpaceMouse, in turns, in one run.

    python bench/hid_parse.py [--reports N] [--rounds N]

Both get the same reports as bytes, without any I/O: PySpaceMouse's ``read()`` with a stand-in for
its HID device, Cardan's ``on_report()``, alone and followed by ``state()``, which PySpaceMouse's
figure includes. Cardan's core also monitors silence, gaps and drift. The table has the medians of
the rounds' means; ratios are PySpaceMouse's cost divided by Cardan's.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from itertools import cycle, islice

import pyspacemouse
from pyspacemouse.device import SpaceMouseDevice

from cardan.drivers.spacemouse import SpaceMouseCore, SpaceMouseOptions
from cardan.protocols.connexion.devices import Family, find_model
from cardan.protocols.connexion.reports import (
    decode_input,
    encode_buttons,
    encode_motion,
    encode_rotation,
    encode_translation,
)

MODELS = ("SpaceNavigator", "SpaceMousePro", "SpaceMouseWireless", "SpaceMouseEnterprise")
RAW = ((120, -45, 300, -350, 8, 64), (121, -44, 299, -349, 7, 65))
PERIOD_S = 0.016


class StubHid:
    """Stand-in for PySpaceMouse's HID device: returns the reports in a loop."""

    def __init__(self, reports: Sequence[bytes]) -> None:
        self._next = cycle(reports).__next__

    def read(self, size: int) -> bytes:
        return self._next()[:size]


def theirs(spec: pyspacemouse.DeviceInfo, reports: Sequence[bytes]) -> Callable[[int], float]:
    device = SpaceMouseDevice(spec, StubHid(reports))

    def run(count: int) -> float:
        read = device.read
        begin_s = time.perf_counter()
        for _ in range(count):
            read()
        return time.perf_counter() - begin_s

    return run


def ours(
    spec: pyspacemouse.DeviceInfo, reports: Sequence[bytes], with_state: bool
) -> Callable[[int], float]:
    model = find_model(spec.vendor_id, spec.product_id)
    core = SpaceMouseCore(SpaceMouseOptions(), model)
    core.on_opened(0.0, model)
    for report in (encode_translation(0, 0, 0), encode_rotation(0, 0, 0)):
        core.on_report(report, 0.0)
    now_s = 0.0

    def run(count: int) -> float:
        nonlocal now_s
        feed, state, t = core.on_report, core.state, now_s
        stream = islice(cycle(reports), count)
        begin_s = time.perf_counter()
        if with_state:
            for report in stream:
                t += PERIOD_S
                feed(report, t)
                state(t)
        else:
            for report in stream:
                t += PERIOD_S
                feed(report, t)
        cost_s = time.perf_counter() - begin_s
        now_s = t
        return cost_s

    return run


REPORTS = 5000
ROUNDS = 15


def decoding(reports: Sequence[bytes]) -> Callable[[int], float]:
    def run(count: int) -> float:
        stream = islice(cycle(reports), count)
        begin_s = time.perf_counter()
        for report in stream:
            decode_input(report)
        return time.perf_counter() - begin_s

    return run


def reports_of(spec: pyspacemouse.DeviceInfo) -> dict[str, list[bytes]]:
    model = find_model(spec.vendor_id, spec.product_id)
    assert model is not None
    if model.family is Family.SPLIT:
        halves = ((encode_translation(*raw[:3]), encode_rotation(*raw[3:])) for raw in RAW)
        motion = [report for pair in halves for report in pair]
    else:
        motion = [encode_motion(*raw) for raw in RAW]
    buttons = [encode_buttons(mask, model.button_report_bytes) for mask in (0b01, 0b11, 0b10, 0)]
    return {"motion": motion, "buttons": buttons}


def main() -> None:
    """Print the table."""
    print(f"\n3Dconnexion reports, median of {ROUNDS} x {REPORTS}, taken in turns\n")
    print("us per report         decode  on_report   +state  PySpaceMouse   ratio  ratio(+state)")
    specs = pyspacemouse.get_device_specs()
    for name in MODELS:
        for kind, reports in reports_of(specs[name]).items():
            runs = (
                decoding(reports),
                ours(specs[name], reports, with_state=False),
                ours(specs[name], reports, with_state=True),
                theirs(specs[name], reports),
            )
            costs: list[list[float]] = [[] for _ in runs]
            for _ in range(ROUNDS):
                for run, cost in zip(runs, costs, strict=True):
                    cost.append(run(REPORTS))
            decode, feed, state, other = (1e6 * statistics.median(cost) / REPORTS for cost in costs)
            title = f"{name.removeprefix('SpaceMouse')} {kind}"
            print(
                f"{title:21} {decode:6.2f} {feed:10.2f} {state:8.2f} {other:13.2f}"
                f" {other / feed:7.2f} {other / state:14.2f}"
            )


if __name__ == "__main__":
    main()
