"""URScript's functions that move the arm."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from cardan.common.bounds import Range
from cardan.sim_peers.ur_controller.arguments import number
from cardan.sim_peers.ur_controller.language import Function
from cardan.sim_peers.ur_controller.servo import ServoJ, SpeedJ, StopJ

LOOKAHEAD_S: Final = Range(0.03, 0.2, "s", "the script manual allows no other")
GAIN: Final = Range(100, 2000, "", "the script manual allows no other")

_JOINTS: Final = 6


def functions(
    actual_q: Callable[[], Sequence[float]],
    target_q: Callable[[], Sequence[float]],
) -> Mapping[str, Function]:
    """By name."""

    def servoj(q: Any, a: Any, v: Any, t: Any, lookahead_time: Any, gain: Any) -> ServoJ:
        for name, value, allowed in (
            ("lookahead_time", lookahead_time, LOOKAHEAD_S),
            ("gain", gain, GAIN),
        ):
            if value not in allowed:
                raise ValueError(f"{name} {value!r} is not {allowed}")
        return ServoJ(_joints("q", q), _time(t), float(lookahead_time))

    def speedj(qd: Any, a: Any, t: Any) -> SpeedJ:
        return SpeedJ(_joints("qd", qd), _above_zero("a", a), _time(t))

    return {
        "get_actual_joint_positions": Function((), {}, lambda: list(actual_q())),
        "get_target_joint_positions": Function((), {}, lambda: list(target_q())),
        "servoj": Function(
            ("q", "a", "v", "t", "lookahead_time", "gain"),
            {"a": 0, "v": 0, "t": 0.002, "lookahead_time": 0.1, "gain": 300},
            servoj,
            takes_time=True,
        ),
        "speedj": Function(("qd", "a", "t"), {"t": 0.0}, speedj, takes_time=True),
        "stopj": Function(("a",), {}, lambda a: StopJ(_above_zero("a", a)), takes_time=True),
    }


def _time(value: Any) -> float:
    if number("t", value) < 0.0:
        raise ValueError(f"t is {value!r}, which is below 0")
    return float(value)


def _above_zero(name: str, value: Any) -> float:
    if number(name, value) <= 0.0:
        raise ValueError(f"{name} is {value!r}, which is not above 0")
    return float(value)


def _joints(name: str, value: Any) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != _JOINTS:
        raise ValueError(f"{name} is {value!r}, which is not {_JOINTS} joints")
    return tuple(number(name, each) for each in value)
