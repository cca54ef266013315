"""Cost of one report in the driver of each operator device: bytes in, newest state out.

    python -m bench device-parse

No I/O. Reports of a moving simulated device are recorded in virtual time by the tests' benches and
fed to the driver's core in a loop, each followed by ``state()``. The table has medians of batches.
The last column is the share of one core at the device's own rate. For a comparison of the
SpaceMouse with PySpaceMouse see hid-parse.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable, Iterator
from itertools import cycle
from typing import NamedTuple

from bench.figures import median_costs
from cardan.drivers.core import DeviceCore
from cardan.drivers.spacemouse import SpaceMouseCore, SpaceMouseOptions
from cardan.drivers.spnav import SpnavCore, SpnavOptions
from cardan.protocols.connexion.devices import find_model
from cardan.protocols.connexion.reports import encode_motion
from cardan.types import DeviceLink, DeviceState
from cardan_leap.driver import LeapCore, LeapOptions
from cardan_leap.peer import SimulatedLeapService
from cardan_leap.protocol import decode_service
from cardan_serial_mice.driver.session import SerialSession, device_model
from cardan_serial_mice.protocol import (
    SpaceballMotion,
    encode_orb_keys,
    encode_orb_motion,
    encode_spaceball_motion,
    serial_model_by_key,
)
from cardan_spnav_server.protocol import encode_motion as encode_spnav_motion
from cardan_wiimote.driver import WiimoteOptions
from tests.drivers import evdev_bench
from tests.plugin_benches import jr3_bench, wiimote_bench

RECORD_S = 1.0
RAW = ((120, -45, 300, -350, 8, 64), (121, -44, 299, -349, 7, 65))


class Recorded(NamedTuple):
    """Reports of a device in motion, and a core that has already seen it at rest."""

    core: DeviceCore
    feed: Callable[[bytes, float], None]
    reports: Iterable[bytes]
    period_s: float
    """Period of the reports."""
    now_s: float


def spacemouse() -> Recorded:
    """SpaceMouse: a whole report, as a SpaceMouse Wireless sends it."""
    core = SpaceMouseCore(SpaceMouseOptions(), model := find_model(0x256F, 0xC62E))
    core.on_opened(0.0, model)
    core.on_report(encode_motion(0, 0, 0, 0, 0, 0), 0.0)
    return Recorded(core, core.on_report, [encode_motion(*raw) for raw in RAW], 0.016, 0.0)


def magellan() -> Recorded:
    """Magellan: the worked example's serial packet."""
    return _serial(
        "magellan",
        b"v   MAGELLAN  Version 5.79  by LOGITECH INC. 10/10/97 \r",
        b"dH000H000H000H000H000H000\r",
        [b"dH0?:G?NAH00GGNG0H000H05M\r"],
    )


def spaceball() -> Recorded:
    """Spaceball 2003: a serial packet with every axis deflected."""
    period = 800
    moving = [SpaceballMotion(period, *(20 * a for a in raw[:3]), *raw[3:]) for raw in RAW]
    return _serial(
        "spaceball-2003",
        b"@1 Spaceball alive and well.\r@2 Firmware version 2.15 created.\r",
        encode_spaceball_motion(SpaceballMotion(period, 0, 0, 0, 0, 0, 0)),
        [encode_spaceball_motion(motion) for motion in moving],
    )


def spaceorb() -> Recorded:
    """SpaceOrb: a serial packet with every axis deflected."""
    return _serial(
        "spaceorb",
        encode_orb_keys(100, 0),
        encode_orb_motion(0, (0,) * 6),
        [encode_orb_motion(0, raw) for raw in RAW],
    )


def _serial(key: str, greeting: bytes, rest: bytes, packets: list[bytes]) -> Recorded:
    """Return the core of a serial device after its greeting and a report at rest."""
    core = SpaceMouseCore(SpaceMouseOptions())
    session = SerialSession(serial_model_by_key(key), 0.0)
    session.receive(greeting, 0.0)
    model = session.model
    assert model is not None

    def feed(data: bytes, now_s: float) -> None:
        for value in session.receive(data, now_s):
            core.on_value(value, now_s)

    core.on_opened(0.0, device_model(model), None, model.period_s)
    feed(rest, 0.0)
    return Recorded(core, feed, packets, model.period_s, 0.0)


def spnav() -> Recorded:
    """spacenavd: a record of its socket."""
    core = SpnavCore(SpnavOptions())
    core.on_opened(0.0)
    core.on_bytes(encode_spnav_motion((0,) * 6, 16), 0.0)
    return Recorded(core, core.on_bytes, [encode_spnav_motion(raw, 16) for raw in RAW], 0.016, 0.0)


def wiimote(extension: str = "", motion_plus: bool = False) -> Recorded:
    """Wii Remote: buttons and acceleration, with the connected extensions."""
    options = WiimoteOptions(roles="gyro" if motion_plus else "paper")
    bench = wiimote_bench.Bench(options, extension=extension, motion_plus=motion_plus)
    bench.ready()
    bench.tilt(20.0, 10.0)
    bench.press("a")
    return _recorded(bench, bench.core, "on_report", 0.01)


