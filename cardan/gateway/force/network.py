"""Forces for the hand published by another program on the network, one publisher at a time."""

from __future__ import annotations

from cardan.common.haptics import IDENTITY3, Matrix3, WorldMap
from cardan.gateway.force.fixtures import turned
from cardan.gateway.force.lease import LEASE_S, Lease
from cardan.gateway.force.link import MAX_FORCE_N, ForceMessage
from cardan.gateway.force.sources import ForceSource, Reading
from cardan.spatial import norm
from cardan.types import ZERO3, Frame, Pose, RobotState, Vector3


class PublishedFeedback:
    """The newest feedback of the only publisher that may give it. Time is an argument."""

    def __init__(self, max_age_s: float) -> None:
        """`max_age_s`: age limit; older feedback is ignored."""
        self._lease = Lease(max_age_s)
        self._max_age_s = max_age_s
        self.stopped = False
        """True if the newest message stopped it."""

    def give(self, publisher: int, sequence: int, asked: Vector3, now_s: float) -> str:
        """Take the feedback that `publisher` counts as `sequence`. Return why not; empty when it
        was taken, or was a duplicate."""
        largest = norm(asked)
        if not largest <= MAX_FORCE_N:
            return f"the feedback {tuple(asked)} is not finite, or above {MAX_FORCE_N:g}"
        lease = self._lease
        if publisher != lease.owner and lease.ask(publisher, now_s):
            return (
                "another publisher sends the feedback: only one at a time may, until it has been "
                f"silent for {LEASE_S:g} s"
            )
        if lease.take(publisher, ForceMessage(sequence, now_s, asked), now_s):
            self.stopped = False
        return ""

    def stop(self) -> None:
        """Render no feedback until the next one, which any publisher may give."""
        owner = self._lease.owner
        if owner is not None:
            self._lease.leave(owner)
        self.stopped = True

    @property
    def newest(self) -> ForceMessage | None:
        """The newest feedback, whatever its age."""
        return self._lease.newest

    def fresh(self, now_s: float) -> Vector3 | None:
        """Return the valid feedback; None if there is none."""
        newest = self._lease.newest
        if newest is None or now_s - newest.stamp_s > self._max_age_s:
            return None
        return newest.force

    def diagnosis(self) -> tuple[str, ...]:
        """Counts of refused and dropped feedback, in words."""
        lease, words = self._lease, []
        if lease.refused:
            words.append(f"{lease.refused} feedbacks refused: another publisher sent them")
        if lease.dropped:
            words.append(f"{lease.dropped} feedbacks dropped: they came twice, or out of order")
        return tuple(words)


class NetworkSource(ForceSource):
    """Forces of a program on the network, along the axes of the hand frame."""

    rests_at_zero = True
    shaped = True

    def __init__(self, max_age_s: float) -> None:
        self.feedback = PublishedFeedback(max_age_s)
        self._rotation: Matrix3 | None = IDENTITY3
        """Hand axes to those of the robot's base; None while clutched out."""
        self.reason = "no node has published a feedback for the hand"

    def publish(
        self, state: RobotState, tcp: Pose | None, world: WorldMap | None, now_s: float
    ) -> None:
        """Keep the hand map's rotation."""
        self._rotation = None if world is None else world.rotation

    def read(self, state: RobotState, tcp: Pose | None) -> Reading | None:
        """Return the newest force, along the base's axes; zero after a stop."""
        if self.feedback.stopped:
            self.reason = ""
            return Reading(state.stamp_s, ZERO3, Frame.BASE)
        newest = self.feedback.newest
        if newest is None:
            return None
        self.reason = ""
        force = ZERO3 if self._rotation is None else turned(self._rotation, newest.force)
        return Reading(newest.stamp_s, force, Frame.BASE)

    def diagnosis(self) -> tuple[str, ...]:
        """Reason why there is no force; refusals and drops."""
        return (*super().diagnosis(), *self.feedback.diagnosis())
