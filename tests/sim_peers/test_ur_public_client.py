"""SDU's ur_rtde, unmodified, with the simulated controller: reads, writes, and dashboard requests.

Its port is fixed, so that each controller has a separate address on loopback. The controller is
another process, because the library blocks Python while it waits.
"""

from __future__ import annotations

import importlib
import os
import platform
import sys

import pytest

from tests.serving import free_tcp_port, served
from tests.waiting import until

pytestmark = [
    pytest.mark.matrix,
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8"),
]

# Same condition as in pyproject.toml.
if sys.version_info >= (3, 13) or platform.machine() != "x86_64":
    pytest.skip("ur_rtde has no wheel for this Python", allow_module_level=True)

rtde_receive = importlib.import_module("rtde_receive")
rtde_io = importlib.import_module("rtde_io")
dashboard_client = importlib.import_module("dashboard_client")

HOME = (0.0, -1.570796, 1.570796, -1.570796, -1.570796, 0.0)
RTDE_PORT = 30004


def own_address(number):
    """Return an address on loopback that only this process uses."""
    pid = os.getpid()
    return f"127.{100 + number}.{pid >> 8 & 0xFF}.{pid & 0xFF or 1}"


@pytest.fixture(params=["ur5e", "ur5"])
def host(request):
    address = own_address(("ur5e", "ur5").index(request.param))
    words = ("--robot", request.param, "--running", "--primary-port", str(free_tcp_port()))
    with served("sim", "ur", "--host", address, *words) as endpoint:
        assert endpoint == f"{address}:{RTDE_PORT}"
        yield request.param, address


@pytest.mark.real
def test_it_reads_writes_and_asks(host):
    robot, address = host
    receive = rtde_receive.RTDEReceiveInterface(address)
    try:
        assert receive.getActualQ() == pytest.approx(HOME, abs=1e-5)
        height = 0.4879 if robot == "ur5e" else 0.431859
        assert receive.getActualTCPPose()[2] == pytest.approx(height, abs=1e-5)
        assert (receive.getRobotMode(), receive.getSafetyMode()) == (7, 1)
        before = receive.getTimestamp()
        until(lambda: receive.getTimestamp() > before + 0.1, "newer states")

        write = rtde_io.RTDEIOInterface(address)
        assert write.setSpeedSlider(0.5)
        assert write.setStandardDigitalOut(3, True)
        assert write.setAnalogOutputVoltage(0, 0.25)
        until(lambda: receive.getTargetSpeedFraction() == 0.5, "the slider")
        until(lambda: receive.getActualDigitalOutputBits() == 8, "the output")
        until(lambda: receive.getStandardAnalogOutput0() == 2.5, "the analog output, V")
        write.disconnect()

        board = dashboard_client.DashboardClient(address)
        board.connect()
        assert board.robotmode() == "Robotmode: RUNNING"
        assert board.safetymode() == "Safetymode: NORMAL"
        assert not board.running()
        assert board.polyscopeVersion().startswith("5.12" if robot == "ur5e" else "3.15")
        if robot == "ur5e":
            assert board.isInRemoteControl()
        board.powerOff()
        until(lambda: receive.getRobotMode() == 3, "power off")
        board.powerOn()
        until(lambda: receive.getRobotMode() == 5, "power on")
        board.brakeRelease()
        until(lambda: receive.getRobotMode() == 7, "released brakes")
        board.disconnect()
    finally:
        receive.disconnect()
