"""Messages between the computer that shares a device and the one that uses it.

cardan_msgs/SharedDevice has the newest state, and the unacknowledged button edges.
cardan_msgs/DeviceClaim requests the device or renews its lease, has its time of sending and the
lateness of states, acknowledges edges, and has the feedback and the force. Times are monotonic, s,
each by its sender's clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple, get_args, get_type_hints

from cardan.common.haptics import (
    MAX_FIXTURES,
    Fixture,
    HapticCommand,
    HapticState,
    Matrix3,
    MeasuredForce,
    OperatingState,
    WorldMap,
)
from cardan.protocols.ros2.cdr import MalformedCdr, Message, Template, codec_of
from cardan.spatial import normalized
from cardan.types import (
    NEUTRAL,
    NEVER_S,
    Axes,
    DeviceCapabilities,
    DeviceFeedback,
    DeviceLink,
    DeviceState,
    Frame,
    Inertia,
    Pose,
    Quaternion,
    Vector3,
    Wrench,
)

STATE_TYPE, CLAIM_TYPE = "cardan_msgs/msg/SharedDevice", "cardan_msgs/msg/DeviceClaim"

VERSION = 3
"""Version of both messages."""

CLAIM_PERIOD_S = 0.03
"""Period of the lessee's claims; each is answered by a state at once."""

FORCE_PERIOD_S = 0.008
"""The same while there is haptic feedback."""

MOST_EDGES = 64
"""Most unacknowledged edges. A hand makes some ten a second."""

MOST_BUTTONS = 256
MOST_TEXT = 200
LARGEST = 1e6
"""Largest plausible measurement, in SI units."""

FEEDBACK = frozenset({"led", "rumble"})
"""Feedback channels passed back besides force, which has a control law at either end."""

FIXTURES: Mapping[str, type[Any]] = {each.__name__: each for each in get_args(Fixture)}
_SIZES = {Vector3: 3, Matrix3: 9, float: 1, bool: 1}
"""Count of numbers in a field of a fixture, by its type."""


def state_topic(name: str) -> str:
    """Return the topic on which a shared device is published."""
    return f"/shared/{name}/state"


def claim_topic(name: str) -> str:
    """Return the topic of its claims."""
    return f"/shared/{name}/claim"


class RemoteHapticCommand(NamedTuple):
    """Haptic command for the device."""

    command: HapticCommand
    """Sequence number by the session; its stamp is valid only there."""
    answers_s: float
    """Stamp of the device's state that it was computed from, by the device's clock."""


class HapticFeedback(NamedTuple):
    """Haptic feedback of the device."""

    state: HapticState
    """Haptic state, of which a message has a part; `command_sequence` is the session's."""
    largest_n: float
    """Largest force that the device exerts."""


class Edge(NamedTuple):
    """Button edge, numbered from 1 since the begin of the lease."""

    number: int
    stamp_s: float
    button: str
    pressed: bool


class Shared(NamedTuple):
    """A message with the state of a shared device."""

    run: int
    """Number of the sharing process, new with each process."""
    sent_s: float
    lessee: int
    """Holder of the lease; 0: none."""
    lessee_name: str
    asked_s: float
    """Stamp of the lessee's newest claim, by its clock."""
    state: DeviceState
    """Its stamp by the sender's clock."""
    edges: tuple[Edge, ...] = ()
    """Unacknowledged edges, oldest first."""
    driver: str = ""
    capabilities: DeviceCapabilities | None = None
    """Capabilities, sent in answers to claims."""
    haptic_feedback: HapticFeedback | None = None
    """Haptic feedback; None: the device exerts no force."""


class Claim(NamedTuple):
    """Message in which a session claims a device, or gives it back."""

    lessee: int
    name: str
    asked_s: float
    wanted: bool
    """False: the device is given back."""
    edges: int
    """Number of the newest edge received there."""
    feedback: DeviceFeedback
    order: RemoteHapticCommand | None = None
    late_s: float = 0.0
    """Delay of the newest state on arrival beyond a quick one's."""


