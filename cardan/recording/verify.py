"""Verification of the controller by a record:

a new controller gets the recorded inputs of a session's loop, and its commands must equal the
recorded ones, bit for bit. Nothing is opened or sent.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cardan.errors import CaptureError, ConfigurationError, MotionRefusedError
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.cycle_record import (
    CycleRecord,
    RecordedRequest,
    RecordError,
    command_text,
    decode_cycle,
)
from cardan.gateway.arm.states import Inhibit
from cardan.gateway.session.assembly import make_controller, make_robot, make_verbs
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.protocols.ros2.cdr import MalformedCdr, codec_of
from cardan.recording.arms import CONFIGURATION
from cardan.recording.mcap_file import RecordReader
from cardan.recording.replay_requests import REPEAT, repeat

if TYPE_CHECKING:  # Imports Pinocchio, which a session without an arm's model does not need.
    from cardan.gateway.arm.verb_methods import ArmVerbs

CONTROLLER_LOG = "/controller_log"
"""Suffix of a session's topic, after its node's name."""
FORMER_LOG = "/engine"
"""The suffix in records from before 0.2.0."""

_STRING = "std_msgs/msg/String"


def _place_neighbor(controller: ArmController, text: str) -> None:
    try:
        index, joints, ways_m = json.loads(text)
        controller.place_neighbor(index, joints, ways_m)
    except (ValueError, TypeError, IndexError, RecursionError):
        raise CaptureError(
            f"the record has no neighbor's joints and ways in {text!r:.80}"
        ) from None


def _inhibit(kind: Inhibit) -> Callable[[ArmController, str], object]:
    return lambda controller, reason: controller.inhibit(reason, kind)


REPEATED: Mapping[str, Callable[[ArmController, str], object]] = {
    "stop": lambda controller, reason: controller.stop(reason),
    "place_neighbor": _place_neighbor,
    "acknowledge": lambda controller, _reason: controller.acknowledge(),
    **{kind.value: _inhibit(kind) for kind in Inhibit},
}
"""Controller requests repeated unchanged; programs' are in
:mod:`cardan.recording.replay_requests`."""


class Difference(NamedTuple):
    """First cycle whose command differs."""

    cycle: int
    stamp_s: float
    """Stamp of the robot's state."""
    recorded: str
    computed: str


@dataclass
class Verification:
    """Result for one session."""

    session: str
    """Full name of the session's node."""
    cycles: int = 0
    """Cycles whose commands were compared and equal."""
    difference: Difference | None = None
    ended: str = ""
    """Reason why not all cycles could be compared; empty if they were."""
    versions: dict[str, str] = field(default_factory=dict)
    """Versions that the session ran with."""
    problems: list[str] = field(default_factory=list)
    """Problems of the file."""

    @property
    def same(self) -> bool:
        """True if all compared commands, at least one, equal the recorded ones."""
        return self.difference is None and self.cycles > 0

    def lines(self) -> list[str]:
        """Return the result as lines of text."""
        said = [f"{self.session}: {self.cycles} cycles, each command bit for bit the recorded one"]
        if self.difference is not None:
            cycle, stamp_s, recorded, computed = self.difference
            said = [
                f"{self.session}: the command of cycle {cycle} (at {stamp_s:.6f} s) differs, after "
                f"{self.cycles} that are the same",
                f"  recorded  {recorded}",
                f"  computed  {computed}",
            ]
        if self.ended:
            said.append(f"  {self.ended}")
        return said + [f"  {each}" for each in self.problems]


class _Session(NamedTuple):
    report: Verification
    cycles: list[CycleRecord]
    tables: Mapping[str, Any]


