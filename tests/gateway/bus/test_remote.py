"""Behavior particular to an arm on the network; tests/gateway/arm/test_device.py tests its
verbs."""

import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

from cardan.bus.options import BusOptions
from cardan.errors import DriverError, MotionLoopError, MotionRefusedError, OptionError
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.gateway.bus.remote import (
    network_arm,
    options_for,
    parse_address,
)
from tests.gateway.arm.reaching import OnTheBus
from tests.gateway.arm.test_device import DOWN
from tests.serving import free_endpoint
from tests.test_architecture import ARM_LIBRARIES
from tests.waiting import until

EXAMPLES = Path(__file__).parents[3] / "examples"
HERE = f"/{DEFAULT_NAME}"


@pytest.mark.parametrize(
    ("address", "endpoint", "name"),
    [
        (HERE, "", HERE),
        ("cell/arm", "", "/cell/arm"),
        ("/cell/arm", "", "/cell/arm"),
        ("tcp/192.168.1.10:7447", "tcp/192.168.1.10:7447", HERE),
        ("tcp/192.168.1.10:7447/", "tcp/192.168.1.10:7447", HERE),
        ("tls/robot.example:7447/cell/arm", "tls/robot.example:7447", "/cell/arm"),
        ("tcp/[::1]:7447/arm", "tcp/[::1]:7447", "/arm"),
    ],
)
def test_an_address_is_an_endpoint_a_name_or_both(address, endpoint, name):
    assert parse_address(address) == (endpoint, name)


@pytest.mark.parametrize("address", ["/two words", "tcp/127.0.0.1:7447/1st", "/a__b"])
def test_an_address_that_is_none_is_refused(address):
    with pytest.raises(OptionError, match=f"address: {re.escape(repr(address))}") as error:
        network_arm(address)
    assert "not a ROS name" in str(error.value)


@pytest.mark.parametrize(
    ("endpoint", "mode"),
    [
        ("tcp/127.0.0.1:7447", "peer"),
        ("tcp/localhost:7447", "peer"),
        ("tcp/[::1]:7447", "peer"),
        ("tcp/192.168.1.10:7447", "client"),
        ("tls/robot.example:7447", "client"),
    ],
)
def test_who_is_on_another_computer_is_met_as_its_client(endpoint, mode):
    assert options_for(endpoint, None) == BusOptions(router=endpoint, mode=mode)
    given = BusOptions(domain=3)
    assert options_for(endpoint, given) == BusOptions(router=endpoint, domain=3)
    assert options_for("", given) is given


def test_each_device_is_a_source_of_its_own():
    first, second = network_arm(), network_arm()
    assert first.source != second.source
    assert network_arm(source="a program, 2").source == "a program, 2"


WITHOUT_THE_ARMS_LIBRARIES = """
import sys
sys.modules.update(dict.fromkeys({without!r}))
import cardan
from cardan.gateway.arm.requests import decode_answer, result_of
reply = decode_answer(sys.stdin.buffer.read())
print(result_of("status", reply.result).servo.path_speed, cardan.network_arm.__name__)
"""


def test_it_needs_no_libraries_of_an_arms_model():
    from cardan.gateway.arm.requests import encode_reply
    from tests.gateway.arm.arms import World

    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_THE_ARMS_LIBRARIES.format(without=sorted(ARM_LIBRARIES))],
        input=encode_reply(1, World().verbs.status()),
        capture_output=True,
        check=False,
    )
    assert done.stdout.split() == [b"1.0", b"network_arm"], done.stderr.decode()


@pytest.mark.matrix
def test_two_programs_are_two_sources_and_one_that_leaves_stops_no_other():
    with OnTheBus().place() as (first, _, address), first:
        with network_arm(address) as second:
            motion = first.movv([0.0, 0.0, -0.005, 0.0, 0.0, 0.0])
            with pytest.raises(MotionRefusedError, match=f"'{first.source}' has authority"):
                second.movj(second.stat().pose)
        assert not motion.over
        assert first.status().moving


@pytest.mark.real
def test_a_connection_that_is_lost_is_no_rest():
    with OnTheBus().place() as (arm, end_loop, _), arm:
        start = arm.stat().pose
        arm.set_parameters({"cpts": 0.01})
        motion = arm.movl([*(start[:3] + DOWN), *start[3:]])
        end_loop()
        until(lambda: motion.over)
        assert motion.outcome is Outcome.ABORTED
        until(lambda: "has left the network" in arm._ended)
        with pytest.raises(MotionLoopError, match="it may still move"):
            arm.stop()


@pytest.mark.matrix
def test_an_arm_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setattr("cardan.gateway.bus.remote.MEET_TIMEOUT_S", 1.0)
    with pytest.raises(DriverError, match="no other node is on the network at tcp"):
        network_arm(free_endpoint()).open()
    with OnTheBus().place() as (arm, _, address), arm:
        absent = network_arm(f"{address}/absent")
        with pytest.raises(DriverError, match=rf"no arm /absent .* there are: {HERE}"):
            absent.open()


@pytest.mark.matrix
def test_the_example_runs(capsys, monkeypatch):
    with OnTheBus().place() as (_, _, address):
        path = EXAMPLES / "ros2" / "remote_arm.py"
        monkeypatch.setattr(sys, "argv", [path.name, address])
        runpy.run_path(str(path), run_name="__main__")
    assert "movl arrived: True" in capsys.readouterr().out