class UnusableError(ValueError):
    """Reason why a message is unusable, printed behind "messages"."""


def shared_message(shared: Shared) -> Message:
    """Convert to a cardan_msgs/SharedDevice."""
    state, able = shared.state, shared.capabilities
    inertia = state.inertia
    measured = [] if inertia is None else [each for each in inertia if each is not None]
    wrench = state.wrench
    return {
        "version": VERSION,
        "run": shared.run,
        "sent": shared.sent_s,
        "lessee": shared.lessee,
        "lessee_name": shared.lessee_name,
        "asked": shared.asked_s,
        "link": state.link.value,
        "reason": state.reason[:MOST_TEXT],
        "report": state.stamp_s,
        "axes": state.axes,
        "buttons": sorted(state.buttons),
        "edges": [
            {"number": number, "stamp": stamp_s, "button": button, "pressed": pressed}
            for number, stamp_s, button, pressed in shared.edges
        ],
        "pose": [] if state.pose is None else [state.pose.to_ros()],
        "wrench": [] if wrench is None else [wrench.to_ros()],
        "wrench_in_tool": wrench is not None and wrench.frame is Frame.TOOL,
        "inertia": [each.to_ros() for each in measured],
        "battery": [] if state.battery is None else [state.battery],
        "abilities": []
        if able is None
        else [
            {
                "driver": shared.driver,
                "gives_pose": able.gives_pose,
                "gives_axes": able.gives_axes,
                "gives_inertia": able.gives_inertia,
                "battery": able.battery,
                "buttons": able.buttons,
                "further_buttons": able.further_buttons,
                "feedback": sorted(able.feedback & FEEDBACK),
            }
        ],
        "haptic_feedback": []
        if shared.haptic_feedback is None
        else [_haptic_message(shared.haptic_feedback)],
    }


_MOTION = ("sent", "asked", "report", "axes")
"""Fields that change from message to message while an operator only deflects the device."""


def _only_deflects(shared: Shared) -> bool:
    state = shared.state
    return not (
        shared.edges
        or shared.capabilities
        or shared.haptic_feedback
        or state.pose
        or state.wrench
        or state.inertia
    )


class SharedEncoder:
    """Encoder of cardan_msgs/SharedDevice. Of messages that differ in their times and axes only, it
    overwrites these."""

    def __init__(self) -> None:
        self._rest: Shared | None = None
        self._template: Template | None = None

    def encode(self, shared: Shared) -> bytes:
        """Encode a message."""
        if not _only_deflects(shared):
            return codec_of(STATE_TYPE).encode(shared_message(shared))
        state = shared.state
        rest = shared._replace(
            sent_s=0.0, asked_s=0.0, state=state._replace(stamp_s=0.0, axes=NEUTRAL)
        )
        template = self._template
        if template is None or rest != self._rest:
            template = Template(STATE_TYPE, shared_message(shared))
            self._rest, self._template = rest, template
        else:
            template.slot("sent")(shared.sent_s)
            template.slot("asked")(shared.asked_s)
            template.slot("report")(state.stamp_s)
            template.slot("axes")(*state.axes)
        return bytes(template.data)


class SharedDecoder:
    """Decoder of cardan_msgs/SharedDevice. Of messages that differ in their times and axes only, it
    reads these."""

    def __init__(self) -> None:
        self._last: Shared | None = None
        self._numbers: Callable[[bytes], tuple[float, ...] | None] = lambda _data: None

    def decode(self, data: bytes) -> Shared | MalformedCdr:
        """Decode a message. Raises UnusableError."""
        if (last := self._last) is not None and (numbers := self._numbers(data)) is not None:
            sent_s, asked_s, report_s, *axes = numbers
            sent_s, asked_s, report_s = _times(sent_s, asked_s, report_s)
            state = last.state._replace(stamp_s=report_s, axes=_axes(axes))
            return last._replace(sent_s=sent_s, asked_s=asked_s, state=state)
        message = codec_of(STATE_TYPE).decode(data)
        if isinstance(message, MalformedCdr):
            return message
        shared = read_shared(message)
        if _only_deflects(shared):
            self._last, self._numbers = shared, Template(STATE_TYPE, message).reader(*_MOTION)
        return shared


