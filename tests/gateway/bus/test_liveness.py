"""A session on the network, and client processes that are killed while they move the arm."""

import signal
import subprocess
import sys
import threading
from contextlib import contextmanager

import pytest

from cardan.bus.options import BusOptions
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.arm.status import Phase
from cardan.gateway.bus.options import DEFAULT_NAME
from cardan.gateway.bus.remote import network_arm
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import make_session
from cardan.protocols.ros2.cdr import codec_of
from tests.dds_network import OPTIONS
from tests.gateway.bus.asker import SERVICE, slow_twist
from tests.serving import PATIENT, free_endpoint, served as router
from tests.waiting import WITHIN_S, until

pytestmark = pytest.mark.matrix

ARM = f"/{DEFAULT_NAME}"
RESULT = "cardan_msgs/msg/CommandResult"
TWIST = "geometry_msgs/msg/Twist"
TIMEOUT_S = WITHIN_S
GONE = "the node that sent the request is gone"


class Served:
    """A session in a thread, and its messages on the network."""

    def __init__(self, endpoint, **network):
        self.endpoint = endpoint
        self.session = make_session(
            parse_config(
                {
                    "robot": {
                        "driver": "sim_arm",
                        "robot": "ur5",
                        "drive": "ideal",
                        "period_s": 0.008,
                    },
                    "arm": {"model": "ur5"},
                    "network": network or {"router": "", "listen": [endpoint]},
                    "watchdogs": PATIENT,
                },
                from_file=False,
            )
        )
        self.results, self.changed = [], threading.Condition()

    def hear(self, data, _stamp_ns):
        with self.changed:
            self.results.append(codec_of(RESULT).decode(data))
            self.changed.notify_all()

    def reported(self, outcome, source=None):
        """First result with that outcome, from that source or any."""

        def found():
            return next(
                (
                    each
                    for each in self.results
                    if each["outcome"] == outcome and source in (None, each["source"])
                ),
                None,
            )

        with self.changed:
            assert self.changed.wait_for(found, TIMEOUT_S), self.results
            return found()

    @property
    def phase(self):
        return self.session.controller.status().phase

    @property
    def rests(self):
        return self.phase in (Phase.HOLDING, Phase.DISARMED)


@contextmanager
def served(endpoint="", **network):
    here = Served(endpoint or free_endpoint(), **network)
    thread = threading.Thread(target=here.session.run)
    thread.start()
    try:
        with BusNetwork(BusOptions(router=here.endpoint), "observer") as observer:
            assert observer.wait_for_service(f"{ARM}/movv", TIMEOUT_S)
            heard = observer.subscribe(f"{ARM}/result", RESULT, here.hear)
            yield here
            heard.close()
    finally:
        here.session.stop("the test is over")
        thread.join()


@contextmanager
def asking(here, way, mode="peer", endpoint=""):
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.gateway.bus.asker", endpoint or here.endpoint, way, mode],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    with process:
        try:
            assert process.stdout.readline().startswith("asked")
            yield process
        finally:
            process.kill()


@pytest.mark.real
@pytest.mark.parametrize("way", ["topic", "service", "remote"])
def test_the_arm_brakes_when_who_asked_for_movv_is_killed(way):
    with served() as here, asking(here, way) as process:
        until(lambda: here.phase is Phase.MOVING)
        process.send_signal(signal.SIGKILL)
        until(lambda: here.rests)
        with network_arm(options=BusOptions(router=here.endpoint)) as arm:
            assert arm.status().message == GONE
        if way == "topic":
            assert here.reported("aborted")["reason"] == GONE


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_who_asks_through_a_router_is_missed_as_well(mode):
    with (
        router("net", "server", "router", "--endpoint", free_endpoint()) as endpoint,
        served(endpoint, router=endpoint) as here,
        asking(here, "remote", mode) as process,
    ):
        until(lambda: here.phase is Phase.MOVING)
        process.send_signal(signal.SIGKILL)
        until(lambda: here.rests)


@pytest.mark.real
def test_a_stopped_process_is_gone_after_its_lease():
    with served() as here, asking(here, "topic") as process:
        until(lambda: here.phase is Phase.MOVING)
        process.send_signal(signal.SIGSTOP)
        try:
            until(lambda: here.rests)
        finally:
            process.send_signal(signal.SIGCONT)


def test_the_arm_brakes_when_the_client_of_a_server_is_gone_and_the_server_stays():
    request = codec_of(f"{SERVICE}_Request").encode({"xdot": slow_twist()})
    with served() as here, BusNetwork(BusOptions(router=here.endpoint), "server") as server:
        assert server.wait_for_service(f"{ARM}/movv", TIMEOUT_S)
        client = server.part("client")
        client.call(f"{ARM}/movv", SERVICE, request, lambda _reply: None, TIMEOUT_S)
        until(lambda: here.phase is Phase.MOVING)
        client.close()
        until(lambda: here.rests)
        assert not server.lonely()


@contextmanager
def on_dds():
    """A session, and the endpoint of its DDS bridge."""
    pytest.importorskip("cyclonedds", reason='cyclonedds is not installed: "cardan[dds]"')
    endpoint, domain = free_endpoint(), str(OPTIONS.dds_domain)
    command = f"net server dds --router {endpoint} --dds-domain {domain} --services *"
    with served(endpoint) as here, router(*command.split()) as there:
        yield here, there


@pytest.mark.real
@pytest.mark.parametrize("way", ["topic", "service"])
def test_the_arm_brakes_when_a_participant_on_dds_leaves(way):
    with on_dds() as (here, there), asking(here, way, endpoint=there) as process:
        until(lambda: here.phase is Phase.MOVING)
        process.stdin.close()
        until(lambda: here.rests)
        assert process.wait(TIMEOUT_S) == 0
