"""Requirements of a Universal Robots controller on inputs and programs: levels 1 to 3."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from cardan.conform.requirements import (
    Findings,
    Verdict,
    VerdictOutcome,
    Words,
    at_most,
    distance,
    failed,
    met,
    must,
    none_wrong,
    not_applicable,
    not_seen,
    passed,
    some,
)
from cardan.conform.timeline import Kind
from cardan.conform.timing import mostly_within
from cardan.conform.ur_rtde.decoded import DataPackage, SentProgram, UrTraffic
from cardan.conform.ur_rtde.requirements import (
    BOARD,
    CLIENT,
    DRIVER,
    GUIDE,
    NO_STATES,
    cycle_s,
    refused,
    requires,
)
from cardan.conform.ur_rtde.scenario import (
    ANSWER,
    BEAT,
    CALLS,
    DESERTED_RAD_S,
    INPUTS,
    LAST_JOINT,
    LINE,
    NONSENSE,
    POWER_S,
    RAISES,
    RAISES_AT,
    REPORT,
    SAYS,
    SERVOING,
    SLEEP_S,
    SPARE_INPUT,
    STEP_RAD,
    TOKEN,
    UNKNOWN,
    WRONG,
)
from cardan.protocols.ur import dashboard
from cardan.protocols.ur.primary import MessageKind
from cardan.protocols.ur.program import ProgramStatus
from cardan.protocols.ur.rtde import IN_USE, NOT_FOUND, PacketType
from cardan.protocols.ur.states import MOVES_IN, RobotMode, RuntimeState, SafetyMode
from cardan.protocols.ur.variables import INPUTS as INPUT_TYPES

SCRIPT = "UR's script manual"

BEGINS_WITHIN_S = 1.0
OBEYED_S, OBEYED_CYCLES = 0.01, 2.0
"""Network round trip, and the cycles for which a command and its report wait."""
UNOBEYED_S = 0.3
STILL_RAD = math.radians(0.02)
WATCHDOG_LATE_S = 0.05
MOVES_WITHIN_S = 0.1
REACHED_SHARE = 0.1
BEYOND_SHARE = 0.2
AWAY_SHARE = 0.1
STOPPED_BY_HAND_S = 0.5

NO_PROGRAM = "no program was sent"
_NONE_FOLLOWED = "no program followed then"
RUNTIME = "runtime_state"


# -- level 1: inputs, power, programs that move nothing ------------------------------------------


@requires(101, f"{GUIDE}: field names of inputs; IN_USE")
def inputs_are_given(decoded: UrTraffic) -> Verdict:
    """The registers that the driver writes are given, with the documented types."""
    setups = decoded.setups(PacketType.INPUTS, "inputs")
    found = [each for each in setups if each[1].names == INPUTS]
    exchange, asked, reply = some(found, "it was not answered")[0]
    kinds = zip(asked.names, reply.types, strict=False)
    wrong = [(exchange.number, f"{name} {k}") for name, k in kinds if k != INPUT_TYPES[name]]
    given = reply.recipe and len(reply.types) == len(asked.names)
    must(wrong or given, f"recipe {reply.recipe}", [exchange.number])
    return none_wrong(wrong, len(asked.names), f"{len(asked.names)} registers", "")


@requires(102, f"{GUIDE}: IN_USE")
def registers_have_one_writer(decoded: UrTraffic) -> Verdict:
    """Registers that one client writes are IN_USE for another."""
    given = [each for each in decoded.setups(PacketType.INPUTS, "inputs") if each[2].recipe]
    some(given, "no client had any")
    return refused(decoded, PacketType.INPUTS, INPUTS[0], IN_USE, "taken")


@requires(103, f"{GUIDE}: NOT_FOUND")
def unknown_inputs_arerefused(decoded: UrTraffic) -> Verdict:
    """An input that there is not is NOT_FOUND, and the recipe 0: none."""
    return refused(decoded, PacketType.INPUTS, UNKNOWN, NOT_FOUND)


@requires(104, f"{DRIVER}: the driver reconnects, and needs its registers then")
def what_a_client_had_is_free_when_it_goes(decoded: UrTraffic) -> Verdict:
    """A register of a client that has gone is free 0.2 s later."""
    first, again = (
        [each for each in decoded.setups(PacketType.INPUTS, phase) if SPARE_INPUT in each[1].names]
        for phase in ("taken", "free")
    )
    some(first and again and first[0][2].recipe, "it was not taken")
    exchange, _, reply = again[0]
    said = f"recipe {reply.recipe}, {', '.join(reply.types)}"
    return met(reply.recipe != 0, said, [exchange.number])


@requires(105, "RFC 9293: TCP keeps no packet boundaries")
def torn_requests_are_understood(decoded: UrTraffic) -> Verdict:
    """A request that arrives in two pieces is answered as one that arrives whole."""
    found = some(decoded.exchanges(PacketType.CONTROLLER_VERSION, "pieces"), "none was sent")
    reply = found[0].reply
    return passed("answered") if reply is not None else failed("no answer", [found[0].number])


@requires(106, f"{BOARD}; the driver asks CB3 what only e-Series know")
def unknown_requests_are_answered(decoded: UrTraffic) -> Verdict:
    """A request that the dashboard does not know is answered, by a line that is no consent."""
    found = some(decoded.said(NONSENSE), "it was not asked")
    said = found[0].said
    if said is None:
        return failed("no answer", [found[0].number])
    agreed = said.lower().startswith(("true", "false", *map(str.lower, dashboard.GRANTED.values())))
    return failed(repr(said), [found[0].number]) if agreed else passed(repr(said))


_NO_REMOTE_CONTROL = "the controller has no remote control, as CB3 have none"


def _has_remote_control(decoded: UrTraffic) -> bool:
    return any(each.said in ("true", "false") for each in decoded.said(dashboard.REMOTE_CONTROL))


@requires(107, f"{BOARD}: is in remote control")
def it_is_in_remote_control(decoded: UrTraffic) -> Findings:
    """An e-Series is in remote control, from the beginning to the end."""
    for each in decoded.said(dashboard.REMOTE_CONTROL):
        if each.said is not None and not decoded.inside(each.number, "local", "remote"):
            if not _has_remote_control(decoded):
                return not_applicable(_NO_REMOTE_CONTROL)
            yield each.number, "" if each.said == "true" else repr(each.said)
    return Words("{} times", "it was not answered")


@requires(108, f"{BOARD}: power on, brake release")
def power_and_brakes_obey(decoded: UrTraffic) -> Verdict:
    """`power on` and `brake release` are granted, and the robot's mode is RUNNING 40 s later."""
    before, after = _before(decoded, "power"), decoded.during("power")
    some(before and after, NO_STATES)
    if before[-1].values["robot_mode"] == RobotMode.RUNNING:
        return passed("they were on and released")
    for words in (dashboard.POWER_ON, dashboard.BRAKE_RELEASE):
        for each in decoded.said(words):
            granted = each.said is not None and not dashboard.refusal(words, each.said)
            must(granted, f"{words}: {each.said!r}", [each.number])
    asked_s = after[0].time_s
    mode = after[-1].values["robot_mode"]
    must(mode == RobotMode.RUNNING, f"mode {mode} after {POWER_S:g} s", [after[-1].number])
    took_s = next(s.time_s for s in after if s.values["robot_mode"] == mode) - asked_s
    return passed(f"after {took_s:.1f} s", took_s, "s")


