"""The console's benchmark and hold table: contents, and places in the docs."""

import pytest

pytest.importorskip("zenoh", reason='eclipse-zenoh is not installed: "cardan[network]"')
pytest.importorskip("pinocchio", reason="pin is not installed: pip install cardan[arm]")

from bench import console, pages
from bench.console import finger, viewers
from bench.network.clients import Load
from tests.console import hold_table, robot_and_server
from tests.docs_tables import replaced

pytestmark = pytest.mark.matrix


def test_each_part_has_its_place_in_the_page():
    page = console.PAGE.read_text(encoding="utf-8")
    for name in console.PARTS:
        page = pages.replaced(page, f"console {name}", "measured")
    assert page.count("\n\nmeasured\n\n") == len(console.PARTS)


@pytest.mark.parametrize(("slowest_s", "verdict"), [(0.039, "met"), (0.041, "missed")])
def test_a_finger_is_judged_by_its_slowest_presses_too(slowest_s, verdict):
    found = {"alone": finger.Delays([0.01] * 95 + [slowest_s] * 5, 1, 2e-4)}
    table = finger.table(found)
    assert f"| alone | 100 | 10.0 ms | {1e3 * slowest_s:.1f} ms |" in table
    assert f"median 15 ms and p99 40 ms: {verdict}" in table


@pytest.mark.parametrize(("loud_s", "verdict"), [(1.09e-3, "met"), (1.2e-3, "missed")])
def test_viewers_are_judged_by_what_the_session_notices(loud_s, verdict):
    load = Load(20, False, 0.05, 1.0, [0.003], [1e-3] * 9, [loud_s] * 9, 0)
    assert f"Aim: at most 1.1 times: {verdict}" in viewers.table(load)


def test_the_hold_table_has_its_place_and_marks_what_is_late():
    page = hold_table.PAGE.read_text(encoding="utf-8")
    fast, late = list(hold_table.ENDS)[:2]
    stops = {
        fast: [robot_and_server.Stop(0.1, 0.2, 0.012, 0.0)] * 3,
        late: [
            robot_and_server.Stop(0.1, 0.2, 0.012, 0.0),
            robot_and_server.Stop(0.1, 0.9, 0.09, 0.0),
        ],
    }
    page = replaced(page, hold_table.BEGIN, hold_table.table(stops))
    assert f"| {fast} | 200 (200) | 12.0 (12.0) |" in page
    assert f"| {late} | **550 (900)** | **51.0 (90.0)** |" in page


def test_an_arm_that_moves_again_is_seen():
    times = [0.01 * step for step in range(200)]

    def moved(path):
        return robot_and_server._again(
            times, [abs(path[-1] - each) for each in path], [*range(200)]
        )

    stopping = [min(0.01, 0.1 * when) for when in times]
    assert moved(stopping) < 1e-9
    again = [
        each + (0.005 if when > 1.0 else 0.0) for when, each in zip(times, stopping, strict=True)
    ]
    assert moved(again) == pytest.approx(0.005)
    held_up = [min(step, 12) + max(0, step - 100) for step in range(200)]
    away = [abs(again[-1] - each) for each in again]
    assert robot_and_server._again(times, away, held_up) < 1e-9, (
        "no command while the loop was held up"
    )
