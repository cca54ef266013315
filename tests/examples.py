"""Numbers of examples of property tests, and the arms of tests that take long for each arm."""

from hypothesis import settings

from cardan.robots import arm_names

# Deadlines would depend on the load of the computer; CI's other settings are kept.
settings.register_profile("cardan", settings(deadline=None))
settings.register_profile("change", settings(deadline=None, max_examples=15))
"""Profile of `make test`: a seventh of the examples of `make test-matrix`."""


def examples(number: int) -> int:
    """Scale a number of examples to the profile, to at least 1."""
    wanted = settings.default.max_examples
    return max(1, number * wanted // settings.get_profile("cardan").max_examples)


ARMS_NOW = ("ur5", "pr2_left_arm", "panda", "so101")
"""Arms tested with every change: six joints, continuous joints, seven joints, five joints."""
ARMS_LATER = tuple(name for name in arm_names() if name not in ARMS_NOW)
"""Arms tested in the matrix only."""