def _programs(decoded: UrTraffic, *phases: str) -> list[SentProgram]:
    """Return the programs that must start, in these phases; without any, in all but "local"."""
    found = [each for each in decoded.uploads if each.token]
    if not phases:
        return [each for each in found if not decoded.inside(each.number, "local")]
    return decoded.within(found, *phases)


def first(states: Sequence[DataPackage], name: str, value: int) -> DataPackage | None:
    """Return the first state with that value."""
    return next((each for each in states if each.values[name] == value), None)


def _before(decoded: UrTraffic, phase: str) -> list[DataPackage]:
    """Return the states before a phase; none if the scenario did not reach it."""
    found = decoded.phase(phase)
    return [] if found is None else [s for s in decoded.states if s.number < found.first]


def after(decoded: UrTraffic, time_s: float) -> list[DataPackage]:
    """Return the states after `time_s`."""
    return [each for each in decoded.states if each.time_s > time_s]


@requires(109, f"{CLIENT}: a client sends a program, and the controller runs it")
def programs_are_begun(decoded: UrTraffic) -> Verdict:
    """Each program that is sent has written its first register within 1 s."""
    found = some(_programs(decoded), NO_PROGRAM)
    wrong, latest_s = [], 0.0
    for each in found:
        state = first(after(decoded, each.time_s), TOKEN, each.token)
        took_s = math.inf if state is None else state.time_s - each.time_s
        latest_s = max(latest_s, took_s)
        if took_s > BEGINS_WITHIN_S:
            words = "never" if state is None else f"after {took_s:.2f} s"
            phase = next((name for name in decoded.phases if decoded.inside(each.number, name)), "")
            wrong.append((each.number, f"{each.name} in {phase}: {words}"))
    if wrong:
        return none_wrong(wrong, len(found), "")
    return passed(f"{len(found)} programs, within {latest_s * 1e3:.0f} ms", latest_s * 1e3, "ms")


