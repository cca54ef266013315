"""Scripted hands: an operator's motions of the simulated stylus, as waypoints for the library. The
library plays waypoints without Python in its ticks, so a script is planned completely before it
starts."""

from __future__ import annotations

import bisect
import heapq
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from cardan.errors import ScriptError
from cardan.sim_peers.base import ScriptStep, load_script
from cardan.sim_peers.scripted import StepWords
from cardan.spatial import from_euler_zyx, to_euler_zyx
from cardan.types import ZERO3, Vector3
from cardan_omni.peer.settings import INKWELL_M, HandMotion, Waypoint
from cardan_omni.protocol import rotation_to_device, to_device, to_hand

SAMPLE_S = 0.01
"""Spacing of waypoints while the hand moves."""
SHORTEST_S = 0.02
"""Shortest motion: the hand is a spring, so a step would be a shock."""
CLICK_S = 0.1
USUAL_STIFFNESS_N_M = 200.0

_TIME_DECIMALS = 4
_PACES = {"move": 0.1, "turn": math.pi / 2.0, "push": 2.0, "stiffness": 1000.0}
"""Mean speeds of motions without ``over``: m/s, rad/s, N/s, N/m per s."""
_SHORTEST_DEFAULT_S = 0.3

SCRIPT_VERBS: Mapping[str, str] = {
    "move": "move X Y Z [over SECONDS] (go there, without a jerk; without over at 0.1 m/s)",
    "turn": (
        "turn RX RY RZ [over SECONDS] (turn the stylus, about the fixed axes x, y, z in turn)"
    ),
    "swing": ("swing X Y Z [RX RY RZ] over SECONDS [times N] (add N sine periods of SECONDS each)"),
    "circle": (
        "circle X Y over SECONDS [times N] (round a center that lies X, Y from here, "
        "counterclockwise from above)"
    ),
    "draw": (
        "draw X Y [X Y ...] over SECONDS (straight strokes through these points, at this height)"
    ),
    "push": "push FX FY FZ [over SECONDS] (a force beside the hand's spring)",
    "stiffness": "stiffness KX KY KZ [over SECONDS] (of that spring; 0: free along that axis)",
    "grip": "grip on|off (let go; grip again)",
    "press": "press 1|2 (a button)",
    "release": "release 1|2 (let go of a button)",
    "click": "click 1|2 (press and release a button, within 0.1 s)",
    "dock": "dock [over SECONDS] (into the inkwell; at 0 s it is there from the start)",
    "undock": "undock (out of it)",
    "loop": "loop (the last step: start again; the hand must be as it was at the start)",
}
"""Usage of each verb of a script. Axes of the hand: X forward, Y left, Z up, from the device's
origin, m; turns about the fixed axes x, y, z one after the other, degrees; N; N/m.

``move``, ``turn``, ``push`` and ``stiffness`` change smoothly, slowly without ``over``; ``draw``
goes through a list of points at the present height, with a stop at each; ``circle`` goes round a
center that lies X, Y from here, counterclockwise seen from above; ``swing`` adds N sine periods of
SECONDS each on top. ``push`` is a force in addition to the hand's spring, which ``stiffness 200 200
0`` leaves free to go up and down. ``click`` presses for 0.1 s. ``dock`` moves into the inkwell; at
0 s the stylus starts there; ``loop`` starts the script again, which must end as it began.
"""