def verify(
    path: Path, changed: Callable[[SessionConfig], SessionConfig] | None = None
) -> list[Verification]:
    """Replay each session of a record; `changed` may change its configuration first.

    Raises CaptureError if there is none, or if an older version made a record or configuration that
    this one cannot use; ConfigurationError if `changed` made an unusable one.
    """
    reader = RecordReader(path)
    configurations: dict[str, Any] = {}
    cycles: dict[str, list[CycleRecord]] = {}
    former = ""
    for message in reader:
        topic = message.topic
        if topic.name.endswith(FORMER_LOG) and topic.type_name == _STRING:
            former = topic.name
        for end in (CONFIGURATION, CONTROLLER_LOG):
            if topic.name.endswith(end) and topic.type_name == _STRING:
                node = topic.name.removesuffix(end)
                text = _text(message.data)
                try:
                    if end == CONFIGURATION:
                        configurations.setdefault(node, json.loads(text))
                    else:
                        cycles.setdefault(node, []).append(decode_cycle(text))
                except RecordError as error:
                    raise CaptureError(f"{path}: {topic.name}: {error}") from None
                except (ValueError, RecursionError):
                    continue  # Another node's topic with that suffix.
    if not cycles and former:
        raise CaptureError(
            f"{path} has {former} in place of {CONTROLLER_LOG[1:]}: an older version of Cardan "
            "made it; verify it by that one"
        )
    if not cycles:
        raise CaptureError(
            f"{path} has no {CONTROLLER_LOG[1:]} topic of a session: `cardan net record` makes it, "
            "of sessions with a [network]"
        )
    reports = []
    for node, records in sorted(cycles.items()):
        if node not in configurations:
            raise CaptureError(f"{path} has no {node}{CONFIGURATION}, which the session publishes")
        described = configurations[node]
        if not isinstance(described, dict) or not isinstance(described.get("tables"), dict):
            raise CaptureError(f"{path}: {node}{CONFIGURATION} has no tables of a configuration")
        versions = described.get("versions")
        if not isinstance(versions, dict):
            versions = {}
        try:
            config = parse_config(described["tables"], from_file=False)
        except ConfigurationError as error:
            raise CaptureError(
                f"{path}: this version of Cardan cannot use {node}{CONFIGURATION}, which "
                f"{versions.get('cardan', 'an unknown version')} wrote; replay it by that one: "
                f"{error}"
            ) from None
        if changed is not None:
            config = changed(config)
        report = replay_cycles(config, records)
        report.session, report.versions = node, versions
        report.problems = reader.problems
        reports.append(report)
    return reports


def replay_cycles(config: SessionConfig, records: Iterable[CycleRecord]) -> Verification:
    """Run the cycles of a session through a new controller until a command differs.

    Raises ConfigurationError for a configuration that cannot be used here.
    """
    report = Verification("")
    if config.filters:
        names = ", ".join(each.filter for each in config.filters)
        report.ended = f"not replayed: what the filters read is not in the record ({names})"
        return report
    robot = make_robot(config)
    controller = make_controller(config, robot)
    verbs: ArmVerbs | None = None
    for record in records:
        if record.number != report.cycles + 1:
            report.ended = (
                f"not replayed from cycle {report.cycles + 1} on: the record continues with "
                f"{record.number}"
                + ("; start `cardan net record` before the session" if not report.cycles else "")
            )
            return report
        for request in record.before:
            if request.name in REPEATED:
                REPEATED[request.name](controller, request.argument)
            elif request.name in REPEAT:
                # Their effect is in the motions that they begin, from the first one on.
                verbs = verbs or make_verbs(config, robot, controller, None)
                with contextlib.suppress(MotionRefusedError, ConfigurationError):
                    repeat(verbs, request.name, request.argument)
            else:
                report.ended = _why(record.number, request)
                return report
        if record.device is None:
            command = controller.tick(record.robot)
        else:
            command = controller.tick(record.robot, record.device, record.events)
        if (computed := command_text(command)) != record.command:
            report.difference = Difference(
                record.number, record.robot.stamp_s, record.command, computed
            )
            return report
        report.cycles += 1
    return report


def _why(number: int, request: RecordedRequest) -> str:
    return (
        f"not replayed from cycle {number} on: {request.name} {request.argument}: motions of "
        "programs are planned outside the loop, for a time that is not recorded"
    )


def _text(data: bytes) -> str:
    message = codec_of(_STRING).decode(data)
    return "" if isinstance(message, MalformedCdr) else str(message["data"])
