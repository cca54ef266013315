"""Requirements for an HDAPI library and the device behind it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import pairwise

from cardan.conform.requirements import (
    Requirements,
    Verdict,
    failed,
    not_applicable,
    not_seen,
    passed,
)
from cardan_omni.conform.calls import ERROR_STACK, GREATEST_N
from cardan_omni.conform.decoded import Answer, HdapiTraffic, Tick
from cardan_omni.conform.scenario import DOUBLES, NO_ENUM, NO_HANDLE, NOBODY, STRINGS
from cardan_omni.driver.library import RATE_HZ, SIGNATURES
from cardan_omni.protocol import (
    INVALID_HANDLE,
    Calibration,
    Capability,
    Error,
    Info,
    State,
    error_name,
    is_force_error,
)

GUIDE = "OpenHaptics Toolkit 3, programmer's guide and API reference"
LOOP = f"{GUIDE}: the scheduler's default rate is 1000 Hz"
PAGE = "plugins/cardan-omni/README.md"
OMNI = f"{PAGE}, kinematics"

RATE_SHARE = 0.02
GAP_S = 0.005
JITTER_S, JITTER_SHARE = 0.0003, 0.95
REACH_MARGIN_MM = 20.0
SKEW = 0.03
PLACE_MM = 2.0
TEMPERATURE = 0.9
MOVED_RAD = 0.05
DRIFT_MM = 10.0
FORCE_SHARE, FORCE_N = 0.05, 0.01
SPEED_M_S = 0.2
L1_MM, L3_MM, L4_MM = 133.35, 23.35, 168.35
SERVED = ("hold", "asked", "move", "press", "release", "dock", "undock")

requires: Requirements[HdapiTraffic] = Requirements("HDAPI")
_NO_DEVICE = "no device was initialized"
_NO_TICKS = "no tick came"


def _bad(found: Iterable[tuple[int, str]], of: int, good: str, nothing: str = _NO_TICKS) -> Verdict:
    wrong = list(found)
    if wrong:
        return failed(f"{len(wrong)} of {of}: {wrong[0][1]}", (n for n, _ in wrong))
    return passed(good) if of else not_seen(nothing)


def _names(errors: Iterable[int]) -> str:
    return ", ".join(map(error_name, errors)) or "no error"


@requires(1, GUIDE)
def it_has_every_function(decoded: HdapiTraffic) -> Verdict:
    """The library can be loaded, and has every function of HDAPI."""
    missing = sorted({*SIGNATURES} - {*(decoded.functions or ())})
    return failed(f"without {missing[0]}") if missing else passed(f"{len(SIGNATURES)} functions")


# -- level 1: without force -----------------------------------------------------------------------


@requires(101, f"{GUIDE}, hdGetError")
def the_stack_is_empty_at_first(decoded: HdapiTraffic) -> Verdict:
    """Before anything was called there is no error on the stack."""
    answer = decoded.said("hdGetError")
    if answer is None:
        return not_seen("it was not asked")
    good = answer.errors == (Error.SUCCESS,)
    return passed("none") if good else failed(_names(answer.errors), [answer.number])


@requires(102, f"{GUIDE}, hdGetErrorString")
def errors_have_words(decoded: HdapiTraffic) -> Verdict:
    """Every error has a text."""
    answer = decoded.said("hdGetErrorString")
    if answer is None:
        return not_seen("it was not asked")
    return passed(repr(answer.returns)) if answer.returns else failed("none", [answer.number])


@requires(103, f"{GUIDE}, hdInitDevice")
def other_devices_are_refused(decoded: HdapiTraffic) -> Verdict:
    """A device that there is not is refused with the handle 0xFFFFFFFF and an error."""
    answer = decoded.said("hdInitDevice", NOBODY)
    if answer is None:
        return not_seen("it was not tried")
    said = f"{answer.returns:#x}, {_names(answer.errors)}"
    good = answer.returns == INVALID_HANDLE and answer.errors
    return passed(said) if good else failed(said, [answer.number])


@requires(104, f"{GUIDE}, hdInitDevice")
def the_default_device_is_initialized(decoded: HdapiTraffic) -> Verdict:
    """The default device is initialized without an error."""
    answer = decoded.said("hdInitDevice", None)
    if answer is None:
        return not_seen("it was not tried")
    # Warm motors of an earlier use do not keep it from being initialized.
    errors = [each for each in answer.errors if each != Error.WARM_MOTORS]
    if answer.returns == INVALID_HANDLE or errors:
        return failed(_names(errors), [answer.number])
    return passed(f"handle {answer.returns}")


@requires(105, f"{GUIDE}, hdGetCurrentDevice")
def it_is_the_current_device(decoded: HdapiTraffic) -> Verdict:
    """The device that was initialized is the current one."""
    answer, init = decoded.said("hdGetCurrentDevice"), decoded.said("hdInitDevice", None)
    if answer is None or init is None:
        return not_seen(_NO_DEVICE)
    said = f"handle {answer.returns}, {_names(answer.errors)}"
    good = answer.returns == init.returns and not answer.errors
    return passed(said) if good else failed(said, [answer.number])


@requires(106, f"{GUIDE}, hdGetString")
def it_says_what_it_is(decoded: HdapiTraffic) -> Verdict:
    """Version, model, vendor and serial number are texts, and none is empty."""
    found = [decoded.said("hdGetString", what) for what in STRINGS]
    reported = [each for each in found if each is not None]
    if not reported:
        return not_seen(_NO_DEVICE)
    wrong = [e.number for e in reported if e.errors or not (e.returns or "").strip()]
    words = f"HDAPI {reported[0].returns}, {reported[1].returns}"
    return failed("one is empty", wrong) if wrong else passed(words)


def _numbers(decoded: HdapiTraffic, info: Info) -> tuple[float, ...]:
    answer = decoded.said("hdGetDoublev", info)
    return () if answer is None or answer.errors else answer.values


@requires(107, f"{GUIDE}, device parameters")
def its_limits_are_plausible(decoded: HdapiTraffic) -> Verdict:
    """It has three axes and more; the usable workspace lies within the greatest, the continuous
    force is no greater than the greatest, and none of them is zero."""
    if not decoded.opened:
        return not_seen(_NO_DEVICE)
    values = {info: _numbers(decoded, info) for info in DOUBLES}
    lacking = [info.name for info, found in values.items() if not found]
    if lacking:
        return failed(f"no {lacking[0]}")
    most, usable = (values[info] for info in list(DOUBLES)[:2])
    stiffness, greatest, lasting = (values[info][0] for info in list(DOUBLES)[2:])
    axes = [decoded.said("hdGetIntegerv", what) for what in (Info.INPUT_DOF, Info.OUTPUT_DOF)]
    counts = [int(each.values[0]) if each is not None else 0 for each in axes]
    within = all(a <= b for a, b in zip(most[:3], usable[:3], strict=True)) and all(
        a >= b for a, b in zip(most[3:], usable[3:], strict=True)
    )
    wide = all(a < b for a, b in zip(usable[:3], usable[3:], strict=True))
    said = f"{counts[0]} and {counts[1]} axes, {greatest:g} N, {lasting:g} N continuous"
    good = min(counts) >= 3 and within and wide and stiffness > 0.0 and greatest >= lasting > 0.0
    return passed(said) if good else failed(said)


def _refused(answer: Answer | None, code: Error) -> Verdict:
    if answer is None:
        return not_seen(_NO_DEVICE)
    said = _names(answer.errors)
    return passed(said) if answer.errors == (code,) else failed(said, [answer.number])


@requires(108, f"{GUIDE}, HD_INVALID_INPUT_TYPE")
def wrong_types_are_refused(decoded: HdapiTraffic) -> Verdict:
    """The position as integers is refused with HD_INVALID_INPUT_TYPE, and no other error."""
    return _refused(decoded.said("hdGetIntegerv", State.CURRENT_POSITION), Error.INVALID_INPUT_TYPE)


@requires(109, f"{GUIDE}, HD_INVALID_ENUM")
def unknown_parameters_are_refused(decoded: HdapiTraffic) -> Verdict:
    """A parameter that there is not is refused with HD_INVALID_ENUM, and no other error."""
    return _refused(decoded.said("hdGetDoublev", NO_ENUM), Error.INVALID_ENUM)


@requires(110, f"{GUIDE}, HD_FRAME_ERROR")
def force_needs_a_frame(decoded: HdapiTraffic) -> Verdict:
    """A force outside a frame is refused with HD_FRAME_ERROR, and no other error."""
    return _refused(decoded.said("hdSetDoublev", State.CURRENT_FORCE), Error.FRAME_ERROR)


@requires(111, f"{GUIDE}, HD_ILLEGAL_END")
def frames_end_once(decoded: HdapiTraffic) -> Verdict:
    """The end of a frame that was not begun is refused with HD_ILLEGAL_END, and no other error."""
    return _refused(decoded.said("hdEndFrame"), Error.ILLEGAL_END)


@requires(112, f"{GUIDE}, HD_BAD_HANDLE")
def unknown_handles_are_refused(decoded: HdapiTraffic) -> Verdict:
    """A frame of a handle that there is not is refused with HD_BAD_HANDLE, and no other error."""
    return _refused(decoded.said("hdBeginFrame", NO_HANDLE), Error.BAD_HANDLE)


@requires(113, f"{GUIDE}, hdGetError: a stack")
def the_newest_error_comes_first(decoded: HdapiTraffic) -> Verdict:
    """Of two errors the newer one comes first, and each once, with its device."""
    answer, init = decoded.said(ERROR_STACK), decoded.said("hdInitDevice", None)
    if answer is None or init is None:
        return not_seen(_NO_DEVICE)
    good = answer.errors == (Error.ILLEGAL_END, Error.INVALID_ENUM)
    named = set(answer.devices) == {init.returns}
    said = _names(answer.errors)
    return passed(said) if good and named else failed(said, [answer.number])


@requires(114, f"{GUIDE}, hdEnable, hdDisable and hdIsEnabled")
def force_output_can_be_switched(decoded: HdapiTraffic) -> Verdict:
    """HD_FORCE_OUTPUT is reported as enabled and as disabled."""
    found = [
        each.returns
        for each in decoded.answers
        if each.call == "hdIsEnabled" and each.arguments == (Capability.FORCE_OUTPUT,)
    ]
    if len(found) < 2:
        return not_seen(_NO_DEVICE)
    good = bool(found[0]) and not found[1]
    return passed("on and off") if good else failed(f"{found[0]}, then {found[1]}")


@requires(115, f"{GUIDE}, hdCheckCalibration")
def it_is_calibrated(decoded: HdapiTraffic) -> Verdict:
    """Out of its inkwell the device knows where it is."""
    answer = decoded.said("hdCheckCalibration")
    if answer is None:
        return not_seen(_NO_DEVICE)
    if answer.returns == Calibration.OK and not answer.errors:
        return passed("calibrated")
    known = {each.value: each.name for each in Calibration}
    said = known.get(answer.returns, f"{answer.returns:#x}")
    return failed(f"{said}, {_names(answer.errors)}", [answer.number])


@requires(116, LOOP)
def callbacks_come_at_their_rate(decoded: HdapiTraffic) -> Verdict:
    """A callback is called 1000 times a second, to 2 %."""
    phase = decoded.phase("hold")
    if phase is None:
        return not_seen(_NO_DEVICE)
    rate = len(decoded.ticks("hold")) / max(1e-9, phase.end_s - phase.start_s)
    said = f"{rate:.0f} a second"
    return passed(said) if abs(rate / RATE_HZ - 1.0) < RATE_SHARE else failed(said)


@requires(117, f"{PAGE}, safety limits: what is stable at 1 kHz is not at 50 Hz")
def callbacks_do_not_cease(decoded: HdapiTraffic) -> Verdict:
    """Two ticks are never more than 5 ms apart."""
    ticks = decoded.ticks(*SERVED)
    longest, wrong = 0.0, []
    for one, other in pairwise(ticks):
        longest = max(longest, other.time_s - one.time_s)
        if other.time_s - one.time_s > GAP_S:
            wrong.append((other.number, f"{(other.time_s - one.time_s) * 1e3:.1f} ms"))
    if wrong:
        said = f"{len(wrong)} of {len(ticks)}: {wrong[0][1]}"
        return failed(said, (n for n, _ in wrong), longest * 1e3, "ms")
    if len(ticks) < 2:
        return not_seen(_NO_TICKS)
    return passed(f"longest {longest * 1e3:.1f} ms", longest * 1e3, "ms")


@requires(118, LOOP)
def callbacks_are_regular(decoded: HdapiTraffic) -> Verdict:
    """95 % of the ticks come 0.7 to 1.3 ms after the one before."""
    ticks = decoded.ticks("hold")
    if len(ticks) < 50:
        return not_seen(_NO_TICKS)
    gaps = [other.time_s - one.time_s for one, other in pairwise(ticks)]
    share = sum(abs(gap - 1.0 / RATE_HZ) <= JITTER_S for gap in gaps) / len(gaps)
    said = f"{100.0 * share:.1f} %"
    return passed(said) if share >= JITTER_SHARE else failed(said)


@requires(119, f"{GUIDE}, HD_UPDATE_RATE")
def the_rate_is_reported(decoded: HdapiTraffic) -> Verdict:
    """HD_UPDATE_RATE is the rate that callbacks come at, to 5 %."""
    answer, phase = decoded.said("hdGetIntegerv", Info.UPDATE_RATE), decoded.phase("hold")
    if answer is None or phase is None or not decoded.ticks("hold"):
        return not_seen(_NO_TICKS)
    rate = len(decoded.ticks("hold")) / max(1e-9, phase.end_s - phase.start_s)
    said = f"{answer.values[0]:.0f} Hz"
    good = not answer.errors and abs(answer.values[0] / rate - 1.0) < 0.05
    return passed(said) if good else failed(said, [answer.number])


def _troubles(decoded: HdapiTraffic, force: bool) -> Verdict:
    ticks = decoded.ticks(*SERVED)
    wrong = (
        (tick.number, _names(tick.errors))
        for tick in ticks
        if any(is_force_error(code) == force for code in tick.errors)
    )
    return _bad(wrong, len(ticks), f"{len(ticks)} ticks")


@requires(120, f"{GUIDE}: errors of device, frame and scheduler")
def frames_raise_no_errors(decoded: HdapiTraffic) -> Verdict:
    """No frame without force raises an error of the device, the frame or the scheduler."""
    return _troubles(decoded, force=False)


@requires(121, f"{GUIDE}: errors of force")
def frames_raise_no_errors_of_force(decoded: HdapiTraffic) -> Verdict:
    """No frame without force raises an error of force or heat."""
    return _troubles(decoded, force=True)


@requires(122, f"{GUIDE}, HD_MOTOR_TEMPERATURE: 0 cold to 1 hottest")
def motors_are_cool(decoded: HdapiTraffic) -> Verdict:
    """No motor is warmer than 0.9 of its limit."""
    ticks = decoded.ticks(*SERVED)
    if not ticks:
        return not_seen(_NO_TICKS)
    most = max(max(tick.temperature) for tick in ticks)
    wrong = [tick.number for tick in ticks if max(tick.temperature) > TEMPERATURE]
    said = f"{most:.2f} at most"
    return failed(said, wrong, most) if wrong else passed(said, most)


@requires(123, f"{GUIDE}, HD_MAX_WORKSPACE_DIMENSIONS: mm")
def positions_are_in_reach(decoded: HdapiTraffic) -> Verdict:
    """Every position lies within the greatest workspace, to 20 mm."""
    box = _numbers(decoded, Info.MAX_WORKSPACE_DIMENSIONS)
    ticks = decoded.ticks("hold", "asked", "move", "press", "release")
    if not ticks or len(box) < 6:
        return not_seen(_NO_TICKS)
    bounds = list(zip(box[:3], box[3:], strict=True))

    def out(tick: Tick) -> bool:
        return any(
            not low - REACH_MARGIN_MM <= mm <= high + REACH_MARGIN_MM
            for mm, (low, high) in zip(tick.position, bounds, strict=True)
        )

    wrong = ((t.number, ", ".join(f"{mm:.0f}" for mm in t.position)) for t in ticks if out(t))
    return _bad(wrong, len(ticks), f"{len(ticks)} positions")


def _is_rotation(transform: tuple[float, ...]) -> bool:
    columns = [transform[at : at + 3] for at in (0, 4, 8)]
    for i, one in enumerate(columns):
        for j, other in enumerate(columns):
            dot = sum(a * b for a, b in zip(one, other, strict=True))
            if abs(dot - (i == j)) > SKEW:
                return False
    return True


@requires(124, f"{GUIDE}, HD_CURRENT_TRANSFORM: by columns, mm; pens of an Omni skew it slightly")
def transforms_are_rotations(decoded: HdapiTraffic) -> Verdict:
    """Every transform is a rotation, to 3 %, at the position reported beside it."""
    ticks = decoded.ticks("hold", "move")
    wrong = []
    for tick in ticks:
        if not _is_rotation(tick.transform):
            wrong.append((tick.number, "it is skewed"))
        elif math.dist(tick.transform[12:15], tick.position) > PLACE_MM:
            wrong.append((tick.number, "it is at another place"))
    return _bad(wrong, len(ticks), f"{len(ticks)} transforms")


def _place(joints: tuple[float, ...]) -> tuple[float, float, float]:
    """Position of an Omni's gimbal center with these angles, mm."""
    turret, thigh, shin = joints
    r = L1_MM * (math.cos(thigh) + math.sin(shin))
    y = L1_MM * (math.sin(thigh) - math.cos(shin)) + L3_MM
    return (-r * math.sin(turret), y, r * math.cos(turret) - L4_MM)


