"""Fault table of whole programs: ``cardan daemon run`` and ``cardan run`` with simulated robots and
devices, each in a process of its own. A case makes one of them, or a resource that they need, fail
while an arm moves, and measures the arm's reaction."""
