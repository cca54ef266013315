"""Servers in the tests' threads tolerate pauses."""

import pytest

from cardan.gateway.servers import pause_detector

STOOD_STILL_S = pause_detector.STOOD_STILL_S


@pytest.fixture(autouse=True, scope="module")
def who_waits_for_a_processor_has_not_stood_still():
    """On a busy computer a thread may wait over a second for a processor; its server would then,
    correctly, disconnect its clients."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(pause_detector, "STOOD_STILL_S", 100.0)
        yield


@pytest.fixture
def notices_pauses(monkeypatch):
    """Detect pauses as in normal operation."""
    monkeypatch.setattr(pause_detector, "STOOD_STILL_S", STOOD_STILL_S)
