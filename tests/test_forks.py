"""Forks of a process with open resources, which stay the parent's."""

import json
import os
import socket
import subprocess
import sys

import pytest

from cardan.common.sockets import hang_up
from tests.serving import free_udp_port, served

pytestmark = pytest.mark.matrix

FORKED = """
import json, os, sys, time
import cardan
from cardan.errors import CardanError

def outcome(call):
    try:
        return repr(call())
    except CardanError as error:
        return f"{type(error).__name__}: {error}"

def in_child(*calls, leave=None):
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(theirs, json.dumps([outcome(call) for call in calls]).encode())
        os.close(theirs)
        if leave is not None:
            leave()
        os._exit(0)
    os.close(theirs)
    with open(ours) as said:
        told = json.load(said)
    return told, child
"""


def forked(code, *words):
    """Return the JSON that `code` prints in a separate Python process."""
    done = subprocess.run(
        [sys.executable, "-W", "ignore::DeprecationWarning", "-c", FORKED + code, *words],
        capture_output=True,
        text=True,
        timeout=50,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return json.loads(done.stdout)


def test_the_arm_is_the_parents():
    child, own = forked("""
with cardan.CartesianDevice(cardan.SimArm(robot="ur5"), arm="ur5") as arm:
    arm.movj([0.45, 0.1, 0.4, 2.2, -2.2, 0.0])
    told, child = in_child(
        lambda: arm.movl([0.45, 0.2, 0.4, 2.2, -2.2, 0.0]),
        lambda: arm.wait(2.0),
        lambda: next(arm.robot.cycles()),
        leave=lambda: sys.exit(),
    )
    os.waitpid(child, 0)
    def arrives():  # a busy computer may stand still for so long that a motion is stopped
        arm.movj([0.45, 0.2, 0.4, 2.2, -2.2, 0.0])
        return arm.wait(20.0)
    print(json.dumps([told, [any(arrives() for _ in range(5))]]))
""")
    moved, waited, cycles = child
    assert moved.startswith("MotionLoopError: the arm is not open in this process: it was opened")
    assert waited.startswith("MotionLoopError: the arm is not open in this process: it was opened")
    assert cycles.startswith("NotOpenError: the simulated arm's driver is not open in this process")
    assert own == [True]


def test_a_remote_arm_and_its_connection_are_the_parents():
    child, own = forked("""
from cardan.gateway.arm.remote_arm import RemoteArm
asked, disconnected = [], []

def connect(arm):
    def answer(request, packet):
        asked.append(request.verb)
        arm.fail(request.id, "answered")
    arm.begin(answer)
    return lambda: disconnected.append(os.getpid())

arm = RemoteArm(connect)
arm.open()
told, child = in_child(arm.stat, arm.stop, arm.close, lambda: (asked, disconnected))
os.waitpid(child, 0)
own = outcome(arm.stat)
arm.close()
print(json.dumps([told, [own, asked, disconnected == [os.getpid()]]]))
""")
    for each in child[:2]:
        assert each.startswith("MotionLoopError: the arm is not open in this process: it was")
    assert child[2:] == ["None", "([], [])"]
    assert own == ["MotionLoopError: answered", ["stat"], True]


def test_a_device_is_the_parents(tmp_path):
    path = str(tmp_path / "hid")
    with served("sim", "spacemouse", "--hid", path, "--script", "circle"):
        child, own = forked(
            """
with cardan.open_device("spacemouse", transport="socket", path=sys.argv[1]) as mouse:
    next(state for state in mouse if state.link is cardan.DeviceLink.LIVE)
    iterated = iter(mouse)
    next(iterated)
    told, child = in_child(
        lambda: mouse.state().link.value, lambda: mouse.read(1.0), lambda: [*iterated],
        lambda: mouse.close(),
    )
    os.waitpid(child, 0)
    print(json.dumps([told, [mouse.read(5.0).link.value]]))
""",
            path,
        )
    assert child[0] == "'closed'"
    assert child[1].startswith(
        "NotOpenError: SpaceMouse is not open in this process: it was opened"
    )
    assert child[2:] == ["[]", "None"]
    assert own == ["live"]


def test_a_child_that_exits_does_not_brake_the_parents_robot():
    port = str(free_udp_port())
    with served("sim", "abb-gofa", "--to", f"127.0.0.1:{port}"):
        before, after, sent = forked(
            """
with cardan.open_robot("abb_egm", listen_port=int(sys.argv[1])) as robot:
    begun = parent = os.getpid()
    for state in robot.cycles():
        if not state.ready:
            continue
        if begun == parent:
            ours, theirs = os.pipe()
            begun = os.fork()
            if begun == 0:
                os.write(theirs, outcome(lambda: robot.send(cardan.HoldCommand())).encode())
                sys.exit()
            os.waitpid(begun, 0)
            sent, before, since = os.read(ours, 1000).decode(), state.session, state.sequence
        robot.send(cardan.HoldCommand())
        if state.sequence > since + 100:
            break
    print(json.dumps([before, state.session, sent]))
    assert robot.session.counters.final_commands == 0
""",
            port,
        )
    assert before == after
    assert sent.startswith("NotOpenError: the EGM driver is not open in this process")


def test_what_is_hung_up_is_ended_though_another_holds_it():
    ours, theirs = socket.socketpair()
    held = os.dup(ours.fileno())
    try:
        hang_up(ours)
        theirs.settimeout(5.0)
        assert theirs.recv(1) == b""
        hang_up(ours)
    finally:
        os.close(held)
        theirs.close()


def test_the_connections_of_a_ur_are_closed_though_a_child_lives():
    with socket.create_server(("127.0.0.1", 0)) as server:
        reported, held = forked(
            """
import socket
robot = cardan.UrRtde(host="127.0.0.1", rtde_port=int(sys.argv[1]))
robot.open()
cycles = robot.cycles()
while not any(not link.connecting for link in robot._links.values()):
    next(cycles)
sockets = [link.socket for link in robot._links.values()]
lives, parent = os.pipe()
told, child = in_child(
    lambda: [each.fileno() for each in sockets],
    lambda: robot.close(),
    lambda: robot.send(cardan.HoldCommand()),
    leave=lambda: (os.close(parent), os.read(lives, 1)),
)
assert all(each.fileno() >= 0 for each in sockets)
robot.close()
print(json.dumps([told, [each.fileno() for each in sockets]]))
""",
            str(server.getsockname()[1]),
        )
    assert set(json.loads(reported[0])) == {-1}
    assert reported[1] == "None"
    assert reported[2].startswith("NotOpenError: the UR driver is not open in this process: it was")
    assert set(held) == {-1}
