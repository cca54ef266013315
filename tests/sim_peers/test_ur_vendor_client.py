"""UR's own RTDE client for Python, unmodified, with the simulated controller: its `record.py` and
its `example_control_loop.py`, with the configurations beside them.

It is on no package index: CARDAN_UR_RTDE_CLIENT names a checkout of
github.com/UniversalRobots/RTDE_Python_Client_Library. The control loop wants localhost:30004.
"""

from __future__ import annotations

import csv
import os
import socket
import subprocess
import sys
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest

from tests.serving import free_tcp_port, served
from tests.waiting import until

CHECKOUT = os.environ.get("CARDAN_UR_RTDE_CLIENT", "")
HOME = (0.0, -1.570796, 1.570796, -1.570796, -1.570796, 0.0)
RTDE_PORT = 30004
PROGRAM = """\
def rtde_control_loop():
  rtde_set_watchdog("input_int_register_0", 1, "stop")
  while True:
    write_output_integer_register(0, 1)
    while read_input_integer_register(0) == 0:
      sync()
    end
    local target = p[0, 0, 0, 0, 0, 0]
    local i = 0
    while i < 6:
      target[i] = read_input_float_register(i)
      i = i + 1
    end
    movej(get_inverse_kin(target), 3, 3)
    write_output_integer_register(0, 0)
    while read_input_integer_register(0) == 1:
      sync()
    end
  end
end
"""
"""Equivalent of rtde_control_loop.urp, the example's program for the pendant."""

pytestmark = [
    pytest.mark.matrix,
    pytest.mark.skipif(not CHECKOUT, reason="CARDAN_UR_RTDE_CLIENT names no checkout"),
]


def example(name, *words, **options):
    """Run an example in its folder with its own imports; return the process."""
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.Popen(
        (sys.executable, "-u", name, *words),
        cwd=Path(CHECKOUT, "examples"),
        env=environment | {"PYTHONDONTWRITEBYTECODE": "1"},
        text=True,
        **options,
    )


@pytest.mark.parametrize("robot", ["ur5e", "ur5"])
@pytest.mark.parametrize("buffered", [(), ("--buffered",)], ids=["newest", "buffered"])
def test_record_writes_what_its_configuration_names(robot, buffered, tmp_path):
    output, port = tmp_path / "robot_data.csv", str(free_tcp_port())
    ports = ("--rtde-port", port, "--primary-port", "0", "--dashboard-port", "0")
    words = ("--port", port, "--samples", "250", "--output", str(output), *buffered)
    with served("sim", "ur", "--robot", robot, "--running", *ports):
        assert example("record.py", *words).wait(30.0) == 0
    with output.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file, delimiter=" "))
    # It counts the last read, which finds no data if it does not wait.
    assert len(rows) == 250 or (buffered and len(rows) == 249)
    times = [float(row["timestamp"]) for row in rows]
    if buffered:
        assert max(b - a for a, b in pairwise(times)) == pytest.approx(0.008, abs=1e-6)
    last = rows[-1]
    assert (last["robot_mode"], last["safety_mode"], last["runtime_state"]) == ("7", "1", "1")
    assert [float(last[f"actual_q_{joint}"]) for joint in range(6)] == pytest.approx(HOME, abs=1e-5)
    assert float(last["target_moment_1"]) != 0.0


def taken(port):
    with socket.socket() as found:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind(("127.0.0.1", port))
        except OSError:
            return True
    return False


@pytest.mark.skipif(taken(RTDE_PORT), reason=f"port {RTDE_PORT}, which it wants, is taken")
def test_the_control_loop_goes_to_and_fro(tmp_path):
    said, primary = tmp_path / "said", free_tcp_port()
    ports = ("--primary-port", str(primary), "--dashboard-port", "0")
    with served("sim", "ur", "--running", *ports), said.open("w", encoding="utf-8") as out:
        loop = example("example_control_loop.py", stdout=out)
        try:
            # The program's watchdog needs this connection.
            with closing(socket.create_connection(("127.0.0.1", primary))) as pendant:
                pendant.sendall(PROGRAM.encode())
                until(lambda: said.read_text(encoding="utf-8").count("confirmed") >= 3, "moves")
            assert loop.poll() is None
        finally:
            loop.kill()
            loop.wait()
    lines = said.read_text(encoding="utf-8").splitlines()
    goals = [line for line in lines if line.startswith("New pose")]
    places = [line for line in lines if line.startswith("Move to confirmed pose")]
    assert goals[0] != goals[1]
    assert goals[0] == goals[2]
    assert places[0] != places[1]
