"""urx, unmodified, with the simulated controller: it reads the secondary interface and sends lines.

Its ports are fixed, so that the controller has a separate address on loopback. It decodes states of
software up to 3.4: later ones have a size that it does not know. Its linear and Cartesian moves
always fail, because they need a version of math3d that pip does not install.
"""

from __future__ import annotations

import importlib
import sys
import time

import pytest

from tests.serving import served
from tests.sim_peers.test_ur_public_client import own_address
from tests.waiting import until

pytestmark = [
    pytest.mark.matrix,
    pytest.mark.filterwarnings("ignore"),
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux has all of 127.0.0.0/8"),
]

HOME = [0.0, -1.570796, 1.570796, -1.570796, -1.570796, 0.0]


@pytest.fixture
def robot():
    urx = importlib.import_module("urx")
    address = own_address(4)
    words = ("--robot", "ur5", "--software", "3.4", "--running")
    with served("sim", "ur", "--host", address, *words):
        robot = urx.Robot(address)
        yield robot
        robot.close()


@pytest.mark.real
def test_it_reads_joints_and_moves_them(robot):
    assert robot.getj() == pytest.approx(HOME, abs=1e-4)
    robot.movej([0.2, *HOME[1:]], acc=1.0, vel=0.8)
    assert robot.getj() == pytest.approx([0.2, *HOME[1:]], abs=2e-3)


def test_it_moves_at_speeds_and_stops(robot):
    robot.movej([0.1, 0, 0, 0, 0, 0], acc=1.0, vel=0.8, relative=True)
    assert robot.getj() == pytest.approx([0.1, *HOME[1:]], abs=2e-3)
    robot.speedj([0.2, 0, 0, 0, 0, 0], 1.0, 10.0)
    until(lambda: robot.getj()[0] > 0.15, "what it moves")
    robot.stopj(2.0)
    joints = robot.secmon.get_all_data
    until(lambda: abs(joints()["JointData"]["qd_actual0"]) < 1e-9, "the stop")
    stopped = robot.getj()
    time.sleep(0.3)
    assert robot.getj() == pytest.approx(stopped, abs=1e-4)


def test_it_sends_programs_and_switches_outputs(robot):
    robot.send_program("def hello():\n  set_digital_out(3, True)\n  sleep(0.3)\nend\n")
    until(lambda: robot.get_digital_out(3), "what the program switches")
    for value in (True, False):
        robot.set_digital_out(2, value)
        until(lambda value=value: robot.get_digital_out(2) == value, "the output")
    assert robot.get_digital_in(0) == 0
    assert robot.is_running()