@requires(125, OMNI)
def joints_give_the_position(decoded: HdapiTraffic) -> Verdict:
    """An Omni's joint angles give the position reported beside them, to 2 mm."""
    model = decoded.said("hdGetString", Info.DEVICE_MODEL_TYPE)
    ticks = decoded.ticks("hold", "move")
    if model is not None and not any(each in (model.returns or "") for each in ("Omni", "Touch")):
        return not_applicable(f"a {model.returns} has other links")
    worst = max((math.dist(_place(tick.joints), tick.position) for tick in ticks), default=0.0)
    wrong = [t.number for t in ticks if math.dist(_place(t.joints), t.position) > PLACE_MM]
    said = f"{worst:.2f} mm at most"
    if wrong:
        return failed(said, wrong, worst, "mm")
    return passed(said, worst, "mm") if ticks else not_seen(_NO_TICKS)


def _spans(rows: Iterable[tuple[float, ...]]) -> list[float]:
    return [max(axis) - min(axis) for axis in zip(*rows, strict=True)]


@requires(126, f"{GUIDE}, HD_CURRENT_JOINT_ANGLES and HD_CURRENT_ENCODER_VALUES")
def every_joint_moves(decoded: HdapiTraffic) -> Verdict:
    """Moved to all sides, every joint turns by 0.05 rad and more, and its encoder counts."""
    ticks = decoded.ticks("move")
    if not ticks:
        return not_seen(_NO_TICKS)
    turns = _spans(tick.joints for tick in ticks)
    counts = _spans(tick.encoders[:3] for tick in ticks)
    said = ", ".join(f"{each:.2f}" for each in turns) + " rad"
    good = min(turns) > MOVED_RAD and min(counts) > 0.0
    return passed(said) if good else failed(said, [ticks[-1].number])


