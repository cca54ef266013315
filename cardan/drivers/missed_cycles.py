"""Handling of missed cycles: time in which a robot got no commands is never made up for.

While a process is suspended, or datagrams are lost, most controllers continue at the last commanded
speed. The next command then differs from the robot's position: it is behind, if the application
continued from its last command, or ahead, if the robot slowed down. Sent directly it would cause a
jerk, and a robot that made up for lost time would be faster than commanded.

The difference is therefore kept, and added to every command. A robot ahead of its command is slowed
a little until it is not; a robot behind stays behind until it rests. When the command has come to
rest, the robot completes its way at once, no faster than it was commanded, and the part that would
take longer than `LONGEST_REST_S` remains.

The elapsed time never depends on the controller alone: `AgreedTime` counts the time that passed by
both its clock and this computer's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

WORK_OFF_S: Final = 0.5
"""Time constant of the decay of a position difference in motion: 6 mm, the loss of 60 ms at 100
mm/s, at 12 mm/s."""

WORK_OFF_SHARE: Final = 0.5
"""Largest share of the commanded speed by which that slows the robot."""

REST_S: Final = 0.2
"""Time from the command's rest to the robot's: 6 mm at 45 mm/s at most, and 0.9 m/s²."""

LONGEST_REST_S: Final = 0.27
"""The same after a loss of more than 67 ms, longer so that it is no harder: a robot that had
stopped is 0.125 s behind once it is up to speed."""

RECENT_S: Final = 5.0
"""Time constant of forgetting the highest commanded speed."""

SPEED_UP_S: Final = 0.25
"""Time in which a robot that has stopped by itself is up to speed: 250 mm/s at 1 m/s²."""

SLOW_DOWN_S: Final = 0.1
"""Time constant of slowing a robot that is faster than commanded: from 100 mm/s at 1 m/s²."""

JUMP_SHARE: Final = 0.5
"""Share of a period's way beyond which a command jumps: a smaller step is inaccuracy."""

NOTHING: Final = 1e-7
"""Smallest difference that counts: m, rad, and per s."""


SLACK_S: Final = 0.001
"""Longest advance of a robot in one step beyond the time on this computer's clock: the arrival
jitter of an idle computer. At 0.5 rad/s it is 0.5 mrad."""

PARTED_SHARE: Final = 0.02
"""Difference in rate at which two clocks count as diverged: quartzes differ by 0.0001."""

WINDOW_S: Final = 0.5
"""Window over which clocks are compared, by the states with the least delay in it."""

JUMP_S: Final = 0.05
"""Lead of a clock over the least delayed arrival of a window that no delay explains."""

SIMULATED_MOST: Final = 10.0
"""Largest rate of simulated time; a larger step between two states is a jump."""

PAUSE_S: Final = 0.1
"""Longest lag of the controller's time behind local time that delayed states may still make up for.
A clock that loses more between two states of a faster stream was stopped with its controller: the
comparison restarts. A clock that shows the same time for this long, while states come, stands
still."""

_STILL_STATES = 2
"""Further states with the same time that are required for that."""

SIMULATED_TIME: Final = "simulated_time"
"""Option of drivers whose controller may be a simulation."""