def jr3() -> Recorded:
    """JR3: a FORCES or a MOMENTS frame at 100 Hz; two of them make a wrench."""
    bench = jr3_bench.Bench()
    bench.live()
    bench.board.set_wrench((5.0, -3.0, 2.0, 0.3, 0.2, -0.1))
    reports: list[tuple[int, bytes]] = []
    core = bench.core
    genuine = core.on_frame

    def keep(arbitration_id: int, data: bytes, now_s: float) -> None:
        reports.append((arbitration_id, data))
        genuine(arbitration_id, data, now_s)

    core.on_frame = keep  # type: ignore[method-assign]
    bench.run(RECORD_S)
    core.on_frame = genuine  # type: ignore[method-assign]

    def feed(data: bytes, now_s: float) -> None:
        core.on_frame(int.from_bytes(data[:2], "little"), data[2:], now_s)

    packed = [number.to_bytes(2, "little") + data for number, data in reports]
    return Recorded(core, feed, packed, RECORD_S / len(packed), bench.now_s)


def pad(model: str) -> Recorded:
    """Gamepad: a frame of input events."""
    bench = evdev_bench.Bench(model)
    if bench.model.is_gamepad:
        sticks = cycle([(0.1 * i, 0.5, 0.0, -0.05 * i, 0.0, 0.0) for i in range(1, 10)])
        return _recorded(
            bench, bench.core, "on_packet", 0.008, lambda: bench.run(0.008, next(sticks))
        )
    keys = cycle([lambda: bench.press("a"), lambda: bench.release("a")])
    return _recorded(bench, bench.core, "on_packet", 0.03, lambda: next(keys)())


def leap() -> Recorded:
    """Leap Motion: a whole JSON frame with one hand."""
    core = LeapCore(LeapOptions(clutch="still"))
    core.on_opened(0.0)

    def feed(text: bytes, now_s: float) -> None:
        core.on_message(decode_service(text), now_s)

    service = SimulatedLeapService()
    service.connect(1, 6)
    service.receive(1, '{"background":true}', 0.0)
    service.receive(1, '{"focused":true}', 0.0)
    frames, now_s = [], 0.0
    while now_s < RECORD_S:
        now_s += 0.001
        if len(frames) == 20:  # An empty view precedes the hand.
            service.enter("right")
        service.advance(now_s)
        for _, text in service.outgoing():
            feed(text.encode(), now_s)
            if '"hands"' in text:
                frames.append(text.encode())
    return Recorded(core, feed, _renumbered(frames[-1]), 1.0 / 110.0, now_s)


def _renumbered(frame: bytes) -> Iterator[bytes]:
    """Repeat a frame with increasing numbers and times, which the core requires."""
    fields = json.loads(frame)
    first, timestamp_us = fields.pop("id"), fields.pop("timestamp")
    rest = json.dumps(fields, separators=(",", ":")).encode()[1:]
    for step in itertools.count(1):
        yield b'{"id":%d,"timestamp":%d,' % (first + step, timestamp_us + 9_091 * step) + rest


def _recorded(
    bench: object,
    core: DeviceCore,
    method: str,
    period_s: float,
    step: Callable[[], object] | None = None,
) -> Recorded:
    """Record the reports that reach `core` by `method` while the bench runs."""
    reports: list[bytes] = []
    genuine = getattr(core, method)

    def keep(report: bytes, now_s: float) -> None:
        reports.append(report)
        genuine(report, now_s)

    setattr(core, method, keep)
    end_s = bench.now_s + RECORD_S  # type: ignore[attr-defined]
    while bench.now_s < end_s:  # type: ignore[attr-defined]
        if step is None:
            bench.run(0.01)  # type: ignore[attr-defined]
        else:
            step()
    setattr(core, method, genuine)
    return Recorded(core, genuine, reports, period_s, bench.now_s)  # type: ignore[attr-defined]


def _again(reports: Iterable[bytes]) -> Iterator[bytes]:
    return cycle(reports) if isinstance(reports, list) else iter(reports)


def _turns(device: Recorded) -> Callable[[], object]:
    """Feed a report and read the state, in a loop, in the device's own time."""

    def run() -> Iterator[object]:
        feed, state, period_s = device.feed, device.core.state, device.period_s
        now_s = device.now_s
        for report in _again(device.reports):
            now_s += period_s
            feed(report, now_s)
            yield state(now_s)

    return run().__next__


DEVICES: dict[str, Callable[[], Recorded]] = {
    "SpaceMouse, HID": spacemouse,
    "Magellan, serial": magellan,
    "Spaceball 2003, serial": spaceball,
    "SpaceOrb 360, serial": spaceorb,
    "spacenavd's socket": spnav,
    "Wii Remote": wiimote,
    "Wii Remote, Nunchuk": lambda: wiimote("nunchuk"),
    "Wii Remote, MotionPlus": lambda: wiimote(motion_plus=True),
    "Leap Motion, JSON": leap,
    "gamepad": lambda: pad("xbox-360"),
    "keyboard": lambda: pad("keyboard"),
    "JR3, CAN frame": jr3,
}


def main() -> None:
    """Print the table."""
    devices = {name: make() for name, make in DEVICES.items()}
    turns = {name: _turns(device) for name, device in devices.items()}
    costs = median_costs(turns)
    for name, turn in turns.items():
        state = turn()
        assert isinstance(state, DeviceState)
        assert state.link is DeviceLink.LIVE, f"{name}: {state.reason}"
    print("one report and one look at the state, no I/O")
    print(f"{'device':26}{'µs':>8}{'reports/s':>12}{'of a core':>12}")
    for name, cost_s in costs.items():
        rate_hz = 1.0 / devices[name].period_s
        print(f"{name:26}{cost_s * 1e6:8.1f}{rate_hz:12.0f}{cost_s * rate_hz:12.2%}")


if __name__ == "__main__":
    main()