@requires(127, f"{GUIDE}, HD_CURRENT_VELOCITY: mm/s, smoothed")
def velocity_is_that_of_the_position(decoded: HdapiTraffic) -> Verdict:
    """Moved, the velocity adds up to the way that the position went, to 10 mm."""
    ticks = decoded.ticks("move")
    if len(ticks) < 2:
        return not_seen(_NO_TICKS)
    at, start, worst = [0.0, 0.0, 0.0], ticks[0].position, 0.0
    for one, other in pairwise(ticks):
        for axis in range(3):
            at[axis] += other.velocity[axis] * (other.time_s - one.time_s)
        went = [b - a for a, b in zip(start, other.position, strict=True)]
        worst = max(worst, math.dist(at, went))
    said = f"{worst:.1f} mm at most"
    if worst > DRIFT_MM:
        return failed(said, [ticks[-1].number], worst, "mm")
    return passed(said, worst, "mm")


@requires(128, f"{GUIDE}, HD_CURRENT_BUTTONS")
def buttons_are_reported_once(decoded: HdapiTraffic) -> Verdict:
    """The front button pressed and let go is bit 0, and changes once each time."""
    if decoded.phase("release") is None:
        return not_seen("none was pressed")
    levels = [tick.buttons for tick in decoded.ticks("press", "release")]
    edges = [other for one, other in pairwise(levels) if one != other]
    said = f"{len(edges)} changes"
    return passed(said) if edges == [1, 0] else failed(said)


