"""The fault table of whole programs: ``cardan daemon run`` and ``cardan run`` with simulated robots
and devices, each a process of its own, and what a moving arm does when one of them, or something
that they stand on, fails."""
