"""The HDAPI suite on a library with its own thread: the simulated one in real time."""

from __future__ import annotations

import pytest

from cardan.conform import Level, VerdictOutcome, registry, run
from cardan.errors import DeviceNotFoundError
from cardan_omni.peer import OmniSettings, SimulatedOmni, available

needs_library = pytest.mark.skipif(not available(), reason="the simulated libHD was not compiled")
TIMED = {"HDAPI-116", "HDAPI-117", "HDAPI-118", "HDAPI-119"}
BY_HAND = {"HDAPI-126", "HDAPI-301"}
"""Requirements that need a motion by hand, and level 3."""


@pytest.mark.matrix
@needs_library
def test_a_library_is_judged_in_real_time():
    device = SimulatedOmni(OmniSettings(virtual=False))

    def reported(words):
        device.hand(buttons=int(words.startswith("Press")), docked=words.startswith("Put"))

    suite = registry.load("hdapi")
    report, timeline = run.at(suite, str(device.path), Level.MOVE, reported, seconds=0.5)
    outcomes = {each.id: each.outcome for each in report.results}
    # Timing requirements are left out: this computer may stall at any moment.
    assert {*report.failed} <= TIMED | BY_HAND, report.as_text()
    unseen = {name for name, each in outcomes.items() if each is VerdictOutcome.NOT_SEEN}
    assert unseen <= TIMED | BY_HAND, report.as_text()
    serial = device.settings.serial.encode()
    assert any(serial in each.data for each in timeline)
    assert not any(serial in suite.redacted(each).data for each in timeline)
    assert device.truth().commanded_n == (0.0, 0.0, 0.0)


@needs_library
def test_the_force_never_exceeds_what_is_harmless():
    """For every sequence of requests, and every end of the requesting program."""
    from cardan_omni.conform.calls import FORCE, GREATEST_N, HdCalls, request
    from cardan_omni.driver.library import load

    device = SimulatedOmni(OmniSettings(virtual=True))
    calls = HdCalls(load(str(device.path)), lambda: device.now_s)
    try:
        calls.do(request("hdInitDevice", None))
        calls.do(request("hdScheduleAsynchronous"))
        calls.do(request("hdStartScheduler"))
        calls.do(request(FORCE, [[0.0, 50.0], [0.05, 1e9], [0.1, -50.0]]))
        commanded = []
        for _ in range(300):
            device.step()
            commanded.append(device.truth().commanded_n.z)
        assert max(map(abs, commanded)) == pytest.approx(GREATEST_N)
        assert commanded[-1] == 0.0
    finally:
        calls.end()
    assert device.truth().commanded_n == (0.0, 0.0, 0.0)


def test_a_library_that_is_not_there_is_an_error():
    with pytest.raises(DeviceNotFoundError, match="no such file"):
        run.at(registry.load("hdapi"), "/nowhere/libHD.so", Level.LISTEN, print)
