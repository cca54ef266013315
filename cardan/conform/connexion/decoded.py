"""What judges of a 3Dconnexion device look at: its reports, decoded once."""

from __future__ import annotations

from typing import NamedTuple

from cardan.conform.timeline import Kind, Timeline, Traffic
from cardan.protocols import connexion


class Report(NamedTuple):
    """An input report."""

    number: int
    time_s: float
    raw: bytes
    value: connexion.InputReport

    @property
    def is_motion(self) -> bool:
        """Whether it has axes."""
        return isinstance(
            self.value, (connexion.Translation, connexion.Rotation, connexion.MotionReport)
        )

    @property
    def counts(self) -> tuple[int, ...]:
        """Of a motion."""
        return (
            tuple(self.value)
            if isinstance(
                self.value, (connexion.Translation, connexion.Rotation, connexion.MotionReport)
            )
            else ()
        )


class ConnexionTraffic(Traffic):
    """The reports of a timeline."""

    def __init__(self, timeline: Timeline) -> None:
        super().__init__(timeline)
        self.reports: list[Report] = []
        self.lost: list[int] = []
        """Events by which the device went."""
        self.refused: list[int] = []
        self.model: connexion.Model | None = None
        """As its vendor and product id say; None where they are not known."""
        for index, event in enumerate(timeline):
            if event.kind is Kind.OPENED and ":" in event.note:
                vendor, _, product = event.note.partition(":")
                self.model = connexion.find_model(int(vendor, 16), int(product, 16))
            elif event.kind is Kind.CLOSED and not event.sent:
                self.lost.append(index)
            elif event.kind is Kind.REFUSED:
                self.refused.append(index)
            elif event.kind is Kind.DATA and not event.sent:
                value = connexion.decode_input(event.data)
                self.reports.append(Report(index, event.time_s, event.data, value))

    @property
    def motions(self) -> list[Report]:
        """Reports with axes."""
        return [each for each in self.reports if each.is_motion]

    @property
    def family(self) -> connexion.Family | None:
        """What it sends; None before any motion."""
        motions = self.motions
        if not motions:
            return None
        whole = isinstance(motions[0].value, connexion.MotionReport)
        return connexion.Family.ONE if whole else connexion.Family.SPLIT

    def during(self, *names: str) -> list[Report]:
        """The reports of these phases."""
        return self.within(self.reports, *names)