@requires(129, f"{GUIDE}, HD_CURRENT_INKWELL_SWITCH")
def the_inkwell_is_reported(decoded: HdapiTraffic) -> Verdict:
    """The library reports the stylus in its inkwell, and out of it again."""
    ticks = decoded.ticks("dock", "undock")
    if not ticks:
        return not_seen("it was not put there")
    docked = [tick.inkwell for tick in ticks]
    if not any(docked):
        return failed("it was not reported", [ticks[-1].number])
    return failed("it stays in", [ticks[-1].number]) if docked[-1] else passed("in and out")


@requires(130, f"{GUIDE}, HD_LAST_FORCE")
def no_force_is_no_force(decoded: HdapiTraffic) -> Verdict:
    """Set to zero, the force of the frame before is zero."""
    ticks = decoded.ticks(*SERVED)
    wrong = ((tick.number, f"{tick.last}") for tick in ticks if math.hypot(*tick.last) > 0.0)
    return _bad(wrong, len(ticks), f"{len(ticks)} ticks")


@requires(131, f"{GUIDE}, hdWaitForCompletion")
def callbacks_are_known_while_they_run(decoded: HdapiTraffic) -> Verdict:
    """The library reports a callback as scheduled while it runs, and not any more once it has
    returned HD_CALLBACK_DONE."""
    found = [decoded.said("hdWaitForCompletion", phase=name) for name in ("asked", "ended")]
    reported = [each for each in found if each is not None]
    if len(reported) < 2:
        return not_seen(_NO_DEVICE)
    good = bool(reported[0].returns) and not reported[1].returns
    words = f"{reported[0].returns}, then {reported[1].returns}"
    return passed(words) if good else failed(words, [reported[1].number])


