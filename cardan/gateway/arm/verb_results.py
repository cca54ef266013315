"""Motions that verbs start, and the verbs' results."""

from __future__ import annotations

import enum
import math
from typing import NamedTuple

from cardan.errors import MotionRefusedError
from cardan.gateway.arm.status import VERBS, AuthorityState
from cardan.gateway.arm.validation import Six
from cardan.gateway.arm.vocab import State, Stream
from cardan.gateway.servo.status import ServoStatus


class Outcome(enum.Enum):
    """State of a motion."""

    WAITING = "waiting"
    """Accepted; the previous motion is still coming to rest."""
    RUNNING = "running"
    DONE = "done"
    REFUSED = "refused"
    """Impossible from the position where the previous motion came to rest."""
    ABORTED = "aborted"


class Motion:
    """A motion that a verb started."""

    def __init__(self, verb: str, ends: bool, source: str = VERBS) -> None:
        self.verb = verb
        self.source = source
        """Source that requested it."""
        self.ends = ends
        """True for movj, relj, movl and trajectories, which `wait` waits for."""
        self.outcome = Outcome.WAITING
        self.reason = ""
        """Reason why it was aborted or refused."""
        self.note = ""
        """Changes made to the request; empty if there were none."""
        self.duration_s = math.inf
        """Planned duration; infinite for a motion without end."""
        self.error: MotionRefusedError | None = None

    @property
    def over(self) -> bool:
        """True once the motion has ended or was refused."""
        return self.outcome not in (Outcome.WAITING, Outcome.RUNNING)

    def __repr__(self) -> str:
        return f"Motion({self.verb}, {self.outcome.value}{f': {self.reason}' * bool(self.reason)})"


class Rehearsal(NamedTuple):
    """Predicted outcome of a motion."""

    refusal: str
    """Obstacle to it, and where; empty if there is none."""
    note: str
    """Changes that would be made to the request; empty if none."""
    duration_s: float
    """Duration at the speeds of the parameters; 0 if it is refused."""


class Stat(NamedTuple):
    """Pose of the TCP."""

    pose: Six
    """Measured, in the base: m, rotation vector in rad."""
    state: State
    stamp_s: float
    """Local monotonic time of the measurement."""
    joints: tuple[float, ...] = ()
    """Measured, rad or m."""
    target: Six | None = None
    """Commanded TCP pose, likewise; None before the first command."""
    twist: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Commanded twist: m/s and rad/s, base axes."""
    heard: bool = True
    """True while the robot sends states; otherwise measurements are old."""


class ControllerStatus(NamedTuple):
    """The controller's flags and numbers."""

    state: State
    stream: Stream
    """The streaming command that is chosen."""
    ready: bool
    """True when the robot would act on a command."""
    moving: bool
    braking: bool
    torque: bool
    recovering: bool
    """True after a trip, until the command is back at the arm."""
    message: str
    """Reason why a motion or a stream last ended."""
    stream_owner: str
    stream_age_s: float
    """Time since the newest streamed command, s; infinite before the first."""
    stream_late: int
    """Count of streamed commands that came late or twice."""
    stream_scaled: int
    """Count of streamed twists that were too fast and were slowed, direction kept."""
    following_error_rad: float
    following_joint: str
    trips: int
    refusals: int
    last_refusal: str
    pose: Six | None
    """Commanded TCP pose; None before the first command."""
    servo: ServoStatus
    authority: AuthorityState
