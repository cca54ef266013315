"""Missed cycles: time in which a robot got no commands is never made up for.

While a process stands still, or datagrams are lost, most controllers continue at the last commanded
speed. The next command then differs from the robot's position: it is behind, if the application
continued from its last command, or ahead, if the robot slowed down. Sent at once it would cause a
jerk, and a robot that made up for lost time would be faster than commanded.

So the difference is kept, and added to every command. A robot that is ahead of its command is
slowed a little until it is not; one that is behind stays behind until it rests. When the command
has come to rest, nothing may move for long: the robot ends its way at once, no faster than it was
commanded, and the part that takes longer than `LONGEST_REST_S` stays.

How much time has passed is never the controller's word alone: `AgreedTime` counts what its clock
and this computer's both say.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

WORK_OFF_S: Final = 0.5
"""Time constant with which a difference in place dies away in motion: 6 mm, what 60 ms at 100 mm/s
leave, at 12 mm/s."""

WORK_OFF_SHARE: Final = 0.5
"""Share of the commanded speed by which it may be slowed for that."""

REST_S: Final = 0.2
"""Time from the rest of the command to that of the robot: 6 mm at 45 mm/s at most, and 0.9 m/s²."""

LONGEST_REST_S: Final = 0.27
"""The same where more was lost than 67 ms, which takes longer if it is to be no harder: a robot
that had stopped is 0.125 s behind once it has its speed again."""

RECENT_S: Final = 5.0
"""Time constant with which it is forgotten what speed was commanded."""

SPEED_UP_S: Final = 0.25
"""Time in which a robot that has stopped by itself has its speed again: 250 mm/s at 1 m/s²."""

SLOW_DOWN_S: Final = 0.1
"""Time constant of that for a robot that is faster than commanded: from 100 mm/s at 1 m/s²."""

NOTHING: Final = 1e-7
"""Smallest difference that counts: m, rad, and per s."""


SLACK_S: Final = 0.001
"""Time beyond this computer's own by which a robot may be advanced at once: what arrival jitters by
on an idle computer. At 0.5 rad/s it is 0.5 mrad."""

PARTED_SHARE: Final = 0.02
"""Difference in speed of two clocks that count as parted: quartzes differ by 0.0001."""

WINDOW_S: Final = 0.5
"""Time over which clocks are compared, by the states that came quickest in it."""

JUMP_S: Final = 0.05
"""Lead of a clock over the quickest arrival of a window that no delay explains."""

SIMULATED_MOST: Final = 10.0
"""Largest rate of simulated time; a larger step from one state to the next is a jump."""

PAUSE_S: Final = 0.1
"""Local time that may pass beyond the controller's and be made up for later, by states that were
kept back. A clock that loses more between two states, where states come faster otherwise, was
stopped with its controller: clocks are compared anew. A clock that shows the same time for this
long, while states come, stands still."""

_STILL_STATES = 2
"""Further states with the same time that are needed for that."""

SIMULATED_TIME: Final = "simulated_time"
"""The option of drivers whose controller may be a simulation."""


def believed_s(
    step_s: float, due_s: float, waited_s: float, credit_s: float
) -> tuple[float, float]:
    """Time between two states of which a controller says that it was `step_s`, and the credit for
    the next; before the first it is SLACK_S.

    They came `waited_s` apart, and `due_s` is the time that so many states take: states that were
    kept back come faster, and use up `credit_s`, which is what this computer has counted and the
    controller has not. cardan/drivers/abb_egm/kernel/take.c has the same.
    """
    found_s, slack_s, credit_s = step_s, waited_s + SLACK_S, credit_s + waited_s
    if found_s > due_s and found_s > slack_s:
        found_s = max(due_s, slack_s)
    if found_s > credit_s:
        found_s = credit_s
    if not found_s > 0.0:
        found_s = 0.0
    left_s = credit_s - found_s
    return found_s, left_s if left_s < PAUSE_S else PAUSE_S


class ClockWatch:
    """Comparison of a controller's clock with the local one; `fault` says what is wrong with it.

    Delays are no fault: a state may come late, several may come at once, and either computer may
    stand still. So only the state that came quickest in each window counts, and a small difference
    has to be there in two windows.
    """

    __slots__ = (
        "_ahead_s",
        "_ahead_to_s",
        "_best_s",
        "_best_to_s",
        "_controller_s",
        "_end_s",
        "_local_s",
        "_option",
        "_parting",
        "_rose_s",
        "_simulated",
        "_still",
        "_waited_s",
        "fault",
    )

    def __init__(self, *, option: str = "", simulated: bool = False) -> None:
        """`simulated`: the controller's time is a simulation's, and may pass as fast as that
        computes. `option` names the setting for that, for messages about an unexpected clock."""
        self._option, self._simulated = option, simulated
        self.begin()

    def begin(self, controller_s: float = math.nan, local_s: float = math.nan) -> None:
        """Restart the comparison from a first state; without one, from the next on."""
        self.fault = ""
        self._controller_s, self._local_s = controller_s, local_s
        self._rose_s, self._still, self._waited_s = local_s, 0, 0.0
        self._compare(local_s)

    def _compare(self, local_s: float) -> None:
        """Forget earlier windows; the present one begins."""
        self._ahead_s = self._best_s = -math.inf
        self._ahead_to_s = self._best_to_s = local_s
        self._end_s = local_s + WINDOW_S
        self._parting = 0.0

    def heard(self, controller_s: float, local_s: float) -> None:
        """Take a state of `controller_s` that came at `local_s`."""
        step_s, waited_s = controller_s - self._controller_s, local_s - self._local_s
        ahead_s = controller_s - local_s
        if step_s > 0.0 and waited_s <= PAUSE_S and local_s < self._end_s:
            if ahead_s <= self._best_s:
                self._controller_s, self._local_s = controller_s, local_s
                self._rose_s, self._still, self._waited_s = local_s, 0, waited_s
                return
        elif math.isnan(self._controller_s):
            self.begin(controller_s, local_s)
            return
        self._controller_s, self._local_s = controller_s, local_s
        before_s, self._waited_s = self._waited_s, waited_s
        self._look(step_s, waited_s, before_s, ahead_s)

    def _look(self, step_s: float, waited_s: float, before_s: float, ahead_s: float) -> None:
        """Compare the clocks where something may be new; `before_s` was waited for the state before
        this one."""
        local_s = self._local_s
        if step_s < 0.0:
            self._note(f"went back by {-step_s:.3g} s: it was restarted, or its clock is wrong")
            return
        if step_s > 0.0:
            self._rose_s, self._still = local_s, 0
        else:
            self._still += 1
            if self._still >= _STILL_STATES and local_s - self._rose_s > PAUSE_S:
                self._note("stands still while states come")
                return
        # Of a first window it is not known how late its quickest state was.
        lead_s = ahead_s - max(self._best_s, self._ahead_s)
        beyond_s = step_s - waited_s * (SIMULATED_MOST if self._simulated else 1.0)
        if self._ahead_s > -math.inf and min(lead_s, 2.0 * beyond_s) > JUMP_S:
            self._note(f"jumped ahead by {step_s - waited_s:.3g} s")
            return
        if waited_s - step_s > PAUSE_S and waited_s > 2.0 * before_s:
            self._compare(local_s)
        if ahead_s > self._best_s:
            self._best_s, self._best_to_s = ahead_s, local_s
        if local_s >= self._end_s:
            self._end_window(local_s)

    def _end_window(self, local_s: float) -> None:
        """Compare the quickest states of this window and of the one before."""
        between_s = self._best_to_s - self._ahead_to_s
        gained_s = self._best_s - self._ahead_s
        if math.isfinite(gained_s):
            before, self._parting = self._parting, 0.0
            if abs(gained_s) > PARTED_SHARE * between_s + SLACK_S and not self._simulated:
                self._parting = gained_s
                if gained_s > JUMP_S or gained_s * before > 0.0:
                    speed = 1.0 + gained_s / between_s
                    said = _fault(f"runs {speed:.3g} times as fast as this computer's")
                    self.fault = self._advised(said)
            else:
                self.fault = ""
        self._ahead_s, self._ahead_to_s = self._best_s, self._best_to_s
        self._best_s, self._end_s = -math.inf, local_s + WINDOW_S

    def _advised(self, said: str) -> str:
        if not self._option:
            return said
        return f"{said}; where it is a simulation's, set {self._option} = true"

    def _note(self, what: str) -> None:
        self.fault = _fault(what)
        self._compare(self._local_s)


class AgreedTime(ClockWatch):
    """Time that has passed by a controller's clock and by this computer's: the smaller of the two,
    and SLACK_S at most beyond the latter."""

    __slots__ = ("_credit_s", "period_s", "time_s")

    def __init__(self, period_s: float, *, option: str = "", simulated: bool = False) -> None:
        self.period_s = period_s
        """Period between two states."""
        self.time_s = 0.0
        """Time that has passed."""
        super().__init__(option=option, simulated=simulated)

    def begin(self, controller_s: float = math.nan, local_s: float = math.nan) -> None:
        super().begin(controller_s, local_s)
        self._credit_s = SLACK_S

    def passed(self, controller_s: float, local_s: float, states: int = 1) -> float:
        """Time between the state before and one that came at `local_s`, which is the number
        `states` from that one on; s, 0 for the first."""
        step_s, waited_s = controller_s - self._controller_s, local_s - self._local_s
        first = math.isnan(step_s)
        self.heard(controller_s, local_s)
        return 0.0 if first else self._agree(step_s, waited_s, states)

    def counted(self, local_s: float, states: int = 1) -> float:
        """The same for a controller without a clock: the time of `states` periods."""
        waited_s = local_s - self._local_s
        super().begin(math.nan, local_s)
        return self._agree(states * self.period_s, waited_s, states)

    def _agree(self, step_s: float, waited_s: float, states: int) -> float:
        found_s, self._credit_s = believed_s(
            step_s, states * self.period_s, waited_s, self._credit_s
        )
        self.time_s += found_s
        return found_s


def _fault(what: str) -> str:
    return f"the controller's clock {what}"


class SlipCompensation:
    """The difference in place and speed between a robot and its commands, along some axes.

    Units are those of the axes, rad or m. `offset` and `rate` are added to the commands. For
    orientations a subclass overrides `_displacement` and `_advanced`.
    """

    __slots__ = (
        "_fastest",
        "_gap_s",
        "_interrupted",
        "_plan",
        "_rest_s",
        "_rested_s",
        "_slip",
        "_went",
        "offset",
        "rate",
        "working",
    )

    def __init__(self, axes: int) -> None:
        self._clear(axes)

    def _clear(self, axes: int) -> None:
        self.offset = [0.0] * axes
        """Distance by which the robot is ahead of its commands."""
        self.rate = [0.0] * axes
        """Speed in excess of its commands, per s."""
        self.working = False
        """False: there is no difference, and `step` need not be called."""
        self._interrupted = False
        self._gap_s = 0.0
        self._went = [0.0] * axes
        """Distance moved in the interruption beyond that of the commanded speed over `_gap_s`."""
        self._slip = [0.0] * axes
        """Speed in excess of the command before the interruption."""
        self._fastest = 0.0
        """Highest recent commanded speed, 0 once the robot has come to rest."""
        self._rested_s = 0.0
        """Time for which the command has rested."""
        self._rest_s = 0.0
        """Time after which the robot comes to rest."""
        self._plan: list[tuple[float, float, float]] = []
        """Of each axis what stays of the difference, the rest of it, and the rate, when it came to
        rest."""

    def reset(self) -> None:
        """Forget the difference: the robot is where it is commanded to be."""
        if self.working:
            self._clear(len(self.offset))

    def passed(self, gap_s: float, error: Sequence[float] = (), slip: Sequence[float] = ()) -> None:
        """`gap_s` have passed without a command, beyond the period that a command is for.

        The robot went on at the speed it had. By now it is off by `error` from where that would
        have brought it, and by `slip` faster. Empty: neither.
        """
        self.working = self._interrupted = True
        self._gap_s += gap_s
        went, slipped = self._went, self._slip
        for i, each in enumerate(slipped):
            went[i] += each * gap_s
        for i, each in enumerate(error):
            went[i] += each
        for i, each in enumerate(slip):
            slipped[i] += each

    def follow(
        self,
        asked: tuple[Any, Sequence[float] | None] | None,
        target: Any,
        speeds: Sequence[float] | None,
        dt_s: float,
        seen_s: float = 0.0,
    ) -> tuple[Any, Any]:
        """Return target and speeds for one period while `working`; `target` moves at `speeds`.

        `asked` is the target before with its speeds, None after anything else than a target.
        Where the speeds of either are not known, the difference is forgotten; `seen_s`, if above
        0, is then the time between the two targets, and gives the speeds.
        """
        if asked is None:
            self.reset()
            return target, speeds
        moved = self._displacement(asked[0], target)
        if speeds is None or asked[1] is None:
            self.reset()
            if speeds is None and seen_s > 0.0:
                speeds = [way / seen_s for way in moved]
            return target, speeds
        self.step(moved, asked[1], speeds, dt_s)
        return (
            self._advanced(target, self.offset),
            tuple([v + more for v, more in zip(speeds, self.rate, strict=True)]),
        )

    def _displacement(self, start: Any, end: Any) -> list[float]:
        """Displacement from one position to another, along the axes."""
        return [b - a for a, b in zip(start, end, strict=True)]

    def _advanced(self, place: Any, by: Sequence[float]) -> Any:
        """The position `by` ahead."""
        return tuple([q + way for q, way in zip(place, by, strict=True)])

    def step(
        self,
        moved: Sequence[float],
        before: Sequence[float],
        velocity: Sequence[float],
        dt_s: float,
    ) -> None:
        """Advance one period with a command that moves at `velocity`.

        It is `moved` from the command before it, which moved at `before`, both without what is
        added here.
        """
        if self._interrupted:
            self._resume(moved, before, velocity, dt_s)
            before = velocity
        offset, rate = self.offset, self.rate
        ahead = square = faster = size = 0.0
        for v, each, r in zip(velocity, offset, rate, strict=True):
            ahead += each * v
            square += v * v
            size += each * each
            faster += r * (v + 0.5 * r)
        if square < NOTHING * NOTHING:
            self._rest(before, dt_s)
            return
        if self._rested_s:
            self._rested_s = self._fastest = 0.0
        self._fastest = max(self._fastest * (1.0 - min(dt_s / RECENT_S, 1.0)), math.sqrt(square))
        back = 0.0
        if ahead > 0.0:
            back = -min(1.0 / WORK_OFF_S, WORK_OFF_SHARE * math.sqrt(square / size))
        share = min(dt_s / SLOW_DOWN_S, 1.0)
        if faster <= 0.0:
            slower = gain = 0.0
            for v, each, r in zip(velocity, offset, rate, strict=True):
                more = back * each - r
                slower += more * more
                gain += more * v
            share = dt_s / SPEED_UP_S
            if gain > 0.0:
                share *= math.sqrt(square / slower)
            share = min(share, 1.0)
        left = False
        for i, (each, v, was, r) in enumerate(zip(offset, velocity, before, rate, strict=True)):
            # The robot's speed moves towards its aim and never away from it: a robot that stands
            # while its command brakes would otherwise be moved back.
            low, high = was + r, v + back * each
            if low > high:
                low, high = high, low
            speed = v + r + share * (back * each - r)
            if speed < low:
                speed = low
            if speed > high:
                speed = high
            rate[i] = r = speed - v
            offset[i] = each = each + r * dt_s
            if not (-NOTHING <= each <= NOTHING and -NOTHING <= r <= NOTHING):
                left = True
        if not left:
            self.reset()

    def _rest(self, before: Sequence[float], dt_s: float) -> None:
        """Advance one period in which the command rests, having moved at `before`."""
        offset, rate = self.offset, self.rate
        if self._rested_s == 0.0:
            self._plan_rest(before)
        self._rested_s += dt_s
        rest_s = self._rest_s
        part = min(self._rested_s / rest_s, 1.0)
        left = (1.0 - part) ** 2
        for i, (stays, way, speed) in enumerate(self._plan):
            each = stays + left * ((1.0 + 2.0 * part) * way + part * rest_s * speed)
            rate[i], offset[i] = (each - offset[i]) / dt_s, each
        if part == 1.0:
            self._fastest = 0.0
            if not any(rate) and all(abs(each) <= NOTHING for each in offset):
                self.reset()

    def _plan_rest(self, before: Sequence[float]) -> None:
        """How the robot comes to rest: by a cubic in time, which begins and ends hardest."""
        size = math.hypot(*self.offset)
        hardest = max(self._fastest / SLOW_DOWN_S, NOTHING)
        self._rest_s = time_s = min(max(REST_S, math.sqrt(6.0 * size / hardest)), LONGEST_REST_S)
        share = min(hardest * time_s**2 / 6.0 / size, 1.0) if self._fastest * size > 0.0 else 0.0
        self._plan = plan = []
        for each, more, v in zip(self.offset, self.rate, before, strict=True):
            # A robot that stands while its command brakes is not moved back.
            robot = v + more
            speed = min(max(more, min(robot, 0.0)), max(robot, 0.0))
            way, brakes = share * each, -speed * time_s / 3.0
            if way * brakes > 0.0 and abs(brakes) > abs(way):
                way = brakes  # It would turn back.
            plan.append((each - way, way, speed))

    def _resume(
        self,
        moved: Sequence[float],
        before: Sequence[float],
        velocity: Sequence[float],
        dt_s: float,
    ) -> None:
        """Take the interruption into account, less what the command itself has moved."""
        offset, rate, went, slip = self.offset, self.rate, self._went, self._slip
        for i, way in enumerate(moved):
            robot = (before[i] + rate[i]) * self._gap_s + went[i]
            offset[i] += robot - (way - velocity[i] * dt_s)
            rate[i] += slip[i] + before[i] - velocity[i]
            went[i] = slip[i] = 0.0
        self._interrupted, self._gap_s, self._rested_s = False, 0.0, 0.0
        self._fastest = max(self._fastest, math.hypot(*before))