@requires(132, f"{GUIDE}, HD_CALLBACK_DONE")
def done_ends_a_callback(decoded: HdapiTraffic) -> Verdict:
    """A callback that has returned HD_CALLBACK_DONE is not called any more."""
    if decoded.phase("ended") is None:
        return not_seen(_NO_DEVICE)
    found = [tick.number for tick in decoded.ticks("ended", "let-go")]
    return failed(f"{len(found)} ticks", found) if found else passed("none came")


@requires(133, f"{GUIDE}, hdDisableDevice")
def a_disabled_device_is_gone(decoded: HdapiTraffic) -> Verdict:
    """The scheduler stops and the device is disabled without an error, and its handle is invalid
    from then on."""
    begun = decoded.said("hdBeginFrame", phase="let-go")
    if begun is None:
        return not_seen(_NO_DEVICE)
    before = [decoded.said(call, phase="let-go") for call in ("hdStopScheduler", "hdDisableDevice")]
    errors = [code for each in before if each is not None for code in each.errors]
    if errors:
        return failed(_names(errors), [begun.number])
    return _refused(begun, Error.BAD_HANDLE)


# -- level 2: a small force -----------------------------------------------------------------------


@requires(201, f"{GUIDE}, HD_LAST_FORCE")
def the_force_is_what_was_set(decoded: HdapiTraffic) -> Verdict:
    """The force that was set, 0.2 N at most, is the last force of the next frame, to 5 %."""
    ticks = decoded.ticks("force")
    if not any(tick.set_n for tick in ticks):
        return not_seen("no force was set")
    wrong = []
    for one, other in pairwise(ticks):
        allowed = FORCE_N + FORCE_SHARE * abs(one.set_n)
        if math.dist(other.last, (0.0, one.set_n, 0.0)) > allowed:
            wrong.append((other.number, f"{other.last[1]:.3f} N after {one.set_n:.3f} N"))
    return _bad(wrong, len(ticks), f"{max(t.set_n for t in ticks):.2f} N at most")


