"""Counters of an EGM session."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


@dataclass(slots=True)
class EgmCounters:
    """Counts of events since the driver was opened."""

    accepted: int = 0
    answers: int = 0
    final_commands: int = 0
    """Final messages, to a controller or to its previous port; they are no answers."""
    superseded: int = 0
    """Accepted, but replaced by a newer one before it could be answered."""
    lost: int = 0
    """Gaps in the controller's sequence numbers."""
    duplicates: int = 0
    old: int = 0
    foreign: int = 0
    """Datagrams from another address than the controller's."""
    malformed: Counter[str] = field(default_factory=Counter)
    """Malformed datagrams, by kind."""
    late_commands: int = 0
    """Pauses between answers above the command timeout."""
    driver_holds: int = 0
    """Datagrams answered with a hold because the application gave no command."""
    send_errors: int = 0
    ended_by_convergence: int = 0
    """Runs that ended while the robot stood in its convergence window."""