def read_shared(message: Message) -> Shared:
    """Decode a cardan_msgs/SharedDevice. Raises UnusableError."""
    _check_version(message)
    sent_s, asked_s, report_s = _times(message["sent"], message["asked"], message["report"])
    try:
        link = DeviceLink(message["link"])
    except ValueError:
        raise UnusableError(f"with a link {message['link'][:20]!r}") from None
    battery = _at_most_one(message["battery"], "batteries")
    inertia = [_vector(each, "inertia") for each in message["inertia"][:2]]
    state = DeviceState(
        report_s,
        link,
        _axes(message["axes"]),
        frozenset(_names(message["buttons"], "buttons")),
        _pose(_at_most_one(message["pose"], "poses")),
        None if battery is None else _share(battery, "battery"),
        message["reason"][:MOST_TEXT],
        _wrench(_at_most_one(message["wrench"], "wrenches"), message["wrench_in_tool"]),
        Inertia(*inertia) if inertia else None,
    )
    able = _at_most_one(message["abilities"], "abilities")
    return Shared(
        message["run"],
        sent_s,
        message["lessee"],
        message["lessee_name"][:MOST_TEXT],
        asked_s,
        state,
        _edges(message["edges"], sent_s),
        "" if able is None else able["driver"][:MOST_TEXT],
        None if able is None else _capabilities(able),
        _haptic_feedback(_at_most_one(message["haptic_feedback"], "forces")),
    )


def claim_message(claim: Claim) -> Message:
    """Convert to a cardan_msgs/DeviceClaim."""
    led, rumble = claim.feedback.led, claim.feedback.rumble
    return {
        "version": VERSION,
        "lessee": claim.lessee,
        "lessee_name": claim.name,
        "asked": claim.asked_s,
        "late": claim.late_s,
        "wanted": claim.wanted,
        "edges": claim.edges,
        "led": [] if led is None else [led],
        "rumble": [] if rumble is None else [rumble],
        "force": [] if claim.order is None else [_order_message(claim.order)],
    }


def read_claim(message: Message) -> Claim:
    """Decode a cardan_msgs/DeviceClaim. Raises UnusableError."""
    _check_version(message)
    if not message["lessee"]:
        raise UnusableError("of nobody")
    rumble = _at_most_one(message["rumble"], "rumbles")
    late_s = _number(message["late"], "a lateness")
    if late_s < 0.0:
        raise UnusableError("of a negative lateness")
    return Claim(
        message["lessee"],
        message["lessee_name"][:MOST_TEXT],
        _time(message["asked"], "asked"),
        message["wanted"],
        message["edges"],
        DeviceFeedback(
            _at_most_one(message["led"], "lights"),
            None if rumble is None else _share(rumble, "rumble"),
        ),
        _order(_at_most_one(message["force"], "forces")),
        late_s,
    )


def _order_message(order: RemoteHapticCommand) -> Message:
    command, answers_s = order
    world, measured = command.world, command.measured
    return {
        "number": command.sequence,
        "answers": answers_s,
        "engaged": command.engaged,
        "linear": world.linear,
        "offset": world.offset.to_ros(),
        "rotation": world.rotation,
        "force_scale": command.force_scale,
        "fixtures": [
            {"shape": type(each).__name__, "values": list(flat(each))} for each in command.fixtures
        ],
        "force": command.force.to_ros(),
        "measured": [] if measured is None else [measured.force.to_ros()],
        "absorbed": 0.0 if measured is None else measured.absorbed_j,
    }


