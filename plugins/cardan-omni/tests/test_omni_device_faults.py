"""The stylus against every way to lose it, as tests/test_device_faults.py has all others: neutral
in time, and no way back but by a neutral state. The table of the README is of this.
"""

from pathlib import Path

import pytest

import omni_bench
from cardan.types import Vector3
from tests.test_device_faults import (
    Intercepted,
    cases,
    check_neutral_in_time_and_only_neutral_leads_back,
    table,
)

pytestmark = pytest.mark.matrix

README = Path(__file__).parents[1] / "README.md"


class Omni(Intercepted):
    """Interceptor of the tick's snapshots: without a position, or with one that is not a number."""

    name = "Omni and Touch"
    method = "on_snapshot"
    step_s = omni_bench.LOOK_S

    def make(self):
        return omni_bench.Bench().live()

    def shortened(self, report):
        return report._replace(pose=None)

    def garbled(self, report):
        position = Vector3(self._rng.random(), float("nan"), float("inf"))
        return report._replace(pose=report.pose._replace(position=position))

    def deflect(self):
        self.bench.position = (0.03, 0.0, 0.05)
        self.bench.buttons = 1
        self.bench.run(0.1)

    def let_go(self):
        self.bench.position = (0.0, 0.0, 0.0)
        self.bench.buttons = 0
        self.bench.run(0.1)

    def replug(self):
        self.core.on_opened(omni_bench.TOUCH, self.now_s)


@pytest.mark.parametrize(("kind", "fault"), cases([Omni]))
def test_neutral_in_time_and_only_neutral_leads_back(kind, fault):
    check_neutral_in_time_and_only_neutral_leads_back(kind, fault)


def test_the_table_of_the_readme_is_current():
    assert table([Omni]) in README.read_text(encoding="utf-8")
