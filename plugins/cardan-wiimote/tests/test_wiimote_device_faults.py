"""The Wii Remote against every way to lose it, as tests/test_device_faults.py has all others:
neutral in time, and no way back but by a neutral state. The table of the README is of this."""

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
        rig = wiimote_bench.Bench()
        rig.ready()
        return rig

    def deflect(self):
        self.rig.tilt(30.0, 10.0)
        self.rig.press("a")
        self.rig.run(0.3)

    def let_go(self):
        self.rig.release("a")
        self.rig.run(0.3)

    def unplug(self):
        self.rig._lose("unplugged")
        self.rig.retry_s = float("inf")

    def replug(self):
        self.rig.retry_s = self.now_s


@pytest.mark.parametrize(("kind", "fault"), cases([WiiRemote]))
def test_neutral_in_time_and_only_neutral_leads_back(kind, fault):
    check_neutral_in_time_and_only_neutral_leads_back(kind, fault)


def test_the_table_of_the_readme_is_current():
    assert table([WiiRemote]) in README.read_text(encoding="utf-8")
