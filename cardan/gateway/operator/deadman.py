"""Arming of an operator device: its states, and re-arming."""

from __future__ import annotations

import enum


class Arming(enum.Enum):
    """Permission of the operator device to move the arm without re-arming."""

    DISARMED = "disarmed"
    """The device must be at rest first; with a clutch, that must be pressed."""
    DEFLECTED = "deflected"
    """No button is configured, and the device is deflected while inhibited: releasing it
    re-arms."""
    RELEASED = "released"
    """The device was at rest with its dead-man released: pressing that re-arms."""
    ARMED = "armed"
    """The device may move the arm."""
    CLAIMING = "claiming"
    """The device moves the arm, or claims it by a button that is held."""

    def __init__(self, value: str) -> None:
        self.claims = value == "claiming"
        self.armed = self.claims or value == "armed"


def armed_by_deadman(
    arming: Arming, held: bool, at_rest: bool, inhibited: bool
) -> tuple[Arming, bool]:
    """Return the arming of a disarmed device with a dead-man, and whether it was re-armed: the
    dead-man released with the device `at_rest`, and pressed then."""
    released = arming is Arming.RELEASED
    match held, released:
        case False, _:
            return (Arming.RELEASED if released or at_rest else Arming.DISARMED), False
        case True, True:
            return (Arming.DISARMED if inhibited else Arming.ARMED), True
    return Arming.DISARMED, False


def armed_by_rest(arming: Arming, at_rest: bool, inhibited: bool) -> tuple[Arming, bool]:
    """Return the arming of a disarmed device without a button, and whether it was re-armed: it came
    to rest, and, if it is inhibited, was released once. Staying at rest does not re-arm again."""
    match at_rest, inhibited:
        case True, True:
            return Arming.DISARMED, arming is Arming.DEFLECTED
        case True, False:
            return Arming.ARMED, True
        case False, True:
            return Arming.DEFLECTED, False
    return Arming.DISARMED, False