@requires(110, f"{SCRIPT}: textmsg; {CLIENT}: text message")
def what_a_program_says_is_reported(decoded: UrTraffic) -> Findings:
    """The text of a program's textmsg comes over the primary interface."""
    texts = [each.text for each in decoded.messages(MessageKind.TEXT)]
    for each in _programs(decoded, "say", "replaced"):
        if each.name == "cardan_says":
            said = any(SAYS in text and str(each.token) in text for text in texts)
            yield each.number, "" if said else repr(texts[-1]) if texts else "no text came"
    return Words("{} texts", NO_PROGRAM)


@requires(111, f"{GUIDE}: runtime_state")
def runtime_state_says_what_runs(decoded: UrTraffic) -> Verdict:
    """runtime_state is PLAYING while a program of 0.2 s runs, and STOPPED before it and after."""
    states, found = decoded.during("say"), _begun(decoded, "say")
    playing = [each for each in states if each.values[RUNTIME] == RuntimeState.PLAYING]
    must(playing, "it was never PLAYING", [found.number])
    took_s = playing[-1].time_s - playing[0].time_s
    last = states[-1].values[RUNTIME]
    said = f"PLAYING for {took_s:.2f} s, then {RuntimeState(last).name}"
    return met(took_s > 0.9 * SLEEP_S and last == RuntimeState.STOPPED, said, [playing[-1].number])


def _begun(decoded: UrTraffic, phase: str, name: str = "") -> SentProgram:
    """Return the first started program of a phase, of that name if given."""
    found = [each for each in _programs(decoded, phase) if name in ("", each.name)]
    begun = found and first(decoded.during(phase), TOKEN, found[0].token)
    return some(found if begun else None, "none was begun")[0]


@requires(112, f"{CLIENT}: key message")
def programs_are_announced(decoded: UrTraffic) -> Verdict:
    """Key messages report that a program has begun, and that it has ended."""
    some(first(decoded.during("say"), RUNTIME, RuntimeState.PLAYING), "no program ran")
    titles = [each.title for each in decoded.messages(MessageKind.KEY, during=("say", "wrong"))]
    missing = [t for t in ("PROGRAM_XXX_STARTED", "PROGRAM_XXX_STOPPED") if t not in titles]
    return failed(f"no {missing[0]}") if missing else passed(f"{len(titles)} messages")