def _order(value: Message | None) -> RemoteHapticCommand | None:
    if value is None:
        return None
    answers_s = value["answers"]
    measured = _at_most_one(value["measured"], "measured forces")
    absorbed_j = _number(value["absorbed"], "an energy")
    if absorbed_j < 0.0:
        raise UnusableError("of a negative energy")
    if len(value["fixtures"]) > MAX_FIXTURES:
        raise UnusableError(f"with more than {MAX_FIXTURES} fixtures")
    command = HapticCommand(
        value["number"],
        NEVER_S,
        value["engaged"],
        WorldMap(
            _matrix(value["linear"]), _vector(value["offset"], "a map"), _matrix(value["rotation"])
        ),
        tuple(map(_fixture, value["fixtures"])),
        None
        if measured is None
        else MeasuredForce(_vector(measured, "a force"), NEVER_S, absorbed_j=absorbed_j),
        _vector(value["force"], "a force"),
        _share(value["force_scale"], "scale of force"),
    )
    return RemoteHapticCommand(
        command, answers_s if answers_s == NEVER_S else _time(answers_s, "answers")
    )


def flat(value: Any) -> Iterator[float]:
    """Yield all numbers in nested tuples."""
    if isinstance(value, tuple):
        for each in value:
            yield from flat(each)
    else:
        yield float(value)


def _fixture(value: Message) -> Fixture:
    kind = FIXTURES.get(value["shape"])
    if kind is None:
        raise UnusableError(f"with a fixture {value['shape'][:20]!r}")
    fields = get_type_hints(kind)
    numbers = [_number(each, "a fixture") for each in value["values"]]
    if len(numbers) != sum(_SIZES[each] for each in fields.values()):
        raise UnusableError("with a fixture of too few or too many numbers")
    rest = iter(numbers)
    made: dict[str, Any] = {}
    for name, each in fields.items():
        part = tuple(islice(rest, _SIZES[each]))
        made[name] = Vector3(*part) if each is Vector3 else part if each == Matrix3 else each(*part)
    fixture: Fixture = kind(**made)
    return fixture


def _haptic_message(haptic_feedback: HapticFeedback) -> Message:
    state = haptic_feedback.state
    return {
        "number": state.command_sequence,
        "state": state.state.value,
        "reason": state.reason[:MOST_TEXT],
        "rendering": state.rendering,
        "commanded": state.force_commanded.to_ros(),
        "force": state.force.to_ros(),
        "largest": haptic_feedback.largest_n,
        "peak": state.peak_n,
        "energy": state.energy_j,
        "delivered": state.delivered_j,
        "given_peak": state.given_peak_j,
        "damping": state.passivity_damping_n_s_m,
        "derating": state.thermal_derating,
        "age": min(state.force_age_s, LARGEST),
        "faults": state.faults,
    }


def _haptic_feedback(value: Message | None) -> HapticFeedback | None:
    if value is None:
        return None
    try:
        operating = OperatingState(value["state"])
    except ValueError:
        raise UnusableError(f"with a state of force {value['state'][:20]!r}") from None

    state = HapticState(
        state=operating,
        reason=value["reason"][:MOST_TEXT],
        rendering=value["rendering"],
        force_commanded=_vector(value["commanded"], "a force"),
        force=_vector(value["force"], "a force"),
        peak_n=_number(value["peak"], "a force"),
        energy_j=_number(value["energy"], "a force"),
        delivered_j=_number(value["delivered"], "a force"),
        given_peak_j=_number(value["given_peak"], "a force"),
        passivity_damping_n_s_m=_number(value["damping"], "a force"),
        thermal_derating=_share(value["derating"], "derating"),
        force_age_s=math.inf if value["age"] == LARGEST else _number(value["age"], "a force"),
        command_sequence=value["number"],
        faults=value["faults"],
    )
    return HapticFeedback(state, _number(value["largest"], "a force"))


def _matrix(values: Sequence[float]) -> Matrix3:
    a, b, c, d, e, f, g, h, i = (_number(each, "a map") for each in values)
    return (a, b, c, d, e, f, g, h, i)


