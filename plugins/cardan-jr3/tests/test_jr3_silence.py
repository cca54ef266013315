"""Loss faults of tests/test_device_faults.py applied to the sensor: neutral in time, and re-arming
only after a neutral state. These tests produce the README's table."""

from pathlib import Path

import pytest

import jr3_bench
from tests.test_device_faults import (
    Subject,
    cases,
    check_neutral_in_time_and_only_neutral_leads_back,
    table,
)

README = Path(__file__).parents[1] / "README.md"


class Jr3(Subject):
    name = "JR3, CAN"
    step_s = 0.001

    def __init__(self):
        super().__init__()
        self.bench = jr3_bench.Bench()
        self.bench.live()
        genuine = self.bench.core.on_frame

        def on_frame(arbitration_id, data, now_s):
            data = self.passed(data, now_s)
            if data is not None:
                genuine(arbitration_id, data, now_s)

        self.bench.core.on_frame = on_frame

    @property
    def acts(self):
        return super().acts or self.state.wrench is not None

    def deflect(self):
        self.bench.board.set_wrench((8.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        self.bench.run(0.5)

    def let_go(self):
        self.bench.board.set_wrench((0.0,) * 6)
        self.bench.run(1.0)

    def replug(self):
        self.core.on_opened(self.now_s)


SUBJECTS = (Jr3,)


@pytest.mark.parametrize(("kind", "fault"), cases(SUBJECTS))
def test_neutral_in_time_and_only_neutral_leads_back(kind, fault):
    check_neutral_in_time_and_only_neutral_leads_back(kind, fault)


def test_the_table_of_the_readme_is_current():
    assert table(SUBJECTS) in README.read_text(encoding="utf-8")
