"""A remote wall rendered with the control law at both ends."""

from __future__ import annotations

import pytest

from studies.haptics import far
from studies.haptics.remote import Link
from studies.haptics.stability import HELD, LIGHTLY, OURS, PLAIN, judge

pytestmark = pytest.mark.matrix


@pytest.mark.parametrize("hand", [HELD, LIGHTLY], ids=lambda hand: hand.name)
@pytest.mark.parametrize("delay_s", [0.05, 0.2])
def test_ours_keeps_its_bound_where_plain_is_unstable(hand, delay_s):
    link = Link(delay_s, far.JITTER * delay_s, far.LOSS)
    assert not judge(far.run(PLAIN, hand, link, law=False), PLAIN).stable
    assert judge(far.run(OURS, hand, link, law=True), OURS).stable


@pytest.mark.parametrize("delay_s", [0.05, 0.2])
def test_a_held_stylus_feels_more_of_the_wall_than_by_the_tick_alone(delay_s):
    link = Link(delay_s, far.JITTER * delay_s, far.LOSS)
    alone, ours = (far.rendered_n_m(far.run(OURS, HELD, link, law)) for law in (False, True))
    assert ours > 0.8 * far.STIFFNESS_N_M
    assert ours > 1.3 * alone
