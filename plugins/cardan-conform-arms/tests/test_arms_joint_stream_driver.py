"""Tests of joint stream clients: simulated ones with early ends, and our own over a real socket."""

from __future__ import annotations

import threading

import pytest

from cardan.conform import Level, VerdictOutcome, registry, run
from cardan.conform.run import simulated
from cardan.demos.examples import free_ports
from cardan.drivers.sim_arm import SimArm
from cardan.types import HoldCommand, JointCommand

SUITE = registry.load("joint-stream-driver")


def test_a_driver_that_has_ended_is_not_judged_by_what_comes_later():
    report, _ = simulated(SUITE, Level.BY_HAND, {"gives-up": 1.0})
    assert report.failed == ("JSPC-115",)
    found = {each.id: each for each in report.results}
    for number in (116, 117, 118, 119, 120, 121, 301):
        verdict = found[f"JSPC-{number}"]
        assert verdict.outcome is VerdictOutcome.NOT_SEEN
        assert verdict.said == "not judged: it had ended (JSPC-115)"


def test_a_driver_that_only_does_not_follow_is_judged():
    report, _ = simulated(SUITE, Level.HOLD, {"greets-once": 1.0})
    assert report.failed == ("JSPC-119", "JSPC-121")


@pytest.mark.matrix
def test_our_driver_is_judged_over_a_real_socket():
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
    reported = []
    try:
        report, _ = run.at(SUITE, f"127.0.0.1:{port}", Level.HOLD, reported.append, seconds=0.8)
    finally:
        ended.set()
        thread.join()
    assert reported == []
    found = {each.id: each.outcome.value for each in report.results}
    # Timing requirements are left out: this computer may stall at any moment.
    for number in (101, 102, 103, 104, 105, 109, 110, 111, 112, 115, 117, 118, 119):
        assert found[f"JSPC-{number}"] == "passed", report.as_text()
