"""Scripts of the simulated controller's program: the built-in ones, and the verbs of scripts.

A script's RAPID verbs are the instructions of the motion task; the others are operator actions
at the controller, or external events.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from cardan.errors import ScriptError
from cardan.sim_peers.base import ScriptStep
from cardan.sim_peers.egm_controller.arguments import ALL_AXES, EgmMode, StopMode
from cardan.sim_peers.egm_controller.contact import ContactSurface
from cardan.sim_peers.egm_controller.panel import OnError
from cardan.sim_peers.kinematics import AXES

_Parser = Callable[[Sequence[str]], dict[str, Any]]


def _guided(
    about: str,
    *before: str,
    act: str = " window=1e-9 max-speed=180",
    run: str = " cond-time=1e6",
    then: str = "",
) -> str:
    """A program that sets EGM up and runs it once; `then` has its later lines."""
    begin = ("movej", *before, "getid", "setup", f"act{act}")
    lines = [f"# {about}", *(f"0 {line}" for line in begin), f"0 run{run}"]
    return "\n".join(lines) + f"\n{then}"


SCRIPTS: dict[str, str] = {
    "teleop": _guided(
        "run EGM endlessly; after an error an operator starts it again within 2 s",
        "on-error restart 2",
    ),
    "teleop-retry": _guided(
        "as teleop, with an error handler in the program that runs EGM again at once",
        "on-error retry 0.2",
    ),
    "teleop-once": _guided("run EGM endlessly; an error ends it"),
    "teleop-stream": _guided(
        "as teleop, in a program that also streams: datagrams go on while the program is stopped",
        "on-error restart 2",
        act=" window=1e-9 max-speed=180 stream",
    ),
    "stream": """\
# stream positions only
0 movej
0 getid
0 setup
0 act
0 stream-start
""",
    "stream-then-run": """\
# stream positions for 2 s, then run EGM endlessly
0 movej
0 getid
0 setup
0 act window=1e-9 max-speed=180
0 stream-start
2 run cond-time=1e6
""",
    "manual-defaults": _guided(
        "one run with every argument left out: 1 deg/s, ends when still within the window for 1 s",
        act="",
        run="",
    ),
    "while-true": _guided(
        "EGM in WHILE TRUE with CondTime 5 s, as in many public programs: sessions end and begin "
        "again",
        "loop on",
        "on-error retry 1",
        act=" max-speed=20",
        run=" cond-time=5",
    ),
    "speed": _guided(
        "pure speed control: PosCorrGain 0", "on-error restart 2", run=" pos-gain=0 cond-time=1e6"
    ),
    "interrupted": _guided(
        "EGM with everything that interrupts it: program stop, motors off, emergency stop",
        then="""\
4 program-stop
6 program-start
10 motors-off
12 motors-on
13 program-start
17 estop
19 motors-on
20 program-start
""",
    ),
    "path": """\
# path correction on a straight path of 200 mm, there and back, again and again
0 movej
0 getid
0 setup path
0 act path
0 egmmovel 0 200 0 40 1000
""",
}

_POSE_AXES = ("x", "y", "z", "rx", "ry", "rz")


class ScriptAction(NamedTuple):
    """A checked script line."""

    time_s: float
    verb: str
    arguments: dict[str, Any]


def compile_script(steps: Sequence[ScriptStep]) -> tuple[ScriptAction, ...]:
    """Check the arguments of every step. Raises ScriptError with the verb's usage."""
    actions = []
    for step in steps:
        try:
            arguments = _VERBS[step.verb].parse(step.args)
        except (ValueError, KeyError, IndexError) as error:
            raise ScriptError(
                f"{step.time_s:g} {step.verb} {' '.join(step.args)}: {error}; "
                f"usage: {SCRIPT_VERBS[step.verb]}"
            ) from None
        actions.append(ScriptAction(step.time_s, step.verb, arguments))
    return tuple(actions)