SCRIPTS: Mapping[str, str] = {
    "rest": """
        # a hand holds the stylus still
        0.0   grip on
    """,
    "demo": """
        # 26 s: button 2 to follow, about the workspace, out, back elsewhere, in again
        2.0   click 2                                  # follow
        3.0   swing 0.025 0 0 over 3                   # forward and back
        6.2   swing 0 0.04 0 over 3                    # left and back
        9.4   swing 0 0 0.04 over 2.6                  # up and down
        12.2  swing 0 0 0 25 0 0 over 2.4              # roll
        14.8  swing 0 0 0 0 20 30 over 2.4             # pitch and yaw
        17.4  move 0.02 -0.03 0.02 over 1.2
        18.8  click 2                                  # stop and hold
        19.2  move 0.02 0.03 0.02 over 1.2             # the hand alone
        20.8  click 2                                  # follow again: no jump
        21.2  move 0 0.06 0 over 1.2                   # back by as much as before
        22.8  click 1                                  # the reference anew
        23.2  swing 0.015 0.015 0 over 1.6
        25.2  click 2
    """,
    "drawing": """
        # 38 s: a square of 60 mm and a circle in it, pressed onto a surface 20 mm below
        0.5   stiffness 300 300 300
        2.0   click 2                                  # follow
        2.5   move 0.03 0.03 0 over 1.5                # over the first corner
        4.2   move 0.03 0.03 -0.017 over 1.5           # down, nearly
        6.0   stiffness 300 300 0 over 0.3             # free to be held up
        6.0   push 0 0 -0.7 over 1                       # press
        8.0   draw -0.03 0.03 -0.03 -0.03 0.03 -0.03 0.03 0.03 over 12
        20.5  push 0 0 0 over 0.5                      # lift
        20.5  stiffness 300 300 300 over 0.5
        21.1  move 0.03 0.03 0 over 0.8
        22.0  move 0.02 0 0 over 1
        23.2  move 0.02 0 -0.017 over 1.5
        25.0  stiffness 300 300 0 over 0.3
        25.0  push 0 0 -0.7 over 1
        27.0  circle -0.02 0 over 7
        34.5  push 0 0 0 over 0.5
        34.5  stiffness 300 300 300 over 0.5
        35.1  move 0.02 0 0 over 0.8
        36.0  move 0 0 0 over 1
        37.5  click 2                                  # stop and hold
    """,
    "contact": """
        # 16 s: follow, forward against whatever is there, press, back; twice
        0.5   move -0.03 0 0
        2.0   click 2
        3.0   move 0.03 0 0 over 2
        5.0   push 1 0 0 over 0.5
        6.5   push 0 0 0 over 0.5
        7.0   move -0.03 0 0 over 2
        9.5   move 0.03 0 0 over 1
        11.5  move -0.03 0 0 over 1
        13.0  click 2
        15.0  move 0 0 0
    """,
    "presses": """
        # 9 s, again and again: holds button 2, forward against whatever is there, press, back
        1.0   press 2                                  # follow
        1.5   move 0.03 0 0 over 2
        3.5   push 1.5 0 0 over 0.5
        5.5   push 0 0 0 over 0.5
        6.0   move 0 0 0 over 1.5
        7.8   release 2                                # stop and hold
        9.0   loop
    """,
    "let-go": """
        # 12 s: the hand throws the stylus and takes it again
        2.0   click 2
        3.0   move 0 0.04 0 over 1
        4.5   move 0 -0.04 0 over 0.35
        4.68  grip off
        5.5   move 0 0 0 over 0.5
        8.0   grip on
        10.0  click 2
    """,
    "inkwell": """
        # 14 s: in the inkwell from the start, taken out, moved about, put back
        0.0   dock
        3.0   undock
        3.0   move 0 0 0 over 1.5
        5.5   click 2
        6.0   swing 0.02 0.02 0.02 over 2
        8.5   click 2
        9.0   dock over 1.5
    """,
}
"""Built-in scripts, within the usable workspace of 70 x 160 x 120 mm."""


class _Quintic(NamedTuple):
    """Polynomial from a state of motion to rest, without a jump of position, speed or acceleration;
    from rest to rest it is the motion of least jerk."""

    start_s: float
    over_s: float
    coefficients: tuple[tuple[float, ...], ...]
    goal: tuple[float, ...]

    def at(self, time_s: float) -> tuple[list[float], list[float], list[float]]:
        """Return position, speed and acceleration."""
        t = time_s - self.start_s
        if t >= self.over_s:
            return list(self.goal), [0.0] * len(self.goal), [0.0] * len(self.goal)
        positions, speeds, accelerations = [], [], []
        for a, b, c, d, e, f in self.coefficients:
            positions.append(a + t * (b + t * (c + t * (d + t * (e + t * f)))))
            speeds.append(b + t * (2 * c + t * (3 * d + t * (4 * e + t * 5 * f))))
            accelerations.append(2 * c + t * (6 * d + t * (12 * e + t * 20 * f)))
        return positions, speeds, accelerations