def believed_s(
    step_s: float, due_s: float, waited_s: float, credit_s: float
) -> tuple[float, float]:
    """Return the accepted time between two states, `step_s` by the controller's clock, and the new
    credit.

    They arrived `waited_s` apart, and `due_s` is the nominal time of that many states. Delayed
    states arrive faster, and use up `credit_s`: local time not yet counted by the controller; it
    starts at SLACK_S. cardan/drivers/abb_egm/kernel/take.c has the same.
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
    """Comparison of a controller's clock with the local one; `fault` describes any fault.

    Delays are no fault: a state may come late, several may come at once, and either computer may
    pause. Therefore only the least delayed state of each window counts, and a small difference must
    show in two windows.
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
        """Set `simulated` for a simulation's time, which may pass as fast as it computes. `option`
        names that setting in messages about an unexpected clock."""
        self._option, self._simulated = option, simulated
        self.begin()

    def begin(self, controller_s: float = math.nan, local_s: float = math.nan) -> None:
        """Restart the comparison from a first state, or from the next one."""
        self.fault = ""
        self._controller_s, self._local_s = controller_s, local_s
        self._rose_s, self._still, self._waited_s = local_s, 0, 0.0
        self._compare(local_s)

    def _compare(self, local_s: float) -> None:
        """Discard earlier windows and begin a new one."""
        self._ahead_s = self._best_s = -math.inf
        self._ahead_to_s = self._best_to_s = local_s
        self._end_s = local_s + WINDOW_S
        self._parting = 0.0

    def heard(self, controller_s: float, local_s: float) -> None:
        """Process a state of time `controller_s` that arrived at `local_s`."""
        step_s, waited_s = controller_s - self._controller_s, local_s - self._local_s
        if math.isnan(step_s):
            self.begin(controller_s, local_s)
            return
        ahead_s = controller_s - local_s
        self._controller_s, self._local_s = controller_s, local_s
        before_s, self._waited_s = self._waited_s, waited_s
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
        # In a first window the delay of its least delayed state is unknown.
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
        """Compare the least delayed states of this window and the previous one."""
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
    """Time that has passed by both a controller's clock and this computer's: the smaller of the
    two, and at most SLACK_S more than the latter."""

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
        """Return the time since the previous state for a state that arrived at `local_s` as the
        `states`-th after it, s; 0 for the first."""
        step_s, waited_s = controller_s - self._controller_s, local_s - self._local_s
        first = math.isnan(step_s)
        self.heard(controller_s, local_s)
        return 0.0 if first else self._agree(step_s, waited_s, states)

    def counted(self, local_s: float, states: int = 1) -> float:
        """Return the same for a controller without a clock: the time of `states` periods."""
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
    """Position and speed difference of a robot from its commands, along some axes.

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
        "resumed",
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
        self.resumed = False
        """True after the first command since an interruption: the next may jump to the robot."""
        self._interrupted = False
        self._gap_s = 0.0
        self._went = [0.0] * axes
        """Distance moved during the interruption beyond that of the commanded speed over
        `_gap_s`."""
        self._slip = [0.0] * axes
        """Speed in excess of the command before the interruption."""
        self._fastest = 0.0
        """Highest recent commanded speed, 0 once the robot has come to rest."""
        self._rested_s = 0.0
        """Time for which the command has rested."""
        self._rest_s = 0.0
        """Time after which the robot comes to rest."""
        self._plan: list[tuple[float, float, float]] = []
        """Per axis at the begin of the rest: the remaining difference, the part to move, and the
        rate."""

    def reset(self) -> None:
        """Discard the difference: the robot is at its commanded position."""
        if self.working:
            self._clear(len(self.offset))

    def passed(self, gap_s: float, error: Sequence[float] = (), slip: Sequence[float] = ()) -> None:
        """Record a gap of `gap_s` without a command, beyond the period of a command.

        The robot is now off by `error` from where its speed would have brought it, and faster by
        `slip`. Empty: neither.
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

        `asked` is the previous target with its speeds, None after any other command. If either's
        speeds are unknown, the difference is discarded; a `seen_s` above 0 is then the time between
        the two targets, from which the speeds follow.
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
        """Return the position displaced by `by`."""
        return tuple([q + way for q, way in zip(place, by, strict=True)])

    def step(
        self,
        moved: Sequence[float],
        before: Sequence[float],
        velocity: Sequence[float],
        dt_s: float,
    ) -> None:
        """Advance one period with a command that moves at `velocity`.

        It is `moved` from the previous command, which moved at `before`, both without compensation.
        """
        if self._interrupted:
            self._resume(moved, before, velocity, dt_s)
            before = velocity
            self.resumed = True
        elif self.resumed:
            self.resumed = False
            if not self._rested_s:
                self._rejoin(moved, before, velocity, dt_s)
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
            # The robot's speed changes towards its goal only: a robot that stands while its command
            # brakes would otherwise move back.
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
        """Plan how the robot comes to rest: by a cubic in time, with the highest acceleration at
        both ends."""
        size = math.hypot(*self.offset)
        hardest = max(self._fastest / SLOW_DOWN_S, NOTHING)
        self._rest_s = time_s = min(max(REST_S, math.sqrt(6.0 * size / hardest)), LONGEST_REST_S)
        share = min(hardest * time_s**2 / 6.0 / size, 1.0) if self._fastest * size > 0.0 else 0.0
        self._plan = plan = []
        for each, more, v in zip(self.offset, self.rate, before, strict=True):
            # A robot that stands while its command brakes does not move back.
            robot = v + more
            speed = min(max(more, min(robot, 0.0)), max(robot, 0.0))
            way, brakes = share * each, -speed * time_s / 3.0
            if way * brakes > 0.0 and abs(brakes) > abs(way):
                way = brakes  # It would reverse.
            plan.append((each - way, way, speed))

    def _rejoin(
        self,
        moved: Sequence[float],
        before: Sequence[float],
        velocity: Sequence[float],
        dt_s: float,
    ) -> None:
        """Take off the difference what the command makes up for by a jump: the robot is there
        already. An application that answered late learns only by its next state that the robot went
        on, or stopped, without it."""
        offset = self.offset
        jumps = []
        size = after = jump = period = 0.0
        for each, way, was, v in zip(offset, moved, before, velocity, strict=True):
            low, high = (was, v) if was < v else (v, was)
            by = way - min(max(way, low * dt_s), high * dt_s)
            jumps.append(by)
            size += each * each
            after += (each - by) * (each - by)
            jump += by * by
            period += max(low * low, high * high) * dt_s * dt_s
        if after < size and jump > JUMP_SHARE * JUMP_SHARE * period:
            for i, by in enumerate(jumps):
                offset[i] -= by

    def _resume(
        self,
        moved: Sequence[float],
        before: Sequence[float],
        velocity: Sequence[float],
        dt_s: float,
    ) -> None:
        """Add the interruption's difference, less the command's own motion."""
        offset, rate, went, slip = self.offset, self.rate, self._went, self._slip
        for i, way in enumerate(moved):
            robot = (before[i] + rate[i]) * self._gap_s + went[i]
            offset[i] += robot - (way - velocity[i] * dt_s)
            rate[i] += slip[i] + before[i] - velocity[i]
            went[i] = slip[i] = 0.0
        self._interrupted, self._gap_s, self._rested_s = False, 0.0, 0.0
        self._fastest = max(self._fastest, math.hypot(*before))
