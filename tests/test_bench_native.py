"""C programs that serve as the servo's benchmark: they build, and compute the same as Cardan.

Peers in C++ take minutes to build: the benchmark itself checks that they follow the goal.
"""

import ctypes
import shutil
import socket
import subprocess

import numpy as np
import pinocchio as pin
import pytest

from bench import native
from bench.arms import kinematics
from bench.native import arm
from bench.servo_tick import DT_S, _cardan, _goal, _kernel
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.servo.compiled import CompiledServo
from tests.serving import free_udp_port

pytestmark = pytest.mark.matrix


@pytest.fixture
def build(tmp_path, monkeypatch):
    monkeypatch.setattr(native, "BUILD", tmp_path / "build")
    monkeypatch.setattr(native, "built", native.built.__wrapped__)
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")


def followed(step, arm, ticks=200):
    """Follow the benchmark's goal; return the last goal."""
    start = arm.forward(np.array(arm.arm.home))
    for tick in range(ticks):
        goal = _goal(start, tick * DT_S)
        took_s = step(goal, to_pose(goal))
        assert 1e-7 < took_s < 1.0
    return goal


def error(arm, q, goal):
    return np.abs(pin.log6(arm.forward(q).actInv(goal)).vector).max()


def test_the_kernel_is_timed_in_c(build):
    arm = kinematics("ur5")
    servo, same = _cardan(CompiledServo, "ur5", 0), _cardan(CompiledServo, "ur5", 0)
    goal = followed(_kernel(servo), arm)
    followed(lambda _, pose: same.tick(pose, ((0,) * 3, (0,) * 3), DT_S) and 1e-3, arm)
    assert servo.q == pytest.approx(same.q, abs=1e-15)
    assert error(arm, servo.q, goal) < 0.02


def test_an_echo_in_c(build):
    port = free_udp_port()
    with (
        subprocess.Popen([native.built(native.ECHO), str(port)], stdout=subprocess.PIPE) as echo,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        assert echo.stdout.readline() == b"READY\n"
        sock.settimeout(10.0)
        sock.connect(("127.0.0.1", port))
        for sent in (b"a", b"x" * 2048):
            sock.send(sent)
            assert sock.recv(4096) == sent
        echo.kill()


def test_what_is_missing_is_said(build, monkeypatch, capsys):
    monkeypatch.setattr(native, "EIGEN", "/nowhere/eigen3")
    with pytest.raises(native.NotBuiltError, match=r"Debian: liborocos-kdl-dev|libeigen3-dev"):
        native.built(native.KDL)
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(native.NotBuiltError, match="there is no no-such-compiler"):
        native.built(native.ECHO)
    assert not list(native.BUILD.iterdir())


@pytest.mark.parametrize("structure", [arm.PeerArm, arm.PeerShape, arm.PeerPair])
def test_the_structures_are_those_of_the_header(build, tmp_path, structure):
    """Offsets of the fields are those of the compiler."""
    name = structure.__name__
    fields = [field for field, *_ in structure._fields_]
    source = tmp_path / "offsets.c"
    source.write_text(
        '#include <stddef.h>\n#include <stdio.h>\n#include "peer.h"\nint main(void) {\n'
        + "".join(f'printf("%zu\\n", offsetof({name}, {field}));\n' for field in fields)
        + f'printf("%zu\\n", sizeof({name})); }}\n'
    )
    program = tmp_path / "offsets"
    subprocess.run(["cc", *native.C, *native.OURS, "-o", str(program), str(source)], check=True)
    found = subprocess.run([program], check=True, capture_output=True, text=True).stdout.split()
    mine = [getattr(structure, field).offset for field in fields]
    assert list(map(int, found)) == [*mine, ctypes.sizeof(structure)]