class _Track:
    """Vector as a function of time: at rest, or on its way to the latest goal."""

    def __init__(self, rest: Sequence[float]) -> None:
        self._ways = [_Quintic(0.0, 0.0, (), tuple(rest))]

    def at(self, time_s: float) -> tuple[float, ...]:
        return tuple(self._way(time_s).at(time_s)[0])

    def go(self, start_s: float, goal: Sequence[float], over_s: float) -> None:
        """Move from the position at `start_s` to a goal; later goals are dropped."""
        states = self._way(start_s).at(start_s)
        while self._ways and self._ways[-1].start_s >= start_s:
            self._ways.pop()
        coefficients = tuple(
            _to_rest(p, v, a, end, over_s) for p, v, a, end in zip(*states, goal, strict=True)
        )
        self._ways.append(_Quintic(start_s, over_s, coefficients, tuple(goal)))

    def intervals(self) -> Iterator[tuple[float, float]]:
        """Yield the intervals of motion, s."""
        starts_s = [way.start_s for way in self._ways[1:]] + [math.inf]
        for way, next_s in zip(self._ways, starts_s, strict=True):
            yield way.start_s, min(way.start_s + way.over_s, next_s)

    def _way(self, time_s: float) -> _Quintic:
        index = bisect.bisect_right(self._ways, time_s, key=lambda way: way.start_s)
        return self._ways[max(0, index - 1)]


def _to_rest(p: float, v: float, a: float, end: float, over_s: float) -> tuple[float, ...]:
    t = over_s
    way = end - p - v * t - 0.5 * a * t * t
    speed = -v - a * t
    return (
        p,
        v,
        0.5 * a,
        (10.0 * way - 4.0 * speed * t - 0.5 * a * t * t) / t**3,
        (-15.0 * way + 7.0 * speed * t + a * t * t) / t**4,
        (6.0 * way - 3.0 * speed * t - 0.5 * a * t * t) / t**5,
    )


class _Overlay(NamedTuple):
    """Motion superposed on the others that ends at its start."""

    start_s: float
    over_s: float
    shape: Callable[[float], tuple[float, ...]]
    """Position, m, and angles, rad, at this share of its duration."""

    def at(self, time_s: float) -> tuple[float, ...]:
        share = (time_s - self.start_s) / self.over_s
        return self.shape(share) if 0.0 < share < 1.0 else (0.0,) * 6


def _smooth(share: float) -> float:
    """Return a smooth value from 0 to 1 with the least jerk."""
    share = min(max(share, 0.0), 1.0)
    return share**3 * (10.0 - share * (15.0 - 6.0 * share))


class _Flags(NamedTuple):
    gripped: bool = True
    buttons: int = 0
    docked: bool = False


class _Hand:
    """The hand's motion by the steps of a script, axes of the hand."""

    def __init__(self, stiffness_n_m: float) -> None:
        self.tracks = {
            "move": _Track(ZERO3),
            "turn": _Track(ZERO3),
            "push": _Track(ZERO3),
            "stiffness": _Track((stiffness_n_m,) * 3),
        }
        self.overlays: list[_Overlay] = []
        self.flags: list[tuple[float, _Flags]] = [(0.0, _Flags())]
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._planned = 0

    def plan(self, time_s: float, action: Callable[[], None]) -> None:
        """Schedule `action` at `time_s`, after those planned earlier for that time."""
        self._planned += 1
        heapq.heappush(self._due, (_rounded(time_s), self._planned, action))

    def play(self) -> None:
        """Execute all actions in the order of time: each depends on the state that the previous
        ones reached."""
        while self._due:
            heapq.heappop(self._due)[2]()

    def go(self, verb: str, start_s: float, goal: Sequence[float], over_s: float | None) -> None:
        track = self.tracks[verb]
        if over_s is None:
            over_s = max(_SHORTEST_DEFAULT_S, math.dist(track.at(start_s), goal) / _PACES[verb])
        track.go(start_s, goal, over_s)

    def draw(self, start_s: float, points: Sequence[tuple[float, float]], over_s: float) -> None:
        x, y, z = self.tracks["move"].at(start_s)
        corners = [(x, y), *points]
        lengths = [math.dist(a, b) for a, b in zip(corners, points, strict=False)]
        whole = sum(lengths) or 1.0
        for point, length in zip(points, lengths, strict=True):
            if length:
                part_s = max(over_s * length / whole, SHORTEST_S)
                self.go("move", start_s, (*point, z), part_s)
                start_s = _rounded(start_s + part_s)

    def dock(self, start_s: float, over_s: float | None) -> None:
        there = to_hand(INKWELL_M)
        if start_s == 0.0:
            self.tracks["move"] = _Track(there)
            self.plan_flags(0.0, docked=True)
            return
        if over_s is None:
            way_m = math.dist(self.tracks["move"].at(start_s), there)
            over_s = max(_SHORTEST_DEFAULT_S, way_m / _PACES["move"])
        self.go("move", start_s, there, over_s)
        self.go("turn", start_s, ZERO3, over_s)
        self.plan_flags(start_s + over_s, docked=True)

    def plan_flags(self, time_s: float, **flags: bool) -> None:
        """Set flags at `time_s`."""
        time_s = _rounded(time_s)
        self.plan(time_s, lambda: self._set(time_s, self.flags[-1][1]._replace(**flags)))

    def plan_buttons(self, time_s: float, pressed: int = 0, released: int = 0) -> None:
        """Press and release buttons, by their bits, at `time_s`."""
        time_s = _rounded(time_s)

        def change() -> None:
            flags = self.flags[-1][1]
            self._set(time_s, flags._replace(buttons=flags.buttons & ~released | pressed))

        self.plan(time_s, change)

    def _set(self, time_s: float, flags: _Flags) -> None:
        self.flags.append((time_s, flags))

    def times_s(self) -> set[float]:
        """Return the times that need a waypoint, s."""
        intervals = [each for track in self.tracks.values() for each in track.intervals()]
        intervals += [(each.start_s, each.start_s + each.over_s) for each in self.overlays]
        times_s = {time_s for time_s, _ in self.flags}
        for start_s, end_s in intervals:
            samples = max(1, math.ceil((end_s - start_s) / SAMPLE_S - 1e-6))
            times_s |= {
                _rounded(start_s + (end_s - start_s) * index / samples)
                for index in range(samples + 1)
            }
        return times_s

    def waypoint(self, time_s: float, before: Waypoint | None) -> Waypoint:
        """Return the hand at `time_s`, in the device frame; its angles continue from those
        `before`."""
        placed = [*self.tracks["move"].at(time_s), *self.tracks["turn"].at(time_s)]
        for overlay in self.overlays:
            placed = [a + b for a, b in zip(placed, overlay.at(time_s), strict=True)]
        angles = to_euler_zyx(rotation_to_device(from_euler_zyx(*placed[3:])))
        if before is not None:
            angles = Vector3(*map(_nearest_turn, angles, before.turn_rad))
        index = bisect.bisect_right(self.flags, time_s, key=lambda timed: timed[0])
        kx, ky, kz = self.tracks["stiffness"].at(time_s)
        return Waypoint(
            time_s,
            to_device(placed[:3]),
            angles,
            *self.flags[index - 1][1],
            to_device(self.tracks["push"].at(time_s)),
            # The same axes, but stiffness has no sign; changed again during a change, it may
            # overshoot.
            Vector3(max(ky, 0.0), max(kz, 0.0), max(kx, 0.0)),
        )


