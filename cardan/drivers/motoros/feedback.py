"""Receiver of the status and feedback that the state port publishes every 25 ms."""

from __future__ import annotations

import math
from collections import Counter

from cardan.common.bounds import JOINT_POSITION, JOINT_VELOCITY
from cardan.drivers.motoros.options import MotorosOptions
from cardan.drivers.robot_core import outside
from cardan.protocols.simple_message.codec import WireFormat, detect_wire, wire
from cardan.protocols.simple_message.codes import MessageType, ValidFields, name_of
from cardan.protocols.simple_message.framing import (
    LONGEST_PREFIX_OF_MOTOROS,
    ByteOrder,
    FrameReader,
)
from cardan.protocols.simple_message.messages import (
    JointFeedback,
    MalformedMessage,
    Message,
    RobotStatus,
)
from cardan.types import NEVER_S

_KINDS_OF_IGNORED = 32
"""Most reasons that are counted separately."""

_BAD_IN_A_ROW = 8
"""Consecutive bad messages after which the connection is closed."""


class StateFeed:
    """The newest status and the newest feedback of one group.

    An invalid message is counted and changes nothing. `failure` is the reason why the stream is
    unusable.
    """

    def __init__(self, options: MotorosOptions) -> None:
        self.joints = options.joints
        self.byte_order: ByteOrder | None = options.known_byte_order
        """The controller's byte order; None until it was learned."""
        self.status: RobotStatus | None = None
        self.statuses = 0
        self.positions: tuple[float, ...] = ()
        """rad, base to tool."""
        self.velocities: tuple[float, ...] = ()
        """Joint velocities, rad/s; empty if they are not sent or not trusted."""
        self.feedbacks = 0
        self.other_axis = 0
        """Axis, counted from 1, that the arm does not have and that is not at zero; 0: none."""
        self.ignored: Counter[str] = Counter()
        """Messages without effect, by reason."""
        self._group = options.group
        self._known = options.known_byte_order
        self._trust_velocity = options.trust_velocity
        self._timeout_s = options.state_timeout_s
        self.connected()

    def connected(self) -> None:
        """Begin a new connection."""
        self._reader = FrameReader(self._known, LONGEST_PREFIX_OF_MOTOROS)
        self._wire: WireFormat | None = None
        self._bad = 0
        self.failure = ""
        self.disconnected()

    def disconnected(self) -> None:
        """Count no earlier message as fresh any more."""
        self.status_s = self.feedback_s = NEVER_S

    @property
    def heard(self) -> bool:
        """True once a complete state was received."""
        return bool(self.feedbacks and self.statuses)

    @property
    def stale_s(self) -> float:
        """Time at which the newest feedback will be too old, s."""
        return min(self.status_s, self.feedback_s) + self._timeout_s

    def live(self, now_s: float) -> bool:
        """True while both status and feedback are fresh."""
        return now_s < self.stale_s

    def at_rest_after(self, since_s: float) -> bool:
        """True when a complete state later than `since_s` reports that the robot does not move."""
        status = self.status
        return (
            status is not None
            and status.in_motion == 0
            and self.status_s > since_s
            and self.feedback_s > since_s
        )

    def received(self, data: bytes, now_s: float) -> None:
        """Process bytes from TCP."""
        reader = self._reader
        reader.feed(data)
        while not self.failure and (frame := reader.take()) is not None:
            if self._wire is None:
                self._wire = self._choose(frame)
                if self._wire is None:
                    return
            message = self._wire.decode(frame)
            if isinstance(message, MalformedMessage):
                self._ignore(message.reason)
            else:
                self._take(message, now_s)
        if reader.failure and not self.failure:
            self._ignore(reader.failure)
            self.failure = f"the state port sent {reader.failure}"
            if reader.byte_order is None:
                self.failure += ": it does not speak MotoROS; is state_port the controller's?"

    def _choose(self, frame: bytes) -> WireFormat | None:
        found = detect_wire(frame)
        if found is not None and found.real_bytes != 4:
            self.failure = (
                "the state port sends reals of 8 bytes: this is not MotoROS but another maker's "
                "server"
            )
            return None
        order = self._reader.byte_order
        if order is None:  # no part of the frame is plausible; take() reports it then
            return None
        self.byte_order = order
        return wire(order)

    def _ignore(self, reason: str) -> None:
        if reason not in self.ignored and len(self.ignored) >= _KINDS_OF_IGNORED:
            reason = "others"
        self.ignored[reason] += 1
        self._bad += 1
        if self._bad >= _BAD_IN_A_ROW:
            self.failure = f"the state port sent {self._bad} bad messages: {reason}"

    def _take(self, message: Message, now_s: float) -> None:
        body = message.body
        if isinstance(body, RobotStatus):
            self._bad = 0
            self.status = body
            self.status_s = now_s
            self.statuses += 1
        elif isinstance(body, JointFeedback):
            if body.group != self._group:
                return
            n = self.joints
            positions = body.pos[:n]
            if not body.valid_fields & ValidFields.POSITION:
                self._ignore("a feedback without positions")
            elif not all(map(math.isfinite, positions)):
                self._ignore("a feedback with values that are not numbers")
            elif outside("positions", positions, JOINT_POSITION):
                self._ignore("a feedback that is beyond any joint's range")
            else:
                self._bad = 0
                others = body.pos[n:]
                self.other_axis = 0
                if any(others):
                    self.other_axis = n + 1 + next(i for i, p in enumerate(others) if p)
                self.positions = positions
                self.feedback_s = now_s
                self.feedbacks += 1
                speeds = body.vel[:n]
                reported = self._trust_velocity and body.valid_fields & ValidFields.VELOCITY
                plausible = reported and not outside("velocities", speeds, JOINT_VELOCITY)
                self.velocities = speeds if plausible else ()
        elif message.msg_type != MessageType.MOTO_JOINT_FEEDBACK_EX:
            self._ignore(f"{name_of(MessageType, message.msg_type)} on the state port")
