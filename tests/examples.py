"""How many examples a property is tried with."""

from hypothesis import settings

# How fast an example runs says how busy the machine is; what CI chooses otherwise stays.
settings.register_profile("cardan", settings(deadline=None))
settings.register_profile("change", settings(deadline=None, max_examples=25))
"""Of make test: a quarter of what make test-matrix tries under the oldest and the newest Python."""


def examples(number: int) -> int:
    """`number`, or as much less as the profile wants."""
    return number * settings.default.max_examples // settings.get_profile("cardan").max_examples
