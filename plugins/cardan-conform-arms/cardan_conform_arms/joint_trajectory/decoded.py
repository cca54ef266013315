"""Decoded traffic of an action server for its checks: goals and their outcomes."""

from __future__ import annotations

from dataclasses import dataclass, field

from cardan.conform.timeline import Kind, WireEvent, WireTimeline
from cardan.protocols.ros2.actions import CANCEL_TYPE, STATUS_TYPE, GoalStatus
from cardan.protocols.ros2.cdr import MalformedCdr, Message, decoded
from cardan_conform_arms.joint_trajectory.names import CANCEL, FEEDBACK, GOAL, RESULT, STATUS, TYPE
from cardan_conform_arms.joint_trajectory.scenario import joint_distance
from cardan_conform_arms.ros2_arm.decoded import RosArmTraffic, State

_REQUESTS = {
    GOAL: TYPE.send_goal.request,
    CANCEL: f"{CANCEL_TYPE}_Request",
    RESULT: TYPE.get_result.request,
}
_HEARD = {
    GOAL: TYPE.send_goal.response,
    CANCEL: f"{CANCEL_TYPE}_Response",
    RESULT: TYPE.get_result.response,
    FEEDBACK: TYPE.feedback,
    STATUS: STATUS_TYPE,
}


@dataclass
class Goal:
    """Goal that was sent."""

    number: int
    """Number of its event."""
    sent_s: float
    id: bytes
    trajectory: Message
    accepted: bool | None = None
    """None: no answer."""
    status: int | None = None
    """Status of its result; None: no result."""
    code: int = 0
    words: str = ""
    result: int = 0
    """Number of the result's event."""
    result_s: float = 0.0
    states: list[tuple[int, int]] = field(default_factory=list)
    """Published status: number of the event, status."""

    @property
    def target(self) -> dict[str, float]:
        """Final positions."""
        last = self.trajectory["points"][-1]["positions"]
        return dict(zip(self.trajectory["joint_names"], last, strict=False))

    @property
    def seconds(self) -> float:
        """Duration, s."""
        time = self.trajectory["points"][-1]["time_from_start"]
        return float(time["sec"] + 1e-9 * time["nanosec"])

    @property
    def became(self) -> str:
        """Return the outcome of the goal in words."""
        if self.accepted is None:
            return "nobody answered"
        if not self.accepted:
            return "it was rejected"
        if self.status is None:
            return "it has no result"
        known = self.status in list(GoalStatus)
        name = GoalStatus(self.status).name if known else f"status {self.status}"
        return f"{name} with error_code {self.code}"


class TrajectoryTraffic(RosArmTraffic):
    """Goals of a timeline, and the arm's states."""

    def __init__(self, timeline: WireTimeline) -> None:
        super().__init__(timeline)
        self.goals: list[Goal] = []
        self.feedback: list[tuple[int, Message]] = []
        self.canceled: dict[bytes, float] = {}
        """Time at which the cancellation of a goal was sent, by its id."""
        self._asked: list[bytes] = []
        """Ids of the goals whose results were requested."""
        for number, event in enumerate(timeline):
            names = _REQUESTS if event.sent else _HEARD
            if event.kind is Kind.DATA and event.channel in names:
                _, message = decoded(names[event.channel], event.data)
                if isinstance(message, MalformedCdr):
                    self.unread.append((number, message.reason))
                elif event.sent:
                    self._take_request(number, event, message)
                else:
                    self._take(number, event, message)

    def _take_request(self, number: int, event: WireEvent, message: Message) -> None:
        if event.channel == GOAL:
            goal_id = bytes(message["goal_id"]["uuid"])
            trajectory = message["goal"]["trajectory"]
            self.goals.append(Goal(number, event.time_s, goal_id, trajectory))
        elif event.channel == CANCEL:
            goal_id = bytes(message["goal_info"]["goal_id"]["uuid"])
            self.canceled[goal_id] = event.time_s
        else:
            self._asked.append(bytes(message["goal_id"]["uuid"]))

    def _take(self, number: int, event: WireEvent, message: Message) -> None:
        if event.channel == GOAL:
            self.goals[int(event.note) - 1].accepted = message["accepted"]
        elif event.channel == RESULT:
            goal = self._goal(self._asked[int(event.note) - 1])
            if goal is not None:
                goal.status, goal.result, goal.result_s = message["status"], number, event.time_s
                goal.code = message["result"]["error_code"]
                goal.words = message["result"]["error_string"]
        elif event.channel == FEEDBACK:
            self.feedback.append((number, message))
        elif event.channel == STATUS:
            for each in message["status_list"]:
                goal = self._goal(bytes(each["goal_info"]["goal_id"]["uuid"]))
                if goal is not None:
                    goal.states.append((number, each["status"]))

    def _goal(self, goal_id: bytes) -> Goal | None:
        return next((each for each in self.goals if each.id == goal_id), None)

    def sent_in(self, phase: str) -> list[Goal]:
        """Return the goals of a phase."""
        return self.within(self.goals, phase)

    def off(self, state: State, positions: dict[str, float]) -> dict[str, float]:
        """Return the distance of joints from `positions`; for continuous joints the shorter way."""
        kinds = self.described or {}
        return {
            name: joint_distance(state.positions[name], at, kinds.get(name, ""))
            for name, at in positions.items()
            if name in state.positions
        }

    def farthest(self, states: list[State]) -> tuple[float, str, int]:
        """Return the largest distance of a joint from its first position in `states`, the joint and
        the event; only joints of goals, if there are goals."""
        first: dict[str, float] = {}
        for each in reversed(states):
            first.update(each.positions)
        named = {name for goal in self.goals for name in goal.trajectory["joint_names"]}
        if named:
            first = {name: at for name, at in first.items() if name in named}
        ways = [
            (abs(value), name, each.number)
            for each in states
            for name, value in self.off(each, first).items()
        ]
        return max(ways, default=(0.0, "no joint", states[0].number))
