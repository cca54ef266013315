"""Action server of a PR2's arm with selected defects, and a scenario in virtual time."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Mapping

from cardan.conform.runner import Exchange
from cardan.conform.simulation import DriverSimulation
from cardan.protocols.ros2.actions import (
    CANCEL_TYPE,
    STATUS_TYPE,
    CancelCode,
    Goal,
    Goals,
    GoalStatus,
)
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.messages import completed
from cardan.robots import JointKind, load_arm
from cardan_conform_arms.joint_trajectory.faults import FAULTS
from cardan_conform_arms.joint_trajectory.names import CANCEL, FEEDBACK, GOAL, RESULT, STATUS, TYPE
from cardan_conform_arms.joint_trajectory.requirements import INVALID
from cardan_conform_arms.joint_trajectory.scenario import TURN
from cardan_conform_arms.ros2_arm.names import DESCRIPTION, STATES, TOPICS

ARM = "pr2_right_arm"
"""Arm with two continuous joints."""
PERIOD_S = 0.01
FEEDBACK_CYCLES = 10
GOAL_S = 0.004
"""Transmission time of a goal; its cancellation arrives at once."""
WALL_NS = 1_700_000_000 * 10**9

_Path = list[tuple[float, list[float]]]


class ActionSimulation(DriverSimulation):
    """Ideal arm that follows its trajectory exactly."""

    def __init__(self, exchange: Exchange, faults: Mapping[str, float], seed: int) -> None:
        super().__init__(exchange, faults, FAULTS)
        self._arm = load_arm(ARM)
        self._names = list(self._arm.joint_names)
        self._endless = [j.kind is JointKind.CONTINUOUS for j in self._arm.joints]
        self._q = list(self._arm.home)
        self._goals = Goals()
        self._coming: list[tuple[float, str, Message]] = []
        """Goals under way: arrival time, and number of the request."""
        self._asked: Counter[str] = Counter()
        """Number of requests on each channel."""
        self._waiting: dict[bytes, list[str]] = {}
        """Numbers of the requests for the results of active goals."""
        self._goal: Goal | None = None
        """Goal that moves the arm."""
        self._path: _Path = []
        """Times since the start, and positions; empty: the arm stands."""
        self._cycles = 0

    # -- services ---------------------------------------------------------------------------------

    def _take(self, data: bytes, channel: str) -> None:
        self._asked[channel] += 1
        number = str(self._asked[channel])
        requests = {GOAL: TYPE.send_goal.request, RESULT: TYPE.get_result.request}
        message = codec_of(requests.get(channel, f"{CANCEL_TYPE}_Request")).decode(data)
        if isinstance(message, MalformedCdr) or "mute" in self._faults:
            return
        if channel == GOAL:
            self._coming.append((self._now_s + GOAL_S, number, message))
        elif channel == CANCEL:
            response = self._cancel(message)
            self._tell(CANCEL, f"{CANCEL_TYPE}_Response", response, number)
        else:
            goal = self._goals.find(bytes(message["goal_id"]["uuid"]))
            if goal is not None and not goal.status.over:
                self._waiting.setdefault(goal.id, []).append(number)
            elif goal is not None:
                self._give_result(goal, number)

    def _tell(self, channel: str, name: str, given: Message, note: str = "") -> None:
        self._hear(channel, codec_of(name).encode(completed(name, given)), note=note)

    def _accept(self, number: str, message: Message) -> None:
        path, code = self._planned(message["goal"]["trajectory"])
        goal = None
        if "rejects" not in self._faults and (path or code == INVALID["INVALID_JOINTS"]):
            goal_id = bytes(message["goal_id"]["uuid"])
            now_ns = WALL_NS + round(self._now_s * 1e9)
            goal = self._goals.accept(goal_id, now_ns, self._now_s)
        self._tell(GOAL, TYPE.send_goal.response, {"accepted": goal is not None}, number)
        if goal is None:
            return
        self._put_status()
        if goal.status is GoalStatus.CANCELING:
            self._finish(goal, GoalStatus.CANCELED)
            return
        if not path:
            self._finish(goal, GoalStatus.ABORTED, code)
            return
        if self._goal is not None:
            done = "both" in self._faults
            self._finish(self._goal, GoalStatus.SUCCEEDED if done else GoalStatus.ABORTED)
        self._goals.execute(goal)
        self._goal, self._path = goal, path
        self._put_status()
        if "early" in self._faults:
            self._finish(goal, GoalStatus.SUCCEEDED)

    def _planned(self, trajectory: Message) -> tuple[_Path, int]:
        """Return a trajectory's path from the arm's position, and the code that rejects it."""
        faults, names = self._faults, list(trajectory["joint_names"])
        if set(names).isdisjoint(self._names) and "unknown" in faults:
            names = self._names
        few = set(names) < set(self._names) and "too-few" in faults
        if sorted(names) != sorted(self._names) and not few:
            return [], INVALID["INVALID_JOINTS"]
        wrong: tuple[_Path, int] = [], INVALID["INVALID_GOAL"]
        path = [(self._now_s, self._q)]
        begin: dict[str, float] = {}
        before_s = -1.0
        for point in trajectory["points"]:
            time = point["time_from_start"]
            after_s = time["sec"] + 1e-9 * time["nanosec"]
            if len(point["positions"]) != len(names) and "unequal" not in faults:
                return wrong
            given = dict(zip(names, point["positions"], strict=False))
            if not all(map(math.isfinite, given.values())) and "nan" not in faults:
                return wrong
            if after_s <= before_s and "same-time" not in faults:
                return wrong
            begin = begin or given
            row = [
                self._reached(given[name], begin[name], index)
                if math.isfinite(given.get(name, math.nan))
                else self._q[index]
                for index, name in enumerate(self._names)
            ]
            if row != self._q:
                after_s += faults.get("slow", 0.0)
            if after_s > max(before_s, 0.0):
                path.append((self._now_s + after_s, row))
            before_s = after_s
        return path, 0

    def _reached(self, at: float, begin: float, index: int) -> float:
        """Return a joint's position for a point of a plan that begins at `begin`."""
        q = self._q[index]
        if self._endless[index] and "whole-turn" not in self._faults:
            at += TURN * round((q - begin) / TURN)
        return q + self._faults.get("short", 1.0) * (at - q)

    def _cancel(self, request: Message) -> Message:
        goal = self._goals.find(bytes(request["goal_info"]["goal_id"]["uuid"]))
        if "no-cancel" in self._faults:
            return {"return_code": int(CancelCode.REJECTED)}
        if goal is None and "forgets" in self._faults:
            return {"return_code": int(CancelCode.UNKNOWN_GOAL_ID)}
        response, going = self._goals.cancel(request)
        self._put_status()
        for each in going:
            path = self._path
            aborts = "aborts" in self._faults
            self._finish(each, GoalStatus.ABORTED if aborts else GoalStatus.CANCELED)
            self._path = path if "coasts" in self._faults else []
        return response

    def _finish(self, goal: Goal, status: GoalStatus, code: int = 0) -> None:
        if goal is self._goal:
            self._goal = None
        self._goals.finish(goal, status, {"error_code": code}, self._now_s)
        self._put_status()
        for number in self._waiting.pop(goal.id, ()):
            self._give_result(goal, number)

    def _give_result(self, goal: Goal, number: str) -> None:
        if "no-result" in self._faults:
            return
        result = dict(goal.result or {})
        if goal.status is GoalStatus.SUCCEEDED:
            result["error_code"] = int(self._faults.get("code", 0.0))
        given = {"status": int(goal.status), "result": result}
        self._later(
            self._faults.get("late", 0.0),
            lambda: self._tell(RESULT, TYPE.get_result.response, given, number),
        )

    def _put_status(self) -> None:
        if "no-status" in self._faults:
            return
        message = self._goals.status_array()
        self._tell(STATUS, STATUS_TYPE, message)
        if "status-back" in self._faults:
            for each in message["status_list"]:
                each["status"] = int(GoalStatus.EXECUTING)
            self._tell(STATUS, STATUS_TYPE, message)

    # -- the arm ----------------------------------------------------------------------------------

    def _open(self, channel: str) -> None:
        super()._open(channel)
        if channel == DESCRIPTION:
            self._tell(DESCRIPTION, TOPICS[DESCRIPTION].type, {"data": self._arm.urdf})

    def _next_s(self) -> float:
        due = [self._cycles * PERIOD_S, *(due_s for due_s, _, _ in self._coming)]
        return min(super()._next_s(), *due)

    def _turn(self) -> None:
        while self._coming and self._coming[0][0] <= self._now_s:
            _, number, message = self._coming.pop(0)
            self._accept(number, message)
        if self._now_s < self._cycles * PERIOD_S:
            return
        self._cycles += 1
        self._move()
        first = 1 if "lacks-joint" in self._faults else 0
        stamp_ns = WALL_NS + round(self._now_s * 1e9)
        given = {
            "header": {"stamp": {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}},
            "name": self._names[first:],
            "position": self._q[first:],
        }
        self._tell(STATES, TOPICS[STATES].type, given)
        if self._goal is not None and self._cycles % FEEDBACK_CYCLES == 0:
            goal_id = bytes(16) if "strange-feedback" in self._faults else self._goal.id
            reported = {"joint_names": self._names, "actual": {"positions": self._q}}
            self._tell(
                FEEDBACK, TYPE.feedback, {"goal_id": {"uuid": goal_id}, "feedback": reported}
            )

    def _move(self) -> None:
        drift = self._faults.get("drifts", 0.0) * PERIOD_S
        self._q = [q + drift for q in self._q]
        if not self._path:
            return
        for (from_s, from_), (to_s, to) in itertools.pairwise(self._path):
            if self._now_s < to_s:
                share = (self._now_s - from_s) / (to_s - from_s)
                self._q = [a + share * (b - a) for a, b in zip(from_, to, strict=True)]
                return
        self._q, self._path = self._path[-1][1], []
        if self._goal is not None:
            self._finish(self._goal, GoalStatus.SUCCEEDED)

    def _by_hand(self, what: str) -> None:
        """Do nothing: this suite has no operator."""