@requires(113, f"{SCRIPT}; {CLIENT}: what is wrong with a program is a message")
def wrong_programs_are_refused_in_words(decoded: UrTraffic) -> Verdict:
    """A program that calls what there is not ends at once, and the primary interface says why."""
    uploads = some([each for each in decoded.uploads if each.name == WRONG], NO_PROGRAM)
    kinds = MessageKind.TEXT, MessageKind.RUNTIME_EXCEPTION
    for last in decoded.during("wrong")[-1:]:
        must(last.values[RUNTIME] == RuntimeState.STOPPED, "it still runs", [last.number])
    words = decoded.messages(*kinds, during=("wrong",))
    must(words, "nothing was said", [uploads[0].number])
    return passed(f"line {words[0].line}: {words[0].text!r}")


def _follows(state: DataPackage) -> bool:
    return bool(state.values[REPORT] == ProgramStatus.FOLLOWS)


@requires(114, f"{GUIDE}: robot_mode, safety_mode, runtime_state, target_speed_fraction")
def holding_is_undisturbed(decoded: UrTraffic) -> Findings:
    """Held by the driver's program, the robot is RUNNING, safety is normal, the program plays and
    the speed slider stands at 100 %."""
    some(decoded.sent_during("hold"), "it was not held")
    for each in decoded.during("hold"):
        v = each.values
        slider = v["target_speed_fraction"]
        causes = (
            (v["safety_mode"] not in MOVES_IN, f"safety mode {v['safety_mode']}"),
            (v["robot_mode"] != RobotMode.RUNNING, f"robot mode {v['robot_mode']}"),
            (v[RUNTIME] != RuntimeState.PLAYING, f"runtime state {v[RUNTIME]}"),
            (slider < 0.999, f"the speed slider at {100.0 * slider:.0f} %"),
            (not _follows(each), f"the program reports {v[REPORT]}"),
        )
        yield each.number, next((words for bad, words in causes if bad), "")
    return Words("{} states", "it was not held")


@requires(115, f"{GUIDE}: inputs act in the cycle after they came; {DRIVER}")
def commands_are_obeyed(decoded: UrTraffic) -> Verdict:
    """Nine of ten commands show their effect within 10 ms and two control cycles, each within 0.3
    s."""
    phase = some(decoded.phase("hold"), "nothing was commanded")
    sent = some(decoded.sent_during("hold"), "nothing was commanded")
    states = iter(decoded.during("hold", "silence"))
    times: list[tuple[float, int]] = []
    obeyed, now_s = -1, 0.0
    for each in sent:
        beat = each.values[INPUTS[1]]
        while obeyed < beat and (state := next(states, None)) is not None:
            if state.values[TOKEN] == each.values[INPUTS[0]]:
                obeyed, now_s = state.values[BEAT], state.time_s
        late_s = now_s - each.time_s if obeyed >= beat else math.inf
        if obeyed >= beat or each.time_s < phase.end_s - UNOBEYED_S:
            times.append((late_s, each.number))
    lost = [number for late_s, number in times if late_s > UNOBEYED_S]
    must(not lost, f"{len(lost)} of {len(times)} had no effect", lost)
    most_s = OBEYED_S + OBEYED_CYCLES * cycle_s(decoded)
    return mostly_within(times, 0.9, most_s, "nine of ten within {:.1f} ms", "too few commands")


def _farthest(states: Sequence[DataPackage], joints: slice = slice(None)) -> float:
    """Return the largest distance of any joint from its first position, rad."""
    first = states[0].values["actual_q"][joints]
    return max(distance(each.values["actual_q"][joints], first) for each in states)


@requires(116, f"{SCRIPT}: servoj")
def held_it_stands(decoded: UrTraffic) -> Verdict:
    """Sent to its own target by servoj, every joint stays within 0.02 degrees."""
    found = [each for each in decoded.during("hold") if _follows(each)]
    some(len(found) >= 50, "it was not held")
    far = _farthest(found)
    return met(far < STILL_RAD, f"{math.degrees(far):.4f} degrees at most")


