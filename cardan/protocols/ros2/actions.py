"""Goals of an action server: their states, and the reports to their clients.

Source: design.ros2.org, "Actions"; action_msgs.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import IntEnum

from cardan.protocols.ros2.cdr import Message
from cardan.protocols.ros2.zenoh import Qos

STATUS_QOS = Qos(transient_local=True, depth=1)
FEEDBACK_QOS = Qos(depth=10)

RETENTION_S = 900.0
"""Time for which a result is kept for later requests: 15 minutes, as in rcl."""

CAPACITY = 64
"""Most goals kept, and most cancellations of goals that have not arrived. Beyond it the goals that
ended first, and the oldest cancellations, are dropped."""

NO_ID = bytes(16)

STATUS_TYPE = "action_msgs/msg/GoalStatusArray"
CANCEL_TYPE = "action_msgs/srv/CancelGoal"


class GoalStatus(IntEnum):
    """Status of action_msgs/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def over(self) -> bool:
        """True if the status is final."""
        return self >= GoalStatus.SUCCEEDED


class CancelCode(IntEnum):
    """Return code of action_msgs/srv/CancelGoal."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


class Goal:
    """A goal that was accepted."""

    def __init__(self, goal_id: bytes, stamp_ns: int) -> None:
        self.id = goal_id
        self.stamp_ns = stamp_ns
        """Time of acceptance since the epoch, ns."""
        self.status = GoalStatus.ACCEPTED
        self.result: Message | None = None
        self.over_s = 0.0
        """Time of its end, monotonic, s."""

    def info(self) -> Message:
        """Convert to action_msgs/GoalInfo."""
        return {"goal_id": {"uuid": self.id}, "stamp": _time(self.stamp_ns)}


class Goals:
    """Goals of one action server.

    Not thread-safe. A goal and its cancellation come through two services, between which ROS 2
    guarantees no order. A cancellation of a goal that has not arrived is answered with
    UNKNOWN_GOAL_ID and remembered: each id belongs to one goal. The goal is then accepted as one
    that is being canceled, and must not begin. It is not rejected, because only an accepted goal
    has a result, and a client that waits for the result must get CANCELED.
    """

    def __init__(self, retained: int = CAPACITY, retained_s: float = RETENTION_S) -> None:
        self._retained, self._retained_s = retained, retained_s
        self._goals: dict[bytes, Goal] = {}
        self._canceled_before: dict[bytes, None] = {}
        """Ids of canceled goals that have not arrived, the newest last."""

    def accept(self, goal_id: bytes, now_ns: int, now_s: float) -> Goal | None:
        """Add a goal, CANCELING if it was canceled before it arrived.

        Return None for a known id, or if the table is full of active goals. `now_ns` is since the
        epoch, `now_s` monotonic.
        """
        self._forget(now_s)
        if goal_id in self._goals or len(self._goals) >= self._retained:
            return None
        goal = self._goals[goal_id] = Goal(goal_id, now_ns)
        if goal_id in self._canceled_before:
            del self._canceled_before[goal_id]
            goal.status = GoalStatus.CANCELING
        return goal

    def find(self, goal_id: bytes) -> Goal | None:
        """Return the goal with this id, while it is kept."""
        return self._goals.get(goal_id)

    def execute(self, goal: Goal) -> None:
        """Mark a goal as executing, unless it is being canceled."""
        if goal.status is GoalStatus.ACCEPTED:
            goal.status = GoalStatus.EXECUTING

    def finish(self, goal: Goal, status: GoalStatus, result: Message, now_s: float) -> bool:
        """End a goal with `result`; return False if it had already ended."""
        if goal.status.over:
            return False
        goal.result, goal.over_s = result, now_s
        goal.status = status
        return True

    def cancel(self, request: Message) -> tuple[Message, list[Goal]]:
        """Return the response to a CancelGoal request, and the goals that are to end now.

        Without an id: all; with a stamp: all that were accepted until then; with both: also the one
        with the id.
        """
        info = request["goal_info"]
        wanted = bytes(info["goal_id"]["uuid"])
        stamp = info["stamp"]
        until_ns = stamp["sec"] * 10**9 + stamp["nanosec"]
        code = CancelCode.NONE
        if wanted == NO_ID:
            found = [g for g in self._goals.values() if not until_ns or g.stamp_ns <= until_ns]
        else:
            found = [
                g
                for g in self._goals.values()
                if g.id == wanted or (until_ns and g.stamp_ns <= until_ns)
            ]
            if wanted not in self._goals:
                code = CancelCode.UNKNOWN_GOAL_ID
                self._remember_canceled(wanted)
            elif self._goals[wanted].status.over:
                code = CancelCode.GOAL_TERMINATED
        going = [goal for goal in found if not goal.status.over]
        for goal in going:
            goal.status = GoalStatus.CANCELING
        if going:
            code = CancelCode.NONE
        return {"return_code": int(code), "goals_canceling": [g.info() for g in going]}, going

    def _remember_canceled(self, goal_id: bytes) -> None:
        self._canceled_before.pop(goal_id, None)
        if len(self._canceled_before) >= self._retained:
            del self._canceled_before[next(iter(self._canceled_before))]
        self._canceled_before[goal_id] = None

    def status_array(self) -> Message:
        """Return all kept goals as action_msgs/GoalStatusArray."""
        return {"status_list": [_status(goal) for goal in self._goals.values()]}

    def _forget(self, now_s: float) -> None:
        over = sorted(_over(self._goals.values()), key=lambda goal: goal.over_s)
        most = max(0, len(self._goals) - self._retained + 1)
        for index, goal in enumerate(over):
            if index < most or now_s - goal.over_s > self._retained_s:
                del self._goals[goal.id]


def _over(goals: Iterable[Goal]) -> list[Goal]:
    return [goal for goal in goals if goal.status.over]


def _status(goal: Goal) -> Message:
    return {"goal_info": goal.info(), "status": int(goal.status)}


def _time(ns: int) -> Message:
    return {"sec": ns // 10**9, "nanosec": ns % 10**9}
