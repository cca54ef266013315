"""Exhaustive exploration of the controller: see :mod:`tests.gateway.arm.explorer`."""

import pytest

from tests.gateway.arm import explorer
from tests.gateway.arm.explorer import BY_REST, way_to

compiled = pytest.mark.skipif(not explorer.available(), reason="the servo was not compiled")


@compiled
@pytest.mark.matrix("clutch", "rest")  # The random walks in test_hostile.py cover all mappings.
@pytest.mark.parametrize("act", explorer.MAPPINGS)
def test_every_state_near_the_start_keeps_what_is_promised(act):
    found = explorer.explore(explorer.MAPPINGS[act], deepest=2)
    assert len(found.states) > 90
    assert found.refusals > 30


@compiled
@pytest.mark.matrix
@pytest.mark.timeout(900)
@pytest.mark.parametrize("act", explorer.MAPPINGS)
def test_every_state_farther_away_keeps_what_is_promised(act):
    found = explorer.explore(explorer.MAPPINGS[act], deepest=3)
    assert len(found.states) > 500


@compiled
def test_a_copy_goes_on_to_the_same_bits_and_apart():
    world = way_to(("button_down", "deflects+", "movl", "stop", "movl"))
    assert world.verbs._pending is not None
    other = world.copy()
    before = world.q.copy()
    other.settle()
    assert (world.q == before).all()
    assert world.verbs._pending is not None
    world.settle()
    assert (world.q == other.q).all()
    assert world.abstract() == other.abstract()


@compiled
def test_letting_go_once_confirms_once():
    """Otherwise the command would follow a robot that is held elsewhere, without end."""
    world = way_to(("pushed_away", "deflects+", "rests"), BY_REST)
    for _ in range(600):
        world.tick()
    assert world.core.waits_for_rearming
    assert "then move the device and let it go" in world.core.message