def _words(
    flags: Mapping[str, dict[str, Any]], options: Mapping[str, Callable[[str], dict[str, Any]]]
) -> _Parser:
    """A parser of flags and KEY=VALUE words in any order."""

    def parse(words: Sequence[str]) -> dict[str, Any]:
        result: dict[str, Any] = {}
        for word in words:
            key, equals, text = word.partition("=")
            if not equals and key in flags:
                result.update(flags[key])
            elif equals and key in options:
                result.update(options[key](text))
            else:
                raise ValueError(f"{word!r} is not known")
        return result

    return parse


def _number(name: str) -> Callable[[str], dict[str, Any]]:
    return lambda text: {name: _finite(text)}


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is not a finite number")
    return value


def _gain(text: str) -> dict[str, Any]:
    gain = _finite(text)
    if not 0.0 <= gain <= 1.0:
        raise ValueError(f"gain {text} is not within 0 to 1")
    return {"pos_corr_gain": gain}


def _sample_rate(text: str) -> dict[str, Any]:
    rate = int(text)
    if rate < 4 or rate % 4:
        raise ValueError(f"sample rate {text} is not a multiple of 4 ms")
    return {"sample_rate_ms": rate}


def _window(text: str) -> dict[str, Any]:
    deg, _, mm = text.partition(",")
    return {"window_deg": _finite(deg), "window_mm": _finite(mm or deg)}


def _axes(text: str) -> dict[str, Any]:
    if text == "all":
        return {"axes": ALL_AXES}
    if text == "none":
        return {"axes": ()}
    indices = {
        _POSE_AXES.index(word) if word in _POSE_AXES else int(word) - 1 for word in text.split(",")
    }
    if not indices <= set(ALL_AXES):
        raise ValueError(f"{text!r} names an axis that is not there")
    return {"axes": tuple(sorted(indices))}


def _nothing(words: Sequence[str]) -> dict[str, Any]:
    if words:
        raise ValueError("takes no arguments")
    return {}


def _numbers(name: str, least: int, most: int) -> _Parser:
    def parse(words: Sequence[str]) -> dict[str, Any]:
        if not least <= len(words) <= most:
            raise ValueError(f"{len(words)} values")
        return {name: tuple(map(_finite, words))}

    return parse


def _optional_joints(words: Sequence[str]) -> dict[str, Any]:
    return _numbers("joints_deg", AXES, AXES)(words) if words else {"joints_deg": None}


def _switch(words: Sequence[str]) -> dict[str, Any]:
    (word,) = words
    return {"on": {"on": True, "off": False, "1": True, "0": False}[word]}


def _on_error(words: Sequence[str]) -> dict[str, Any]:
    if len(words) > 2:
        raise ValueError(f"{len(words)} values")
    return {
        "policy": OnError(words[0]),
        "after_s": _finite(words[1]) if len(words) > 1 else 0.0,
    }


def _wall(words: Sequence[str]) -> dict[str, Any]:
    height_mm, *others = _numbers("values", 2, 4)(words)["values"]
    if min(others) < 0.0:
        raise ValueError("stiffness, damping and friction must be at least 0")
    if not others[0]:
        return {"surface": None}
    return {"surface": ContactSurface(height_mm * 1e-3, others[0] * 1e3, *others[1:])}


def _egmmovel(words: Sequence[str]) -> dict[str, Any]:
    values = _numbers("values", 4, 5)(words)["values"]
    if values[3] <= 0.0:
        raise ValueError("the speed must be above 0")
    return {
        "displacement_mm": values[:3],
        "speed_mm_s": values[3],
        "repeats": int(values[4]) if len(values) > 4 else 1,
    }


_MODES = {mode.value: {"mode": mode} for mode in EgmMode}
_RUN_MODES = {name: flag for name, flag in _MODES.items() if name != EgmMode.PATH.value}
_STOP_MODES = {mode.value: {"stop_mode": mode} for mode in StopMode}


class _Verb(NamedTuple):
    usage: str = ""
    """Usage of the words after the verb."""
    parse: _Parser = _nothing