def _ended(decoded: UrTraffic, phase: str) -> tuple[float, DataPackage] | None:
    """Return the time from a phase's beginning until the driver's program stopped following, s, and
    the state that reports it."""
    begun, found = decoded.phase(phase), decoded.during(phase)
    before = _before(decoded, phase)
    if begun is None or not found or not before or not _follows(before[-1]):
        return None
    state = next((each for each in found if not _follows(each)), None)
    return (math.inf, found[-1]) if state is None else (state.time_s - begun.start_s, state)


def _watchdog(decoded: UrTraffic, phase: str) -> Verdict:
    """Check if the program's own watchdog ended it in time, with the arm at rest after it."""
    found = some(_ended(decoded, phase), _NONE_FOLLOWED)
    took_s, state = found
    report = state.values[REPORT]
    must(report == ProgramStatus.ENDED_BY_WATCHDOG, f"it reports {report}", [state.number])
    said = f"after {took_s * 1e3:.0f} ms"
    if took_s > SERVOING.watchdog_s + WATCHDOG_LATE_S:
        return failed(said, [state.number], took_s * 1e3, "ms")
    last = decoded.during(phase)[-1]
    runtime = last.values[RUNTIME]
    must(
        runtime == RuntimeState.STOPPED, f"{said}, then the runtime state {runtime}", [last.number]
    )
    return passed(said, took_s * 1e3, "ms")


@requires(117, f"{DRIVER}: the program's watchdog; {SCRIPT}: servoj takes its time")
def silence_ends_the_program(decoded: UrTraffic) -> Verdict:
    """Without commands the driver's program ends after 0.1 s, or no more than 50 ms later."""
    return _watchdog(decoded, "silence")


@requires(118, f"{DRIVER}")
def an_order_ends_the_program(decoded: UrTraffic) -> Verdict:
    """A program that was begun again ends by order, its registers keep what it reported, and
    runtime_state is STOPPED."""
    _, state = some(_ended(decoded, "order"), _NONE_FOLLOWED)
    some(decoded.sent_during("order"), _NONE_FOLLOWED)
    last = decoded.during("order")[-1].values
    said = f"report {last[REPORT]}, runtime state {last[RUNTIME]}"
    ended = (last[REPORT], last[RUNTIME]) == (ProgramStatus.ENDED_BY_ORDER, RuntimeState.STOPPED)
    return met(ended, said, [state.number])


@requires(119, f"{CLIENT}: a program replaces the running one")
def a_program_replaces_another(decoded: UrTraffic) -> Verdict:
    """A program that is sent while another runs takes its place."""
    begun, found = _programs(decoded, "replace"), _programs(decoded, "replaced")
    some(begun and found, _NONE_FOLLOWED)
    state = first(decoded.during("replaced"), TOKEN, found[0].token)
    state = must(state, "it was not begun", [found[0].number])
    later = after(decoded, state.time_s)
    back = [each.number for each in later if each.values[TOKEN] == begun[0].token]
    return failed("the other continues", back) if back else passed("it did")


# -- level 2: micro-motion ------------------------------------------------------------------------


def _last_joint(states: Sequence[DataPackage], name: str = "actual_q") -> list[float]:
    """Return the last joint's offset from its position in the first state, rad, in each state."""
    first = states[0].values[name][-1]
    return [each.values[name][-1] - first for each in states]


def _unmoved(decoded: UrTraffic) -> Verdict | None:
    """Return a verdict if the motion in the phase "out" cannot be checked; None: it can."""
    if not decoded.sent_during("out"):
        return not_seen("it was not tried")
    return not_seen(NO_STATES) if len(decoded.during("out")) < 2 else None


