"""Loss faults of tests/test_device_faults.py applied to the serial devices: neutral in time, and
re-arming only after a neutral state. These tests produce the README's table."""

from pathlib import Path

import pytest

from cardan.drivers.spacemouse.core import SLOW_STALE_AFTER_S
from serial_bench import REST, Bench
from tests.test_device_faults import (
    HALF,
    Subject,
    cases,
    check_neutral_in_time_and_only_neutral_leads_back,
    table,
)

README = Path(__file__).parents[1] / "README.md"


class Serial(Subject):
    """Device with a packet every 33 to 60 ms. A timeout below 0.1 s would take two periods of a
    Spaceball for silence; the core's next poll detects the timeout."""

    step_s = 0.004
    within_s = SLOW_STALE_AFTER_S + step_s
    key = ""

    def __init__(self):
        super().__init__()
        self.bench = Bench(self.key)
        self.bench.live()
        self.button = next(iter(self.bench.puck.model.buttons.values()))
        genuine = self.bench.puck.reports

        def reports(now_s):
            passed = [self.passed(portion, now_s) for portion in genuine(now_s)]
            return [portion for portion in passed if portion]

        self.bench.puck.reports = reports

    def deflect(self):
        self.bench.puck.press(self.button)
        self.bench.run(0.5, HALF)

    def let_go(self):
        self.bench.puck.release(self.button)
        self.bench.run(0.5, REST)

    def unplug(self):
        self.bench.puck.unplug()
        self.bench.run(self.step_s)

    def replug(self):
        self.bench.puck.replug()


class Magellan(Serial):
    name = "Magellan, serial"
    key = "magellan"


class Spaceball2003(Serial):
    name = "Spaceball 2003, serial"
    key = "spaceball-2003"


class Spaceball3003(Serial):
    name = "Spaceball 3003, serial"
    key = "spaceball-3003"


class Spaceball4000(Serial):
    name = "Spaceball 4000 FLX, serial"
    key = "spaceball-4000"


class Spaceball5000(Serial):
    """Without a row in the README's table."""

    name = "Spaceball 5000, serial"
    key = "spaceball-5000"


class SpaceOrb(Serial):
    name = "SpaceOrb 360, serial"
    key = "spaceorb"


SUBJECTS = (Magellan, Spaceball2003, Spaceball3003, Spaceball4000, SpaceOrb)


@pytest.mark.matrix
@pytest.mark.parametrize(("kind", "fault"), cases((*SUBJECTS, Spaceball5000)))
def test_neutral_in_time_and_only_neutral_leads_back(kind, fault):
    check_neutral_in_time_and_only_neutral_leads_back(kind, fault)


@pytest.mark.matrix
def test_the_table_of_the_readme_is_current():
    assert table(SUBJECTS) in README.read_text(encoding="utf-8")
