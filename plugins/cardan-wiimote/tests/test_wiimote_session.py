"""Requests and answers while other programs use the remote, too, and late reports."""

import pytest

from cardan.types import DeviceLink
from cardan_wiimote.driver import Identity, WiimoteOptions
from cardan_wiimote.driver.session import LOOK_AGAIN_S, STATUS_PERIOD_S
from cardan_wiimote.peer.bus import MotionPlus
from cardan_wiimote.protocol import ReadMemory, StatusRequest, WriteMemory, decode_output
from wiimote_bench import REST, Bench

KERNELS_PROBE = [
    "1500", "120030", "1110", "1604a400f00155", "1604a400fb0100", "1604a600f00155",
    "1604a600fb0100", "1704a600fa0006", "1704a400fa0006", "1500", "1500", "120030",
]  # fmt: skip
KERNELS_LOOK = ["1704a400fa0006", "1604a600f00155", "1604a600fb0100", "1704a600fa0006"]
"""Reports of hid-wiimote when it finds a remote, and every 4.1 s afterwards."""


def by_the_kernel(bench, reports):
    for report in reports:
        payload = bytes.fromhex(report)
        size = {0x16: 22, 0x17: 7}.get(payload[0], len(payload))
        bench.remote.output(payload.ljust(size, b"\0"), bench.now_s)
        bench.run(0.03)


@pytest.mark.parametrize("extension", ["", "nunchuk"])
@pytest.mark.parametrize("motion_plus", [False, True])
def test_beside_the_kernels_driver(extension, motion_plus):
    options = WiimoteOptions(dead_zone=0.0, motion_plus="on" if motion_plus else "off")
    bench = Bench(
        options,
        identity=Identity(kernel_driver=True),
        extension=extension,
        motion_plus=motion_plus,
    )
    bench.run(0.01)
    by_the_kernel(bench, KERNELS_PROBE)
    bench.until(lambda b: b.state.link is DeviceLink.LIVE, 8.0)
    for _ in range(3):
        by_the_kernel(bench, KERNELS_LOOK)
        bench.until(lambda b: b.state.link is DeviceLink.LIVE, 8.0)
        bench.press("a")
        assert bench.state.axes[2] == 1.0
        bench.release("a")
    assert bench.opened == 1
    words = " ".join(bench.diagnosis())
    assert "hid-wiimote" in words
    assert "answers to another program's requests" in words


def sent_since(bench, number, kind):
    values = [decode_output(report) for _, report in bench.sent[number:]]
    return [value for value in values if isinstance(value, kind)]


def test_a_motion_plus_that_comes_late_is_found():
    bench = Bench(WiimoteOptions(roles="gyro", dead_zone=0.0))
    assert bench.run(1.0).link is DeviceLink.NEEDS_NEUTRAL
    bench.remote.port.motion_plus = MotionPlus(built_in=False)
    bench.until(lambda b: b.state.link is DeviceLink.LIVE, LOOK_AGAIN_S + 1.0)
    bench.press("b")
    bench.remote.set_attitude(0.0, 0.0, 0.0, (1.0, 0.0, 0.0))
    assert bench.run(0.1).axes[3] == pytest.approx(1.0 / 3.0, abs=0.01)


def test_it_is_looked_for_seldom_and_never_while_driving():
    bench = Bench(WiimoteOptions(motion_plus="on", dead_zone=0.0))
    bench.ready()
    before = len(bench.sent)
    bench.run(10 * LOOK_AGAIN_S)
    assert 8 <= len(sent_since(bench, before, ReadMemory)) <= 11
    bench.press("a")
    before = len(bench.sent)
    bench.run(5 * LOOK_AGAIN_S)
    assert sent_since(bench, before, (ReadMemory, StatusRequest, WriteMemory)) == []
    assert bench.state.axes[2] == 1.0


def test_status_is_asked_for_once_a_minute():
    bench = Bench()
    bench.ready()
    before = len(bench.sent)
    bench.run(3.5 * STATUS_PERIOD_S)
    assert len(sent_since(bench, before, StatusRequest)) == 3
    assert bench.state.link is DeviceLink.LIVE


def test_an_extension_that_is_of_no_use_is_named():
    bench = Bench(extension="nunchuk")
    bench.remote.port.nunchuk.memory[0xFA:] = bytes.fromhex("0000a4200101")
    assert bench.ready().axes == REST
    assert any("classic" in words for words in bench.diagnosis())
    assert bench.remote.mode == 0x31


def test_an_extension_that_does_not_answer_is_tried_again():
    bench = Bench(extension="nunchuk")
    port = bench.remote.port
    port.device = lambda address, real=port.device: None if address == 0x52 else real(address)
    type(port).connected, retained = property(lambda self: True), type(port).connected
    try:
        bench.ready(5.0)
        assert any("does not answer" in words for words in bench.diagnosis())
        del port.device
        bench.until(lambda b: "stick_x" in b.metrics(), LOOK_AGAIN_S + 1.0)
    finally:
        type(port).connected = retained
    assert bench.run(0.5).link is DeviceLink.LIVE


def test_a_silent_remote_is_reported_its_mode_seldom():
    bench = Bench(WiimoteOptions(reconnect_after_s=60.0))
    bench.ready()
    bench.remote.leave(bench.now_s)
    bench.remote._given_up_s = float("inf")
    before = len(bench.sent)
    assert bench.run(30.0).link is DeviceLink.STALE
    assert len(bench.sent) - before <= 10 + 2 * 30
    bench.remote.come_back(bench.now_s)
    assert bench.run(1.0).link is DeviceLink.LIVE
    assert bench.opened == 1


def test_slow_memory_delays_the_start_and_nothing_else():
    bench = Bench(extension="nunchuk", faults={"slow-memory": 0.5})
    bench.ready(5.0)
    assert bench.now_s > 2.0
    assert bench.metrics()["timeouts"] == 0
    assert bench.opened == 1