@requires(201, f"{SCRIPT}: servoj", unless=_unmoved)
def commands_move_it(decoded: UrTraffic) -> Verdict:
    """The last joint moves within 0.1 s of the first command that says so."""
    found, sent = decoded.during("out"), decoded.sent_during("out")
    begins = sent[0].values[LAST_JOINT]
    ordered = next((c for c in sent if abs(c.values[LAST_JOINT] - begins) > 0.02 * STEP_RAD), None)
    ordered = some(ordered, "it was not told to")
    far = zip(found, _last_joint(found), strict=True)
    moved = next((state for state, each in far if each > 0.02 * STEP_RAD), None)
    moved = must(moved, "it never did", [ordered.number])
    took_ms = 1e3 * (moved.time_s - ordered.time_s)
    return at_most(1e3 * MOVES_WITHIN_S, took_ms, "ms", f"after {took_ms:.0f} ms", [moved.number])


@requires(202, f"{SCRIPT}: servoj", unless=_unmoved)
def it_gets_there(decoded: UrTraffic) -> Verdict:
    """Half a second after a step of 0.2 degrees the joint is there, to a tenth of it."""
    found = decoded.during("out")
    far = _last_joint(found)[-1]
    said = f"{math.degrees(far):.3f} degrees"
    return met(abs(far / STEP_RAD - 1.0) < REACHED_SHARE, said, [found[-1].number])


@requires(203, f"{SCRIPT}: servoj, lookahead_time and gain", unless=_unmoved)
def it_does_not_overshoot(decoded: UrTraffic) -> Verdict:
    """On its way it goes no more than 20 % beyond the step's end."""
    found = decoded.during("out")
    beyond = max(_last_joint(found)) / STEP_RAD - 1.0
    return met(beyond < BEYOND_SHARE, f"{100.0 * max(beyond, 0.0):.1f} %")


@requires(204, f"{SCRIPT}: servoj", unless=_unmoved)
def the_other_joints_stand(decoded: UrTraffic) -> Verdict:
    """Meanwhile no other joint moves by more than a tenth of the step."""
    far = _farthest(decoded.during("out"), slice(-1))
    return met(far < AWAY_SHARE * STEP_RAD, f"{math.degrees(far):.4f} degrees at most")


@requires(205, f"{GUIDE}: actual_qd, target_qd", unless=_unmoved)
def speeds_are_those_of_the_joints(decoded: UrTraffic) -> Findings:
    """The speeds that it reports add up to the way that the joint goes, to a tenth of it."""
    found = decoded.during("out")
    for place, speed in (("actual_q", "actual_qd"), ("target_q", "target_qd")):
        way = sum(
            b.values[speed][-1] * (b.values["timestamp"] - a.values["timestamp"])
            for a, b in pairwise(found)
        )
        far = _last_joint(found, place)[-1]
        words = f"{speed} {math.degrees(way):.3f}, {place} {math.degrees(far):.3f} degrees"
        off = abs(way - far) > REACHED_SHARE * STEP_RAD
        yield found[-1].number, words if off else ""
    return Words("actual and target")


@requires(206, f"{DRIVER}: the program's watchdog; {SCRIPT}: stopj")
def deserted_in_motion_it_stops(decoded: UrTraffic) -> Verdict:
    """Without commands in motion the program ends by its watchdog, and the arm stands 0.1 s
    later, having gone on no farther than it had to."""
    verdict = _watchdog(decoded, "deserted")
    found, ended = decoded.during("deserted"), _ended(decoded, "deserted")
    if ended is None or verdict.outcome is not VerdictOutcome.PASSED:
        return verdict
    far = abs(_last_joint(found)[-1])
    after = [each for each in found if each.time_s > ended[1].time_s + 0.1]
    rest = abs(_last_joint(after)[-1]) if after else math.inf
    most = 1.5 * DESERTED_RAD_S * (SERVOING.watchdog_s + SERVOING.lookahead_s)
    said = f"{verdict.said}, {math.degrees(far):.3f} degrees, {math.degrees(rest):.4f} at the end"
    return met(
        0.3 * DESERTED_RAD_S * SERVOING.watchdog_s < far < most and rest < STILL_RAD / 10.0,
        said,
        [found[-1].number],
    )