def compile_script(
    steps: Iterable[ScriptStep], stiffness_n_m: float = USUAL_STIFFNESS_N_M
) -> HandMotion:
    """Return a script's steps as waypoints; the hand begins gripping, at the origin.

    `stiffness_n_m` is the hand's until the script says otherwise. Raises ScriptError, naming the
    step, for arguments that its verb does not take.
    """
    hand = _Hand(stiffness_n_m)
    loop: StepWords | None = None
    for step in steps:
        words = StepWords(step, SCRIPT_VERBS)
        if loop is not None:
            raise loop.error("must be the last step, after 0 s")
        if step.verb == "loop":
            loop = words
            if step.time_s <= 0.0:
                raise words.error("must be the last step, after 0 s")
        else:
            _read(words, hand)
        words.end()
    hand.play()
    loop_s = None if loop is None else _rounded(loop.time_s)
    times_s = hand.times_s() | ({0.0} if loop_s is None else {0.0, loop_s})
    waypoints: list[Waypoint] = []
    for time_s in sorted(times_s):
        if loop_s is None or time_s <= loop_s:
            waypoints.append(hand.waypoint(time_s, waypoints[-1] if waypoints else None))
    for waypoint in waypoints:
        if max(map(abs, waypoint.position_m)) > 2.0 * _REACH_M:
            raise ScriptError(f"{waypoint.time_s:g} s: the hand is more than 0.5 m away")
    if loop is not None and not _alike(waypoints[0], waypoints[-1]):
        raise loop.error("the hand must be as it was at the start, and at rest, to start again")
    return HandMotion(tuple(waypoints), loop_s)


def load_motion(name_or_file: str, stiffness_n_m: float = USUAL_STIFFNESS_N_M) -> HandMotion:
    """Return the waypoints of a built-in script or of one in a file."""
    return compile_script(load_script(name_or_file, SCRIPTS, SCRIPT_VERBS), stiffness_n_m)


