"""Servers in threads of the tests are patient."""

import pytest

from cardan.gateway.servers import pause_detector

STOOD_STILL_S = pause_detector.STOOD_STILL_S


@pytest.fixture(autouse=True, scope="module")
def who_waits_for_a_processor_has_not_stood_still():
    """A thread on a computer with other work to do was seen to wait for over a second, and its
    server cuts its clients off then, as it should."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(pause_detector, "STOOD_STILL_S", 100.0)
        yield


@pytest.fixture
def notices_pauses(monkeypatch):
    """As users have it."""
    monkeypatch.setattr(pause_detector, "STOOD_STILL_S", STOOD_STILL_S)