@requires(207, f"{SCRIPT}: servoj; a restarted program begins where the arm is", unless=_unmoved)
def it_comes_back(decoded: UrTraffic) -> Verdict:
    """Restarted, the program takes the joint back to where it was, to a tenth of the step."""
    there, back = decoded.during("out"), decoded.during("back")
    some(decoded.sent_during("back") and back, _NONE_FOLLOWED)
    left = back[-1].values["actual_q"][-1] - there[0].values["actual_q"][-1]
    said = f"{math.degrees(left):.4f} degrees off"
    return met(abs(left) < REACHED_SHARE * STEP_RAD, said, [back[-1].number])


# -- level 3: by hand -----------------------------------------------------------------------------


@requires(301, f"{GUIDE}: target_speed_fraction")
def the_speed_slider_is_reported(decoded: UrTraffic) -> Verdict:
    """target_speed_fraction follows the speed slider to the half, and back."""
    half, full = decoded.during("slider-half"), decoded.during("slider-full")
    some(half and full, NO_STATES)
    values = [found[-1].values["target_speed_fraction"] for found in (half, full)]
    return met(0.3 < values[0] < 0.7 and values[1] > 0.95, f"{values[0]:.2f}, then {values[1]:.2f}")


def _never_local(decoded: UrTraffic) -> Verdict | None:
    """Return a verdict if local control cannot be checked; None: it can."""
    if decoded.phase("local") is not None:
        return None
    if _has_remote_control(decoded):
        return not_seen("it was not in remote control before")
    return not_applicable(_NO_REMOTE_CONTROL)


@requires(302, f"{BOARD}: is in remote control", unless=_never_local)
def local_control_is_reported(decoded: UrTraffic) -> Verdict:
    """In local control the dashboard says so, and in remote control again."""
    asked = decoded.said(dashboard.REMOTE_CONTROL)
    found = (decoded.within(asked, name) for name in ("local", "remote"))
    said = " then ".join(str(each[-1].said) if each else "nothing" for each in found)
    return met(said == "false then true", said)


@requires(303, "UR's user manual, e-Series: remote control", unless=_never_local)
def local_control_takes_no_programs(decoded: UrTraffic) -> Verdict:
    """In local control a program that is sent is not begun."""
    uploads = some(_programs(decoded, "local"), NO_PROGRAM)
    state = first(decoded.states, TOKEN, uploads[0].token)
    return passed("it was not") if state is None else failed("it was", [state.number])


def _emergency(decoded: UrTraffic) -> list[DataPackage]:
    stops = (SafetyMode.ROBOT_EMERGENCY_STOP, SafetyMode.SYSTEM_EMERGENCY_STOP)
    return [each for each in decoded.during("estop") if each.values["safety_mode"] in stops]


@requires(304, f"{GUIDE}: safety_mode")
def an_emergency_stop_is_reported(decoded: UrTraffic) -> Verdict:
    """After an emergency stop safety_mode says so, and no state says that a program plays half a
    second later."""
    found = some(_emergency(decoded), "no state reported one")
    late = [each for each in found if each.time_s > found[0].time_s + STOPPED_BY_HAND_S]
    wrong = [each.number for each in late if each.values[RUNTIME] == RuntimeState.PLAYING]
    return failed("a program plays", wrong) if wrong else passed(f"{len(found)} states")


@requires(305, f"{GUIDE}: robot_mode; stop category 1")
def an_emergency_stop_takes_the_power(decoded: UrTraffic) -> Verdict:
    """Within a second of it the robot is no longer RUNNING."""
    found = some(_emergency(decoded), "no state reported one")
    mode = found[-1].values["robot_mode"]
    said = RobotMode(mode).name if mode in RobotMode._value2member_map_ else str(mode)
    return met(mode != RobotMode.RUNNING, said, [found[-1].number])