def _read(words: StepWords, hand: _Hand) -> None:
    """Plan the motion of a step by its words."""
    verb, start_s = words.verb, _rounded(words.time_s)
    if verb in hand.tracks:
        goal = _goal(words)
        over_s = _over(words)
        hand.plan(start_s, lambda: hand.go(verb, start_s, goal, over_s))
    elif verb == "draw":
        points = [_point(words)]
        while words.left[:1] not in ([], ["over"]):
            points.append(_point(words))
        words.needs("over")
        whole_s = words.number("SECONDS", SHORTEST_S)
        hand.plan(start_s, lambda: hand.draw(start_s, points, whole_s))
    elif verb in ("swing", "circle"):
        hand.overlays.append((_swing if verb == "swing" else _circle)(words, start_s))
    elif verb == "grip":
        gripped = words.word("on|off")
        if gripped not in ("on", "off"):
            raise words.error(f"{gripped!r} must be on or off; usage: {words.usage}")
        hand.plan_flags(start_s, gripped=gripped == "on")
    elif verb == "undock":
        hand.plan_flags(start_s, docked=False)
    elif verb == "dock":
        over_s = _over(words)
        hand.plan(start_s, lambda: hand.dock(start_s, over_s))
    else:
        button = words.word("1|2")
        if button not in ("1", "2"):
            raise words.error(f"{button!r} must be 1 or 2; usage: {words.usage}")
        bit = int(button)
        if verb != "release":
            hand.plan_buttons(start_s, pressed=bit)
        if verb != "press":
            hand.plan_buttons(start_s + CLICK_S * (verb == "click"), released=bit)


_REACH_M = 0.25


def _point(words: StepWords) -> tuple[float, float]:
    x, y = words.numbers(("X", "Y"), -_REACH_M, _REACH_M)
    return x, y


def _goal(words: StepWords) -> tuple[float, ...]:
    if words.verb == "move":
        return words.numbers(("X", "Y", "Z"), -_REACH_M, _REACH_M)
    if words.verb == "turn":
        return _angles(words)
    if words.verb == "push":
        return words.numbers(("FX", "FY", "FZ"), -20.0, 20.0)
    return words.numbers(("KX", "KY", "KZ"), 0.0, 2000.0)


def _angles(words: StepWords) -> tuple[float, ...]:
    return tuple(map(math.radians, words.numbers(("RX", "RY", "RZ"), -80.0, 80.0)))


def _over(words: StepWords) -> float | None:
    return words.number("SECONDS", SHORTEST_S) if words.keyword("over") else None


def _swing(words: StepWords, start_s: float) -> _Overlay:
    position = words.numbers(("X", "Y", "Z"), -_REACH_M, _REACH_M)
    angles = (0.0, 0.0, 0.0) if words.left[:1] in ([], ["over"]) else _angles(words)
    period_s, times = _periods(words)

    def shape(share: float) -> tuple[float, ...]:
        # The first and the last quarter of a period begin and end at rest.
        periods = share * times
        gain = _smooth(4.0 * periods) * _smooth(4.0 * (times - periods))
        sine = gain * math.sin(math.tau * periods)
        return tuple(amplitude * sine for amplitude in (*position, *angles))

    return _Overlay(start_s, period_s * times, shape)


def _circle(words: StepWords, start_s: float) -> _Overlay:
    x, y = words.numbers(("X", "Y"), -_REACH_M, _REACH_M)
    period_s, times = _periods(words)

    def shape(share: float) -> tuple[float, ...]:
        turn = math.tau * times * _smooth(share)
        sine, cosine = math.sin(turn), math.cos(turn)
        return (x - x * cosine + y * sine, y - x * sine - y * cosine, 0.0, 0.0, 0.0, 0.0)

    return _Overlay(start_s, period_s * times, shape)


def _periods(words: StepWords) -> tuple[float, int]:
    words.needs("over")
    period_s = words.number("SECONDS", SHORTEST_S)
    return period_s, int(words.number("N", 1.0, 1000.0)) if words.keyword("times") else 1


def _rounded(time_s: float) -> float:
    return round(time_s, _TIME_DECIMALS)


def _nearest_turn(angle: float, before: float) -> float:
    return angle + math.tau * round((before - angle) / math.tau)


def _alike(a: Waypoint, b: Waypoint) -> bool:
    numbers_a, numbers_b = (
        (*each.position_m, *each.turn_rad, *each.push_n, *each.stiffness_n_m) for each in (a, b)
    )
    return (a.gripped, a.buttons, a.docked) == (b.gripped, b.buttons, b.docked) and all(
        abs(x - y) < 1e-6 for x, y in zip(numbers_a, numbers_b, strict=True)
    )
