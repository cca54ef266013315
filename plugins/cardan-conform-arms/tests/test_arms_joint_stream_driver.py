"""A client of the joint stream over a real socket."""

from __future__ import annotations

import threading

import pytest

from cardan.conform import Level, registry, run
from cardan.demos.examples import free_ports
from cardan.drivers.sim_arm import SimArm
from cardan.types import HoldCommand, JointCommand


@pytest.mark.matrix
def test_our_driver_is_judged_over_a_real_socket():
    suite = registry.load("joint-stream-driver")
    port = free_ports()
    driver = SimArm(transport="udp", endpoint=f"127.0.0.1:{port}", period_s=0.008)
    ended = threading.Event()

    def drive():
        with driver:
            for state in driver.cycles():
                still = JointCommand(state.joints, (0.0,) * len(state.joints))
                driver.send(HoldCommand() if state.hold_reason else still)
                if ended.is_set():
                    break

    thread = threading.Thread(target=drive)
    thread.start()
    told = []
    try:
        report, _ = run.at(suite, f"127.0.0.1:{port}", Level.HOLD, told.append, seconds=0.8)
    finally:
        ended.set()
        thread.join()
    assert told == []
    found = {each.id: each.outcome.value for each in report.results}
    # Not those of times: this computer may stand still at any moment.
    for number in (101, 102, 103, 104, 105, 109, 110, 111, 112, 115, 117, 118, 119):
        assert found[f"JSPC-{number}"] == "passed", report.as_text()
