"""MotoROS clients: Cardan's driver in its other modes, and over real sockets."""

from __future__ import annotations

import socket
import threading

import pytest

from cardan.conform import Level, VerdictOutcome, registry, run
from cardan.conform.motoros_driver import scenario
from cardan.conform.motoros_driver.simulated import MotorosDriverSimulation
from cardan.conform.report import check_timeline
from cardan.conform.runner import Exchange
from cardan.conform.transports import TcpPorts
from cardan.demos.examples import free_ports
from cardan.drivers.motoros import Motoros, MotorosOptions
from cardan.errors import AddressError
from cardan.types import HoldCommand


def outcomes():
    suite = registry.load("motoros-driver")
    exchange = Exchange(suite.scenario(Level.BY_HAND, suite.seconds))
    MotorosDriverSimulation(exchange, {}, options=MotorosOptions(mode="stream")).run()
    report = check_timeline(suite, exchange.timeline, Level.BY_HAND, version="")
    assert report.failed == (), report.as_text()
    return {each.id: each.outcome for each in report.results}


def test_a_client_of_trajectories_meets_what_concerns_it():
    found = outcomes()
    velocity = [each for name, each in found.items() if name.startswith("MOTOPC-14")]
    assert len(velocity) == 8
    assert set(velocity) == {VerdictOutcome.NOT_APPLICABLE}
    assert found["MOTOPC-126"] is VerdictOutcome.PASSED
    assert found["MOTOPC-301"] is VerdictOutcome.PASSED


@pytest.mark.matrix
def test_our_driver_is_judged_over_real_sockets(monkeypatch):
    velocity = scenario.FIRMWARE[0]
    monkeypatch.setattr(scenario, "FIRMWARE", (velocity._replace(befalls=("estop", "cut")),))
    base = free_ports(3)
    ports = {"motion_port": base, "state_port": base + 1, "io_port": base + 2}
    driver = Motoros(host="127.0.0.1", **ports)
    ended = threading.Event()

    def reported(instruction):
        if "start motion" in instruction:
            driver.enable()

    def drive():
        with driver:
            for _ in driver.cycles():
                driver.send(HoldCommand())
                if ended.is_set():
                    break

    thread = threading.Thread(target=drive)
    thread.start()
    try:
        suite = registry.load("motoros-driver")
        report, timeline = run.at(suite, f"127.0.0.1:{base}", Level.HOLD, reported, seconds=0.6)
    finally:
        ended.set()
        thread.join()
    found = {each.id: each.outcome.value for each in report.results}
    # Requirements on timing are left out: this computer may stand still at any moment.
    for number in (101, 102, 105, 106, 107, 108, 109, 111, 140, 141, 143, 145, 156, 160):
        assert found[f"MOTOPC-{number}"] == "passed", report.as_text()
    from cardan.conform.attachments import pcap

    assert pcap(suite, timeline, 0)


def test_a_port_that_is_taken_is_an_error():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(AddressError, match=rf"cannot listen on 127\.0\.0\.1:{port}"):
            TcpPorts("", {"motion": port}, {"motion"}, "127.0.0.1").open("motion")