_VERBS: Mapping[str, _Verb] = {
    "movej": _Verb(
        "[J1 ... J6 deg] (a programmed movement; without values: stay)", _optional_joints
    ),
    "getid": _Verb("(EGMGetId)"),
    "setup": _Verb(
        "[joint|pose|path] [timeout=S] (EGMSetupUC)",
        _words(_MODES, {"timeout": _number("comm_timeout_s")}),
    ),
    "act": _Verb(
        "[joint|pose|path] [window=DEG,MM] [filter=HZ] [sample-rate=MS] [max-speed=DEG/S] "
        "[max-pos=DEG] [stream] (EGMActJoint, EGMActPose, EGMActMove)",
        _words(
            {**_MODES, "stream": {"stream_start": True}},
            {
                "window": _window,
                "filter": _number("lp_filter_hz"),
                "sample-rate": _sample_rate,
                "max-speed": _number("max_speed_deviation_deg_s"),
                "max-pos": _number("max_pos_deviation_deg"),
            },
        ),
    ),
    "stream-start": _Verb("(EGMStreamStart)"),
    "stream-stop": _Verb("(EGMStreamStop)"),
    "run": _Verb(
        "[joint|pose] [hold|ramp-down] [axes=all|none|1,2,..|x,y,rz,..] [cond-time=S] "
        "[ramp-in=S] [ramp-out=S] [pos-gain=0..1] [nowait] (EGMRunJoint, EGMRunPose)",
        _words(
            {**_RUN_MODES, **_STOP_MODES, "nowait": {"no_wait": True}},
            {
                "axes": _axes,
                "cond-time": _number("cond_time_s"),
                "ramp-in": _number("ramp_in_s"),
                "ramp-out": _number("ramp_out_s"),
                "pos-gain": _gain,
            },
        ),
    ),
    "egmmovel": _Verb(
        "DX DY DZ SPEED [REPEATS] (EGMMoveL with path correction; mm, mm/s)", _egmmovel
    ),
    "stop": _Verb(
        "[hold|ramp-down] [ramp-out=S] (EGMStop)",
        _words(_STOP_MODES, {"ramp-out": _number("ramp_out_s")}),
    ),
    "reset": _Verb("(EGMReset)"),
    "loop": _Verb("on|off (run EGM again when a run ends)", _switch),
    "on-error": _Verb(
        "stop|retry|restart [SECONDS] (after an error: nothing; an error handler tries again; an "
        "operator restarts it)",
        _on_error,
    ),
    "restart": _Verb("(program pointer to main, start)"),
    "pp-to-main": _Verb(),
    "program-stop": _Verb(),
    "program-start": _Verb(),
    "motors-off": _Verb(),
    "motors-on": _Verb(),
    "estop": _Verb("(emergency stop; motors-on acknowledges it)"),
    "controller-restart": _Verb("(silent for 2 s, then sequence number 0 and a new port)"),
    "jog": _Verb(
        "J1 ... J6 (jogged by hand to these joints, deg)", _numbers("joints_deg", AXES, AXES)
    ),
    "collision": _Verb("(motion supervision sees a collision)"),
    "contact": _Verb(
        "FX FY FZ TX TY TZ (a force at the TCP; N, N·m)", _numbers("wrench", AXES, AXES)
    ),
    "wall": _Verb(
        "Z_MM N_PER_MM [N_S_PER_M [FRICTION]] (a horizontal surface below the TCP; "
        "0 N_PER_MM: none)",
        _wall,
    ),
    "force-control": _Verb("on|off (the force is compensated, or the raw sensor's)", _switch),
    "do": _Verb("0|1 (RAPIDfromRobot.digVal)", _switch),
    "dnum": _Verb("VALUE ... (RAPIDfromRobot.dnum)", _numbers("values", 0, 40)),
    "echo": _Verb("on|off (RAPIDfromRobot repeats RAPIDtoRobot; on unless switched off)", _switch),
}

SCRIPT_VERBS: dict[str, str] = {
    name: f"{name} {verb.usage}".rstrip() for name, verb in _VERBS.items()
}
"""Usage of each verb."""
