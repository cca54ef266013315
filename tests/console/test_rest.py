"""Detection of an arm's rest, as the tests of the page use it."""

import pytest

from tests.console.robot_and_server import PAUSE_S, _again

SAMPLE_S = 0.004


def watched(stands_from_s, moves_again_s, waits):
    """Simulate an arm that moves for 0.1 s, stands still, and moves 3 mm further. Commands arrive
    at 250 Hz, except that those within `waits` are delayed and arrive together at its end."""
    times = [SAMPLE_S * step for step in range(300)]
    away, commands = [], []
    for when in times:
        left = 0.003 if when < moves_again_s else 0.0
        away.append(left + max(0.0, 0.1 * (stands_from_s - when)))
        came = 0.0 if waits[0] <= when < waits[1] else when
        commands.append(int((came or min(when, waits[0])) / SAMPLE_S))
    return _again(times, away, commands)


def test_an_arm_that_stood_and_goes_on_is_found():
    assert watched(0.1, 0.8, (9.0, 9.0)) == pytest.approx(0.003)


def test_one_that_stood_while_its_commands_waited_did_not_rest():
    # The arm stood still only because it had not yet executed the delayed commands.
    assert watched(0.1, 0.45, (0.11, 0.42)) == 0.0


def test_a_gap_as_the_system_has_them_is_no_pause():
    assert watched(0.1, 0.8, (0.2, 0.2 + 0.5 * PAUSE_S)) == pytest.approx(0.003)
