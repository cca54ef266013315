"""Two sessions of one name on one network: a later one does not start, and of two simultaneous ones
only one accepts commands."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')

from cardan.bus.node import BusNode
from cardan.bus.options import BusOptions
from cardan.protocols.ros2.zenoh import SERVICE
from tests.serving import ARM_SESSION, free_endpoint
from tests.waiting import until

pytestmark = pytest.mark.matrix


EXIT_USAGE = 2
REFUSED = "and a command would go to both"
INHIBITED = "this one accepts only stops from the network"


@pytest.fixture
def meeting():
    """A node that connects the sessions, and its endpoint."""
    endpoint = free_endpoint()
    with BusNode(BusOptions(router="", listen=(endpoint,)), "meeting") as node:
        yield node, endpoint


@pytest.fixture
def begin(tmp_path, meeting):
    """Starts a session of the arm /left/arm and returns its process, which ends with the test."""
    _, endpoint = meeting
    file = tmp_path / "session.toml"
    table = ARM_SESSION.format(endpoint="tcp/127.0.0.1:0")
    file.write_text(table.replace('router = ""', f'router = "{endpoint}"'))
    run = [sys.executable, "-m", "cardan", "run", str(file), "--seconds", "120"]
    begun = []

    def begin():
        log = tmp_path / f"{len(begun)}.log"
        with log.open("w") as file:
            process = subprocess.Popen(run, stdout=subprocess.DEVNULL, stderr=file)
        process.log = log
        begun.append(process)
        return process

    yield begin
    for process in begun:
        process.kill()
        process.wait()


def arms(presence):
    """Ids of the sessions that accept the arm's commands."""
    return {each.zid for each in presence.others()}


def test_the_second_does_not_begin_and_the_first_goes_on(meeting, begin):
    presence = meeting[0].presence(SERVICE, "/left/arm/movl")
    first = begin()
    until(lambda: arms(presence), "the first")
    before = arms(presence)
    second = begin()
    assert second.wait(timeout=60.0) == EXIT_USAGE
    said = second.log.read_text()
    assert "network.name: another node on" in said
    assert "has the name /left/arm, and a command would go to both" in said
    assert first.poll() is None
    assert arms(presence) == before


def test_of_two_that_begin_at_once_one_at_most_takes_commands(meeting, begin):
    presence = meeting[0].presence(SERVICE, "/left/arm/movl")
    both = begin(), begin()
    until(
        lambda: len(arms(presence)) + sum(each.poll() is not None for each in both) == 2,
        "both, or one and the end of the other",
    )  # fmt: skip
    until(
        lambda: any(
            words in each.log.read_text() for each in both for words in (REFUSED, INHIBITED)
        ),
        "one that takes no commands",
    )
    silent = [each for each in both if each.poll() is None]
    for each in silent:
        each.terminate()
    for each in both:
        each.wait(timeout=30.0)
    said = [each.log.read_text() for each in both]
    refused = [each for each in said if REFUSED in each]
    inhibited = [each for each in said if INHIBITED in each]
    assert len(refused) + len(inhibited) in (1, 2), said
    assert any(each for each in said if "has the name /left/arm" in each)
