"""Loss faults of tests/test_device_faults.py applied to the tracker: neutral in time, and re-arming
only after a neutral state. These tests produce the README's table.
"""

from pathlib import Path

import pytest

import leap_frames
from cardan_leap.protocol import decode_service
from tests.test_device_faults import (
    Intercepted,
    cases,
    check_neutral_in_time_and_only_neutral_leads_back,
    table,
)

pytestmark = pytest.mark.matrix

README = Path(__file__).parents[1] / "README.md"


class Bench:
    """A service with a hand in view, or none."""

    def __init__(self):
        self.bench = leap_frames.engaged("grab")
        self.core = self.bench.core
        self.grab = 1.0

    @property
    def now_s(self):
        return self.bench.now_s

    def run(self, seconds):
        self.bench.frames(seconds, leap_frames.hand(grab_strength=self.grab))


class Leap(Intercepted):
    name = "Leap Motion"
    method = "on_message"
    step_s = leap_frames.PERIOD_S

    def make(self):
        return Bench()

    def passed(self, report, now_s):
        if not self.fault:
            self.good_s = now_s
            return report
        if self.fault == "short":
            return decode_service(b'{"id":7,"timestamp":1000,"hands":[{"id":1,"palmPo')
        if self.fault == "garbled":
            return decode_service(self._rng.randbytes(200))
        return None

    def deflect(self):
        self.bench.grab = 1.0
        self.bench.run(0.3)

    def let_go(self):
        self.bench.grab = 0.0
        self.bench.run(0.3)

    def replug(self):
        self.core.on_opened(self.now_s)


@pytest.mark.parametrize(("kind", "fault"), cases([Leap]))
def test_neutral_in_time_and_only_neutral_leads_back(kind, fault):
    check_neutral_in_time_and_only_neutral_leads_back(kind, fault)


def test_the_table_of_the_readme_is_current():
    assert table([Leap]) in README.read_text(encoding="utf-8")
