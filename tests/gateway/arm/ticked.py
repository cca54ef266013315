"""An arm in virtual time for a program that acts a few dozen times a second."""

from cardan.gateway.arm.interface import CartesianArm

FRAME = 8
"""Cycles of the robot between two actions, which makes 31 actions a second."""


class Ticked(CartesianArm):
    """The verbs of a world whose control loop runs only between actions."""

    def __init__(self, world):
        self.world = world

    def open(self):
        raise NotImplementedError

    def close(self):
        raise NotImplementedError

    def _ask(self, verb, value=None, *, source="", sequence=None):
        verbs = self.world.verbs
        if verb in ("twist", "pose"):
            return verbs.stream(verb, value, owner="learning")
        if verb == "set_parameters":
            return verbs.set_parameters(value, source="learning")
        arguments = () if value is None else (value,)
        named = {"source": "learning"} if verb == "act" else {}
        return getattr(verbs, verb)(*arguments, **named)
