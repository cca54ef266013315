"""Whether an operator device may move the arm: its states, and re-arming."""

from __future__ import annotations

import enum


class Arming(enum.Enum):
    """Whether the operator device may move the arm without re-arming."""

    DISARMED = "disarmed"
    """It has to be at rest first; with a clutch, that has to be pressed."""
    DEFLECTED = "deflected"
    """Where no button is configured: it is deflected while something bars it, so that letting it
    go re-arms."""
    RELEASED = "released"
    """It was seen at rest with its dead-man released: pressing that re-arms."""
    ARMED = "armed"
    """It may."""
    CLAIMING = "claiming"
    """And it moves the arm, or claims it by a button that is held."""

    def __init__(self, value: str) -> None:
        self.claims = value == "claiming"
        self.armed = self.claims or value == "armed"


def armed_by_deadman(
    arming: Arming, held: bool, at_rest: bool, inhibited: bool
) -> tuple[Arming, bool]:
    """Return the arming of a disarmed device with a dead-man, and whether its act was made: the
    dead-man released with the device `at_rest`, and pressed then."""
    released = arming is Arming.RELEASED
    match held, released:
        case False, _:
            return (Arming.RELEASED if released or at_rest else Arming.DISARMED), False
        case True, True:
            return (Arming.DISARMED if inhibited else Arming.ARMED), True
    return Arming.DISARMED, False


def armed_by_rest(arming: Arming, at_rest: bool, inhibited: bool) -> tuple[Arming, bool]:
    """Return the arming of a disarmed device without a button, and whether its act was made: to be
    `at_rest`, and while it is inhibited, to be let go once. To stay at rest is no further act."""
    match at_rest, inhibited:
        case True, True:
            return Arming.DISARMED, arming is Arming.DEFLECTED
        case True, False:
            return Arming.ARMED, True
        case False, True:
            return Arming.DEFLECTED, False
    return Arming.DISARMED, False
