"""Sessions on one computer start the router that connects them, which lasts as long as they do."""

import threading
from contextlib import contextmanager

import pytest

from cardan.bus.options import BusOptions
from cardan.bus.router import is_served, router_address
from cardan.bus.zenoh_network import BusNetwork
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.snapshot import Snapshot
from cardan.gateway.session.supervisor import SessionProcess
from tests.serving import free_endpoint
from tests.waiting import WITHIN_S

pytestmark = pytest.mark.matrix

TIMEOUT_S = WITHIN_S


@contextmanager
def running(endpoint, name):
    table = {
        "robot": {"driver": "sim_arm", "robot": "ur5", "drive": "ideal"},
        "arm": {"model": "ur5"},
        "network": {"router": endpoint, "name": name},
    }
    process = SessionProcess(parse_config(table))
    thread = threading.Thread(target=process.follow, args=(Snapshot.from_bytes,))
    thread.start()
    try:
        yield process
    finally:
        process.stop()
        thread.join()


def meets(endpoint, name):
    with BusNetwork(BusOptions(router=endpoint), "observer") as observer:
        return observer.wait_for_service(f"/{name}/stop", TIMEOUT_S)


@pytest.mark.real
def test_a_session_is_met_by_the_router_that_it_brings_while_it_runs():
    endpoint = free_endpoint()
    address = router_address(BusOptions(router=endpoint))
    with running(endpoint, "left"):
        assert meets(endpoint, "left")
        assert is_served(address)
    assert not is_served(address)


def test_the_second_session_keeps_a_router_when_the_first_takes_its_own_away():
    endpoint = free_endpoint()
    with running(endpoint, "left"):
        assert meets(endpoint, "left")
        right = running(endpoint, "right")
        right.__enter__()
    try:
        assert meets(endpoint, "right")
    finally:
        right.__exit__(None, None, None)
    assert not is_served(router_address(BusOptions(router=endpoint)))