@requires(202, f"{GUIDE}: force is zero at the beginning of a frame")
def a_force_lasts_one_frame(decoded: HdapiTraffic) -> Verdict:
    """At the beginning of a frame the force is zero, whatever the one before set."""
    ticks = decoded.ticks("force")
    if not any(tick.set_n for tick in ticks):
        return not_seen("no force was set")
    wrong = ((tick.number, f"{tick.force}") for tick in ticks if math.hypot(*tick.force) > 0.0)
    return _bad(wrong, len(ticks), f"{len(ticks)} frames")


@requires(203, f"{GUIDE}: errors of force")
def a_small_force_raises_no_errors(decoded: HdapiTraffic) -> Verdict:
    """A force that rises to 0.2 N within 0.2 s raises no error."""
    ticks = decoded.ticks("force", "force-over")
    wrong = ((tick.number, _names(tick.errors)) for tick in ticks if tick.errors)
    return _bad(wrong, len(ticks), f"{len(ticks)} ticks", "no force was set")


@requires(204, f"{PAGE}: {GREATEST_N} N is less than the friction of the mechanism")
def nothing_flies(decoded: HdapiTraffic) -> Verdict:
    """Held and pushed by 0.2 N, the stylus is never faster than 0.2 m/s."""
    ticks = [tick for tick in decoded.ticks("force", "force-over") if tick.set_n]
    if not ticks:
        return not_seen("no force was set")
    speed, number = max((1e-3 * math.hypot(*tick.velocity), tick.number) for tick in ticks)
    said = f"{speed:.3f} m/s"
    if speed > SPEED_M_S:
        return failed(said, [number], speed, "m/s")
    return passed(said, speed, "m/s")


# -- level 3: by hand -----------------------------------------------------------------------------


@requires(301, f"{GUIDE}, HD_DEVICE_FAULT and HD_COMM_ERROR")
def unplugging_is_reported(decoded: HdapiTraffic) -> Verdict:
    """The plug pulled, frames raise HD_DEVICE_FAULT or HD_COMM_ERROR."""
    if decoded.phase("unplug") is None:
        return not_seen("nobody pulled it")
    codes = {code for tick in decoded.ticks("unplug") for code in tick.errors}
    reported = codes & {Error.DEVICE_FAULT, Error.COMM_ERROR}
    return passed(_names(sorted(reported))) if reported else failed(_names(sorted(codes)))
