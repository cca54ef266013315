"""Axes and buttons from the remote's motion, by role."""

import pytest
from hypothesis import given, strategies as st

from cardan.common.options import choices, hints
from cardan_wiimote.driver.core import BUTTON_NAMES, NUNCHUK_BUTTONS
from cardan_wiimote.driver.options import WiimoteOptions
from cardan_wiimote.driver.roles import ROLES, STICK_BUTTON, RemoteMotion

REST = (0.0,) * 6
UNIT = st.floats(-1.0, 1.0)
MOTIONS = st.builds(
    RemoteMotion,
    st.frozensets(st.sampled_from([*BUTTON_NAMES, *NUNCHUK_BUTTONS])),
    UNIT,
    UNIT,
    st.tuples(*(st.floats(-20.0, 20.0),) * 3),
    st.tuples(UNIT, UNIT),
)


def test_the_options_name_them_all():
    assert set(choices(hints(WiimoteOptions)["roles"])) == set(ROLES)


@pytest.mark.parametrize("name", ROLES)
@given(motion=MOTIONS)
def test_nothing_moves_without_a_clutch(name, motion):
    roles = ROLES[name]()
    axes = roles.axes(motion)
    assert all(-1.0 <= u <= 1.0 for u in axes)
    if roles.clutch.isdisjoint(motion.buttons):
        stick = motion.stick if STICK_BUTTON in motion.buttons else (0.0, 0.0)
        assert axes == (*stick, 0.0, 0.0, 0.0, 0.0)
        assert roles.axes(motion._replace(buttons=frozenset())) == REST


@given(pressed=st.lists(st.frozensets(st.sampled_from(BUTTON_NAMES))))
def test_yaw_is_what_was_pressed_last_and_one_wins(pressed):
    roles = ROLES["paper"]()
    for buttons in pressed:
        roles.on_press(buttons)
    last = [buttons for buttons in pressed if buttons & {"one", "two"}][-1:]
    assert roles.yaw is (bool(last) and "one" not in last[0])
    roles.reset()
    assert not roles.yaw