@requires(306, f"{DRIVER}: after a stop nothing starts by itself")
def release_starts_nothing(decoded: UrTraffic) -> Findings:
    """When the emergency stop is released the robot is not RUNNING by itself, and no program
    plays."""
    found = [each for each in decoded.during("release") if each.values["safety_mode"] in MOVES_IN]
    some(_emergency(decoded) and found, "it was not released")
    for each in found:
        mode, runtime = each.values["robot_mode"], each.values[RUNTIME]
        starts = mode == RobotMode.RUNNING or runtime == RuntimeState.PLAYING
        yield each.number, f"mode {mode}, runtime state {runtime}" if starts else ""
    return Words("{} states")


# -- level 1: lines and programs that users send beside a driver ---------------------------------


@requires(120, f"{CLIENT}: a line that is sent alone is run")
def a_line_is_a_program_of_its_own(decoded: UrTraffic) -> Verdict:
    """A line without `def` and `end` is executed: its text comes over the primary interface."""
    lines = [each for each in decoded.within(decoded.uploads, "lines") if not each.token]
    some(lines, NO_PROGRAM)
    texts = decoded.messages(MessageKind.TEXT, during=("lines",))
    found = [each.text for each in texts if LINE in each.text]
    return passed(repr(found[0])) if found else failed("no text came", [lines[0].number])


@requires(121, f"{CLIENT}: lines and programs on one connection")
def lines_spoil_no_program(decoded: UrTraffic) -> Verdict:
    """After lines, comments and `stop program` the next program of the connection is begun."""
    found = some(_programs(decoded, "lines"), NO_PROGRAM)
    state = first(after(decoded, found[0].time_s), TOKEN, found[0].token)
    return passed("it was") if state else failed("it was not", [found[0].number])


@requires(122, f"{CLIENT}: runtime exception message")
def runtime_exceptions_are_reported(decoded: UrTraffic) -> Verdict:
    """A program that fails while it runs ends, and a runtime exception on the primary interface
    says in which line."""
    found, last = _begun(decoded, "raise"), decoded.during("raise")[-1]
    must(last.values[RUNTIME] == RuntimeState.STOPPED, "it still runs", [last.number])
    raised = decoded.messages(MessageKind.RUNTIME_EXCEPTION, during=("raise",))
    must(raised, f"nothing was said of {RAISES}", [found.number])
    return met(raised[0].line == RAISES_AT, f"line {raised[0].line}: {raised[0].text!r}")


@requires(123, f"{SCRIPT}: socket_open, socket_send_line, socket_read_line")
def programs_open_sockets(decoded: UrTraffic) -> Verdict:
    """A program opens a socket to a port of the suite, sends a line, and receives the answer."""
    found = _begun(decoded, "call", CALLS)
    came = any(event.kind is Kind.OPENED for _, event in decoded.called)
    must(came, "it did not come", [found.number])
    number, wanted = decoded.called[0][0], f"{SAYS} {found.token}"
    line = b"".join(event.data for _, event in decoded.called).decode("utf-8", "replace")
    must(line.strip() == wanted, f"it sent {line!r}", [number])
    texts = decoded.messages(MessageKind.TEXT, during=("call",))
    heard = any(ANSWER in each.text for each in texts)
    must(heard, "it did not receive the answer", [number])
    return passed("it did")


@requires(124, f"{CLIENT}: the secondary and the real-time interface take programs, too")
def other_interfaces_take_programs(decoded: UrTraffic) -> Findings:
    """Programs that are sent over the secondary and over the real-time interface are begun."""
    found = _programs(decoded, "elsewhere")
    for each in found:
        begun = first(after(decoded, each.time_s), TOKEN, each.token)
        yield each.number, "" if begun else f"over the {each.channel} interface"
    return Words(", ".join(each.channel for each in found), NO_PROGRAM)
