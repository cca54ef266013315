"""Python calls of a session's tick: most of its cost, and the steps for a reader."""

import pytest

from bench.session_tick import TABLES, _calls, _Session
from cardan.gateway.servo.compiled import CompiledServo

MOST = 30


@pytest.mark.parametrize("moves", [True, False])
@pytest.mark.parametrize("name", TABLES)
def test_a_tick_makes_few_calls(name, moves):
    session = _Session(TABLES[name], moves)
    servo = getattr(session.controller.commanded, "servo", None)
    if servo is not None and not isinstance(servo, CompiledServo):
        pytest.skip("the servo's kernel is not compiled")
    for _ in range(200):
        session.tick()
    assert 0 < _calls(session) <= MOST