def _check_version(message: Message) -> None:
    if message["version"] != VERSION:
        raise UnusableError(
            f"of version {message['version']}, where this Cardan speaks {VERSION}: install the "
            "same "
            "one on both computers"
        )


def _at_most_one(values: Sequence[Any], what: str) -> Any:
    if len(values) > 1:
        raise UnusableError(f"with several {what}")
    return values[0] if values else None


def _number(value: float, what: str) -> float:
    if not abs(value) <= LARGEST:
        raise UnusableError(f"with {what} that are not numbers")
    return value


def _time(value: float, what: str) -> float:
    if not math.isfinite(value):
        raise UnusableError(f"with an invalid time {what}")
    return value


def _times(sent_s: float, asked_s: float, report_s: float) -> tuple[float, float, float]:
    _time(sent_s, "sent")
    if report_s != NEVER_S and _time(report_s, "report") > sent_s:
        raise UnusableError("with a report that is newer than they are")
    if asked_s != NEVER_S:
        _time(asked_s, "asked")
    return sent_s, asked_s, report_s


def _share(value: float, what: str) -> float:
    if not 0.0 <= value <= 1.0:
        raise UnusableError(f"with a {what} beyond 0 to 1")
    return value


def _axes(values: Sequence[float]) -> Axes:
    if not all(-1.0 <= each <= 1.0 for each in values):
        raise UnusableError("with axes beyond -1 to 1, or that are not numbers")
    x, y, z, roll, pitch, yaw = values
    return Axes(x, y, z, roll, pitch, yaw) if any(values) else NEUTRAL


def _vector(value: Message, what: str) -> Vector3:
    return Vector3(*(_number(value[key], what) for key in ("x", "y", "z")))


def _pose(value: Message | None) -> Pose | None:
    if value is None:
        return None
    place, turn = value["position"], value["orientation"]
    q = Quaternion(*(_number(turn[key], "a pose") for key in ("w", "x", "y", "z")))
    if not 0.99 < math.hypot(*q) < 1.01:
        raise UnusableError("with an orientation that is not a unit quaternion")
    return Pose(_vector(place, "a pose"), normalized(q))


def _wrench(value: Message | None, in_tool: bool) -> Wrench | None:
    if value is None:
        return None
    frame = Frame.TOOL if in_tool else Frame.BASE
    return Wrench(_vector(value["force"], "a force"), _vector(value["torque"], "a torque"), frame)


def _names(values: Sequence[str], what: str) -> tuple[str, ...]:
    if len(values) > MOST_BUTTONS:
        raise UnusableError(f"with more than {MOST_BUTTONS} {what}")
    if not all(0 < len(each) <= MOST_TEXT for each in values):
        raise UnusableError(f"with {what} that have no name, or too long a one")
    return tuple(values)


def _edges(values: Sequence[Message], sent_s: float) -> tuple[Edge, ...]:
    if len(values) > MOST_EDGES:
        raise UnusableError(f"with more than {MOST_EDGES} edges")
    _names([each["button"] for each in values], "buttons")
    edges = tuple(
        Edge(each["number"], each["stamp"], each["button"], each["pressed"]) for each in values
    )
    numbers = [each.number for each in edges]
    first = numbers[0] if numbers else 1
    if first < 1 or numbers != list(range(first, first + len(numbers))):
        raise UnusableError("with edges out of order")
    if not all(each.stamp_s <= sent_s for each in edges):
        raise UnusableError("with edges that are newer than they are")
    return edges


def _capabilities(value: Message) -> DeviceCapabilities:
    return DeviceCapabilities(
        gives_pose=value["gives_pose"],
        buttons=_names(value["buttons"], "buttons"),
        feedback=FEEDBACK & frozenset(value["feedback"]),
        battery=value["battery"],
        gives_axes=value["gives_axes"],
        gives_inertia=value["gives_inertia"],
        further_buttons=_names(value["further_buttons"], "buttons"),
    )
