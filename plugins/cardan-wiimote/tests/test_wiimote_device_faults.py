"""Loss faults of tests/test_device_faults.py applied to the Wii Remote: neutral in time, and
re-arming only after a neutral state. These tests produce the README's table."""

from pathlib import Path

import pytest

import wiimote_bench
from tests.test_device_faults import (
    Intercepted,
    cases,
    check_neutral_in_time_and_only_neutral_leads_back,
    table,
)

pytestmark = pytest.mark.matrix

README = Path(__file__).parents[1] / "README.md"


class WiiRemote(Intercepted):
    name = "Wii Remote"

    def make(self):
        bench = wiimote_bench.Bench()
        bench.ready()
        return bench

    def deflect(self):
        self.bench.tilt(30.0, 10.0)
        self.bench.press("a")
        self.bench.run(0.3)

    def let_go(self):
        self.bench.release("a")
        self.bench.run(0.3)

    def unplug(self):
        self.bench._lose("unplugged")
        self.bench.retry_s = float("inf")

    def replug(self):
        self.bench.retry_s = self.now_s


@pytest.mark.parametrize(("kind", "fault"), cases([WiiRemote]))
def test_neutral_in_time_and_only_neutral_leads_back(kind, fault):
    check_neutral_in_time_and_only_neutral_leads_back(kind, fault)


def test_the_table_of_the_readme_is_current():
    assert table([WiiRemote]) in README.read_text(encoding="utf-8")
