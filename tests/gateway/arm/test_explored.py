"""The controller explored, not sampled: see :mod:`tests.gateway.arm.explorer`."""

import pytest

from tests.gateway.arm import explorer

compiled = pytest.mark.skipif(not explorer.available(), reason="the servo was not compiled")


@compiled
@pytest.mark.parametrize("mapping", explorer.MAPPINGS)
def test_near_the_start_every_state_keeps_what_is_promised(mapping):
    explorer.explore(explorer.MAPPINGS[mapping], most_faults=2, deepest=2)
