"""How many examples a property is tried with, and which arms where each takes long."""

from hypothesis import settings

from cardan.robots import arm_names

# How fast an example runs says how busy the machine is; what CI chooses otherwise stays.
settings.register_profile("cardan", settings(deadline=None))
settings.register_profile("change", settings(deadline=None, max_examples=15))
"""Of make test: a seventh of what make test-matrix tries under the oldest and the newest Python."""


def examples(number: int) -> int:
    """`number`, or as much less as the profile wants: one at least."""
    wanted = settings.default.max_examples
    return max(1, number * wanted // settings.get_profile("cardan").max_examples)


ARMS_NOW = ("ur5", "pr2_left_arm", "panda", "so101")
"""Of six joints, with endless ones, of seven, and of five."""
ARMS_LATER = tuple(name for name in arm_names() if name not in ARMS_NOW)
"""In the matrix only."""
