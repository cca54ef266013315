"""Scenario of an action client: valid and invalid goals, and cancellations."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping

from cardan.conform.requirements import Level
from cardan.conform.runner import Pause, Scenario, Script, Step, mark, open_, send
from cardan.conform.timeline import Kind, WireEvent
from cardan.protocols.ros2.actions import CANCEL_TYPE, NO_ID
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.messages import completed
from cardan_conform_arms.joint_trajectory.names import CANCEL, FEEDBACK, GOAL, RESULT, STATUS, TYPE
from cardan_conform_arms.ros2_arm.names import DESCRIPTION, STATES, TOPICS, joints_of

STEP = 3e-3
"""Step of a joint, rad: 0.17 degrees."""
STEP_M = 1e-3
NEAR = 0.3
"""Tolerance at a goal and at rest, as a share of a step."""
FAR = 0.05
"""Distance of a joint from its start at which all goals are canceled and the run ends."""
TURN = 2.0 * math.pi

SHORT_S, LONG_S = 1.0, 3.0
"""Duration of a goal, and of a goal that is to be interrupted."""
AFTER_S = 0.6
"""Time of the interruption of such a goal."""
TOLERANCE_S = 1.0
"""`goal_time_tolerance`."""
LATE_S = 1.0
"""Longest wait for a result beyond that."""
REST_S = 0.5
"""Time in which an arm comes to rest, and then of observation."""

BAD = ("unknown", "too-few", "unequal", "same-time", "nan")
"""Phases with a goal that cannot be executed."""

_STATE, _TEXT = codec_of(TOPICS[STATES].type), codec_of(TOPICS[DESCRIPTION].type)
_ACCEPTED = codec_of(TYPE.send_goal.response)
_NS = 10**9


def joint_distance(to: float, from_: float, kind: str) -> float:
    """Return the distance of a joint of this kind from its earlier position; continuous: the
    shorter way."""
    way = to - from_
    return math.remainder(way, TURN) if kind == "continuous" and math.isfinite(way) else way


def _encoded(name: str, given: Mapping[str, object]) -> bytes:
    return codec_of(name).encode(completed(name, given))


def _duration(seconds: float) -> Message:
    ns = round(seconds * _NS)
    return {"sec": ns // _NS, "nanosec": ns % _NS}


class TrajectoryScenario(Scenario):
    """Client that requests the result of each accepted goal."""

    def __init__(self, level: Level, seconds: float, joints: tuple[str, ...] = ()) -> None:
        """`joints`: those of the controller; empty: all that are described and published."""
        self._level, self._seconds, self._joints = level, seconds, joints
        self._kinds: dict[str, str] = {}
        self._at: dict[str, float] = {}
        self._home: dict[str, float] = {}
        """Initial position of each joint of the goals; empty: unknown."""
        self._seed = b""
        """Seed of the goals' ids: no two runs have the same."""
        self._ids: list[bytes] = []
        """Ids of the goals that were sent."""
        self._asked: list[int] = []
        """Numbers of the goals whose results were requested."""
        self._settled: set[int] = set()
        """Numbers of the goals that were rejected or have a result."""
        self._away = False

    def answer(self, event: WireEvent) -> Iterator[Step]:
        if event.kind is not Kind.DATA:
            return
        if event.channel == DESCRIPTION:
            text = _TEXT.decode(event.data)
            if not isinstance(text, MalformedCdr):
                self._kinds = joints_of(text["data"])
        elif event.channel == STATES:
            yield from self._take_state(event.data)
        elif event.channel == RESULT:
            self._settled.add(self._asked[int(event.note) - 1])
        elif event.channel == GOAL:
            number, message = int(event.note), _ACCEPTED.decode(event.data)
            if isinstance(message, MalformedCdr) or not message["accepted"]:
                self._settled.add(number)
            else:
                self._asked.append(number)
                given = {"goal_id": {"uuid": self._ids[number - 1]}}
                yield send(_encoded(TYPE.get_result.request, given), RESULT)

    def _take_state(self, data: bytes) -> Iterator[Step]:
        message = _STATE.decode(data)
        if isinstance(message, MalformedCdr):
            return
        self._seed = data
        pairs = zip(message["name"], message["position"], strict=False)
        self._at.update((name, value) for name, value in pairs if math.isfinite(value))
        if not self._away and any(abs(self._from_home(name)) > FAR for name in self._home):
            self._away = True
            yield self._cancel(NO_ID)

    def _from_home(self, name: str) -> float:
        return joint_distance(self._at[name], self._home[name], self._kinds[name])

    def _cancel(self, goal_id: bytes) -> Step:
        given = {"goal_info": {"goal_id": {"uuid": goal_id}}}
        return send(_encoded(f"{CANCEL_TYPE}_Request", given), CANCEL)

    def _goal(self, target: Mapping[str, float], seconds: float, bad: str = "") -> Step:
        """Return a goal from the present position to `target`, for all its joints. `bad`: its
        defect."""
        names = list(self._home)
        # Present position with the same count of whole turns as the target.
        start = [
            self._at[name] + TURN * round((target[name] - self._at[name]) / TURN)
            if self._kinds[name] == "continuous"
            else self._at[name]
            for name in names
        ]
        end = [target[name] for name in names]
        if bad == "nan":
            end[names.index(self._moved)] = math.nan
        points: list[Message] = [
            {"positions": start},
            {"positions": end, "time_from_start": _duration(seconds)},
        ]
        if bad == "unequal":
            points[-1]["positions"] = end[:-1]
        elif bad == "same-time":
            points.append(points[-1])
        elif bad == "too-few":
            names = names[1:]
            for point in points:
                point["positions"] = point["positions"][1:]
        tolerances = [{"name": n, "position": NEAR * self._step(n)} for n in names]
        if bad == "unknown":
            names = [f"{name}_of_nobody" for name in names]
            tolerances = []
        goal = {
            "trajectory": {"joint_names": names, "points": points},
            "goal_tolerance": tolerances,
            "goal_time_tolerance": _duration(TOLERANCE_S),
        }
        count = len(self._ids).to_bytes(2, "big")
        self._ids.append(hashlib.sha256(self._seed + count).digest()[:16])
        given = {"goal_id": {"uuid": self._ids[-1]}, "goal": goal}
        return send(_encoded(TYPE.send_goal.request, given), GOAL)

    def _step(self, name: str) -> float:
        return STEP_M if self._kinds[name] == "prismatic" else STEP

    @property
    def _moved(self) -> str:
        """Return the joint that is moved: the last one."""
        return next(reversed(self._home))

    def _out(self) -> dict[str, float]:
        name = self._moved
        return self._home | {name: self._home[name] + self._step(name)}

    def _is_settled(self) -> bool:
        return self._away or len(self._settled) == len(self._ids)

    def _ending(self, seconds: float) -> Script:
        """Wait until all goals have ended, the longest of which takes `seconds`, and a margin."""
        yield Pause(seconds + TOLERANCE_S + LATE_S, self._is_settled)
        yield Pause(2.0 * REST_S)

    def script(self) -> Script:
        for channel in (STATES, DESCRIPTION, STATUS, FEEDBACK):
            yield open_(channel)
        yield mark("listen")
        yield Pause(self._seconds)
        known = [name for name in self._kinds if name in self._at]
        names = [name for name in self._joints or known if name in known]
        if self._level < Level.HOLD or not names or len(names) < len(self._joints):
            return
        for channel in (GOAL, CANCEL, RESULT):
            yield open_(channel)
        yield Pause(0.2)
        self._home = {name: self._at[name] for name in names}
        for step in self._asking():
            if self._away:
                yield Pause(2.0 * REST_S)
                return
            yield step

    def _asking(self) -> Script:
        yield mark("hold")
        yield self._goal(self._home, SHORT_S)
        yield from self._ending(SHORT_S)
        if self._level < Level.MOVE:
            return
        for phase in BAD:
            yield mark(phase)
            yield self._goal(self._out(), SHORT_S, phase)
            yield from self._ending(SHORT_S)
        yield from self._moving("out", self._out())
        yield from self._moving("back", self._home)
        yield mark("cancel")
        yield self._goal(self._out(), LONG_S)
        yield Pause(AFTER_S)
        yield self._cancel(self._ids[-1])
        yield from self._ending(LONG_S)
        yield mark("at-once")
        yield self._goal(self._out(), LONG_S)
        yield self._cancel(self._ids[-1])
        yield from self._ending(LONG_S)
        yield mark("two")
        yield self._goal(self._out(), LONG_S)
        yield Pause(AFTER_S)
        yield self._goal(self._home, SHORT_S)
        yield from self._ending(LONG_S)
        endless = [name for name in self._home if self._kinds[name] == "continuous"]
        if endless:
            yield from self._moving("wrap", self._home | {n: self._wrapped(n) for n in endless})
            yield from self._moving("home", self._home)

    def _moving(self, phase: str, target: Mapping[str, float]) -> Script:
        yield mark(phase)
        yield self._goal(target, SHORT_S)
        yield from self._ending(SHORT_S)

    def _wrapped(self, name: str) -> float:
        """Return the position one step on, by another count of turns: within (-pi, pi] if the joint
        is not, else one turn on."""
        target = self._home[name] + STEP
        turns = math.ceil(target / TURN - 0.5)
        return target - TURN * turns if turns else target + TURN
