"""Conversion of records to episodes of frames at a fixed rate, as learning programs read them.
Sources are the topics that a session publishes of its arm (:mod:`cardan.gateway.bus.arm_topics`):
all values of an instant have the stamp of the robot's state."""

from __future__ import annotations

import bisect
import itertools
import json
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from cardan.common.tables import read_table
from cardan.errors import CaptureError, ConfigurationError, OptionError
from cardan.gateway.session.config import ArmTable
from cardan.protocols.ros2.cdr import MalformedCdr, Message, codec_of
from cardan.protocols.ros2.interfaces import InterfaceError
from cardan.recording.arms import (
    CONFIGURATION,
    NS,
    POSE,
    SNAPSHOT,
    STATUS,
    TARGET,
    choose_arm,
    stamped_ns,
)
from cardan.recording.mcap_file import RecordedMessage, RecordReader
from cardan.robots import load_arm
from cardan.spatial import (
    from_rotation_vector,
    is_finite,
    multiply,
    normalized,
    rotation_between,
    scale,
)
from cardan.types import Frame, Pose, Quaternion, Vector3
from cardan_learning.features import (
    CLOSED,
    WIDE,
    ActionKind,
    Continuous,
    action_names,
    observation_names,
    reference_of,
    six_of,
)

LONGEST_GAP_NS = NS // 5
"""Longest time between two states; a longer gap is reported, and the state before it holds until
its end."""

LONGEST_FILL_S = 10.0
"""Default of the longest gap within an episode: a longer one ends the episode, and another begins
after it."""

FEWEST_FRAMES = 2
"""Frames of the shortest episode; shorter ones are dropped and reported."""

JOINTS = "/joint_states"
"""End of the topic's name, after the node's namespace."""


class Gap(NamedTuple):
    """Two successive samples that are too far apart."""

    what: str
    at_ns: int
    long_ns: int


@dataclass
class Track:
    """Values with increasing stamps."""

    what: str
    stamps_ns: list[int] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)
    disordered: int = 0
    """Number of values dropped because their stamps did not increase."""
    unusable: int = 0
    """Number of values dropped because they are not numbers, or not as many as before."""

    def add(self, stamp_ns: int, value: tuple[float, ...]) -> None:
        """Add a value if it is later than those before."""
        if not is_finite(value) or (self.values and len(value) != len(self.values[0])):
            self.unusable += 1
        elif self.stamps_ns and stamp_ns <= self.stamps_ns[-1]:
            self.disordered += 1
            if self._newest_is_alone_before(stamp_ns):
                self.stamps_ns[-1], self.values[-1] = stamp_ns, value
        else:
            self.stamps_ns.append(stamp_ns)
            self.values.append(value)

    def _newest_is_alone_before(self, stamp_ns: int) -> bool:
        """Return True if the newest value is far from the previous one and from this one, which
        follow each other: its stamp is of a clock that was set."""
        if self.stamps_ns[-1] - stamp_ns <= LONGEST_GAP_NS:
            return False
        return len(self.stamps_ns) == 1 or (
            self.stamps_ns[-2] < stamp_ns
            and self.stamps_ns[-1] - self.stamps_ns[-2] > LONGEST_GAP_NS
        )

    def at(self, stamp_ns: int) -> tuple[tuple[float, ...], tuple[float, ...], float]:
        """Return the values before and after a time within the track, and the share of the way
        between them, 0 to 1; within a gap 0."""
        index = min(bisect.bisect_right(self.stamps_ns, stamp_ns), len(self.stamps_ns) - 1)
        before_ns, after_ns = self.stamps_ns[index - 1], self.stamps_ns[index]
        if stamp_ns >= after_ns:
            return self.values[index], self.values[index], 0.0
        share = (stamp_ns - before_ns) / (after_ns - before_ns)
        if after_ns - before_ns > LONGEST_GAP_NS:
            share = 0.0
        return self.values[index - 1], self.values[index], share

    def gaps(self, first_ns: int, last_ns: int) -> Iterator[Gap]:
        """Yield the gaps within a time."""
        for before_ns, after_ns in itertools.pairwise(self.stamps_ns):
            if (
                after_ns - before_ns > LONGEST_GAP_NS
                and before_ns < last_ns
                and after_ns > first_ns
            ):
                yield Gap(self.what, before_ns, after_ns - before_ns)


@dataclass
class Changes:
    """Values that hold until the next one."""

    stamps_ns: list[int] = field(default_factory=list)
    values: list[str] = field(default_factory=list)

    def add(self, stamp_ns: int, value: str) -> None:
        """Add a value; a value that came late holds from the newest one's time on."""
        if not self.values or self.values[-1] != value:
            newest_ns = self.stamps_ns[-1] if self.stamps_ns else stamp_ns
            self.stamps_ns.append(max(stamp_ns, newest_ns))
            self.values.append(value)

    def at(self, stamp_ns: int) -> str:
        """Return the value at a time; "" before the first one."""
        index = bisect.bisect_right(self.stamps_ns, stamp_ns)
        return self.values[index - 1] if index else ""


@dataclass
class ArmTracks:
    """Tracks of an arm in a record."""

    joints: Track = field(default_factory=lambda: Track("joints"))
    names: tuple[str, ...] = ()
    """Track of the joints."""
    poses: Track = field(default_factory=lambda: Track("measured poses"))
    """Track of the measured TCP: position and quaternion, scalar first."""
    targets: Track = field(default_factory=lambda: Track("commanded poses"))
    """Track of the commanded TCP, in the same form."""
    authority: Changes = field(default_factory=Changes)
    """Source that had the authority."""
    gripper: Changes = field(default_factory=Changes)
    """State of the gripper, "closed" or "open"."""
    model: str = ""
    """Model of the arm from its session's configuration; empty: not known on this computer."""
    reference: Vector3 | None = None
    """Reference of rotation vectors: that of the model with the session's tool; None: no model."""

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Return the tracks that frames are made of."""
        return self.joints, self.poses, self.targets

    @property
    def missing(self) -> str:
        """Return the names of tracks too short for a single frame; empty: none."""
        return ", ".join(each.what for each in self.tracks if len(each.values) < FEWEST_FRAMES)

    @property
    def rate_hz(self) -> float:
        """Return the number of states per second."""
        stamps_ns = self.poses.stamps_ns
        periods = [b - a for a, b in itertools.pairwise(stamps_ns)]
        return NS / statistics.median(periods)


@dataclass
class Episode:
    """Frames at a fixed rate."""

    record: Path
    began_ns: int
    """Stamp of the first frame, ns since the epoch."""
    observations: list[tuple[float, ...]]
    actions: list[tuple[float, ...]]
    gaps: list[Gap]


@dataclass
class Frames:
    """All exported data, and the report on it."""

    fps: int
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...]
    model: str
    """Model of the arm; empty: the records name none that is known on this computer."""
    written: Continuous
    """Converter to rotation vectors."""
    episodes: list[Episode] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def read_frames(
    paths: Sequence[Path],
    fps: int,
    *,
    arm: str = "",
    each_engagement: bool = False,
    longest_gap_s: float = LONGEST_FILL_S,
) -> Frames:
    """Episodes of records, one a file, or one for each time in which a source had the authority.

    `arm`: full name of an arm's node; empty: the only one. `longest_gap_s`: longest time without a
    state that is filled; a longer one ends an episode. Raises CaptureError, OptionError.
    """
    found = [(path, *_read(path, arm)) for path in paths]
    names = found[0][1].names
    model, reference = found[0][1].model, found[0][1].reference
    written = Continuous(reference)
    frames = Frames(
        fps, observation_names(names, True), action_names(ActionKind.POSE, True), model, written
    )
    for path, tracks, problems in found:
        if tracks.names != names:
            raise CaptureError(
                f"{path} is of another arm than {paths[0]}: joints {', '.join(tracks.names)} and "
                f"{', '.join(names)}"
            )
        if tracks.reference != reference:
            frames.problems.append(
                f"{path}: its arm has another model or tool than that of {paths[0]}, by whose home "
                "rotation vectors are written"
            )
        if fps > 1.05 * tracks.rate_hz:
            raise OptionError(
                "--fps",
                fps,
                f"at most {tracks.rate_hz:.0f}, as many states a second are in {path} (rate_hz of "
                "[network] when it was recorded)",
            )
        frames.problems += (f"{path}: {each}" for each in problems)
        for track in tracks.tracks:
            frames.problems += _reported(path, track)
        breaks = _breaks(tracks, longest_gap_s)
        frames.problems += (
            f"{path}: {each.what}: nothing for {each.long_ns / NS:.1f} s: the episode ends there "
            "(a clock was set, or nothing was published; --longest-gap)"
            for each in breaks
        )
        for first_ns, last_ns in _without(breaks, _spans(tracks, each_engagement)):
            episode = _episode(path, tracks, first_ns, last_ns, fps, written)
            if len(episode.actions) < FEWEST_FRAMES:
                frames.problems.append(
                    f"{path}: {1e-9 * (last_ns - first_ns):.2f} s are too short for an episode"
                )
            else:
                frames.episodes.append(episode)
    if not frames.episodes:
        raise CaptureError(f"{', '.join(map(str, paths))}: no episode is in there")
    return frames


def _reported(path: Path, track: Track) -> Iterator[str]:
    if track.disordered:
        yield (
            f"{path}: {track.disordered} {track.what} left out: their stamps were not above those "
            "before (a clock was set, or two programs publish)"
        )
    if track.unusable:
        yield f"{path}: {track.unusable} {track.what} left out: they are not numbers, or too few"


# -- reading --------------------------------------------------------------------------------------


def _read(path: Path, arm: str) -> tuple[ArmTracks, list[str]]:
    """Return an arm's tracks in a record, and the faults of the file."""
    reader = RecordReader(path)
    found: dict[str, ArmTracks] = {}
    joints: list[RecordedMessage] = []
    for message in reader:
        name = message.topic.name
        if name.endswith(JOINTS):
            joints.append(message)
        for end, take in _TAKEN.items():
            if name.endswith(end):
                _take(found.setdefault(name.removesuffix(end), ArmTracks()), take, message)
    node = choose_arm(
        {name for name, each in found.items() if each.poses.values}, arm, path, reader.problems
    )
    tracks = found[node]
    namespace = node.rpartition("/")[0]
    for message in joints:
        topic = message.topic
        if topic.name == f"{namespace}{JOINTS}" and node in (topic.publishers or (node,)):
            _take(tracks, _take_joints, message)
    if tracks.missing:
        raise CaptureError(f"{path}: {node} has too few {tracks.missing} for a frame")
    return tracks, reader.problems


_Take = Callable[[ArmTracks, Message, int], None]


def _take(tracks: ArmTracks, take: _Take, message: RecordedMessage) -> None:
    try:
        decoded = codec_of(message.topic.type_name).decode(message.data)
        if not isinstance(decoded, MalformedCdr):
            take(tracks, decoded, message.publish_ns)
    except (ValueError, KeyError, TypeError, InterfaceError):
        return  # Another node's topic of that name.


def _placed(message: Message) -> tuple[float, ...]:
    place, turn = message["pose"]["position"], message["pose"]["orientation"]
    numbers = place["x"], place["y"], place["z"], turn["w"], turn["x"], turn["y"], turn["z"]
    return tuple(map(float, numbers))


def _take_pose(tracks: ArmTracks, message: Message, _published_ns: int) -> None:
    tracks.poses.add(stamped_ns(message), _placed(message))


def _take_target(tracks: ArmTracks, message: Message, _published_ns: int) -> None:
    tracks.targets.add(stamped_ns(message), _placed(message))


def _take_status(tracks: ArmTracks, message: Message, _published_ns: int) -> None:
    tracks.authority.add(stamped_ns(message), str(message["authority"]))


def _take_snapshot(tracks: ArmTracks, message: Message, published_ns: int) -> None:
    closed = json.loads(message["data"])["gripper_closed"]
    tracks.gripper.add(published_ns, "closed" if closed else "open")


def _take_configuration(tracks: ArmTracks, message: Message, _published_ns: int) -> None:
    if tracks.model:
        return
    table = json.loads(message["data"])["tables"]["arm"]
    named = {key: table[key] for key in ("model", "tool_xyz_m", "tool_rpy_deg") if key in table}
    try:
        arm = read_table(ArmTable, named, "arm")
        tracks.reference = reference_of(load_arm(arm.model), arm.tool())
    except ConfigurationError:
        return  # A model of another version, or a file that is missing on this computer.
    tracks.model = arm.model


def _take_joints(tracks: ArmTracks, message: Message, _published_ns: int) -> None:
    if not tracks.names:
        tracks.names = tuple(map(str, message["name"]))
    tracks.joints.add(stamped_ns(message), tuple(map(float, message["position"])))


_TAKEN: Mapping[str, _Take] = {
    POSE: _take_pose,
    TARGET: _take_target,
    STATUS: _take_status,
    SNAPSHOT: _take_snapshot,
    CONFIGURATION: _take_configuration,
}


# -- episodes -------------------------------------------------------------------------------------


def _spans(tracks: ArmTracks, each_engagement: bool) -> Iterable[tuple[int, int]]:
    """Return the first and last stamp of each episode."""
    first_ns = max(track.stamps_ns[0] for track in tracks.tracks)
    last_ns = min(track.stamps_ns[-1] for track in tracks.tracks)
    if not each_engagement:
        return [(first_ns, max(first_ns, last_ns))]
    changes = tracks.authority
    ends = [*changes.stamps_ns[1:], last_ns]
    spans = zip(changes.stamps_ns, ends, changes.values, strict=False)
    return [
        (max(begin_ns, first_ns), min(end_ns, last_ns))
        for begin_ns, end_ns, owner in spans
        if owner and min(end_ns, last_ns) > max(begin_ns, first_ns)
    ]


def _breaks(tracks: ArmTracks, longest_gap_s: float) -> list[Gap]:
    """Return the gaps that are not filled, in the order of time."""
    found: list[Gap] = []
    for track in tracks.tracks:
        gaps = track.gaps(track.stamps_ns[0], track.stamps_ns[-1])
        found += (gap for gap in gaps if gap.long_ns > longest_gap_s * NS)
    return sorted(found, key=lambda gap: gap.at_ns)


def _without(breaks: Iterable[Gap], spans: Iterable[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Yield the parts of `spans` between the gaps."""
    for first_ns, last_ns in spans:
        begin_ns = first_ns
        for gap in breaks:
            if gap.at_ns >= last_ns or gap.at_ns + gap.long_ns <= begin_ns:
                continue
            if gap.at_ns > begin_ns:
                yield begin_ns, gap.at_ns
            begin_ns = gap.at_ns + gap.long_ns
        if begin_ns < last_ns:
            yield begin_ns, last_ns


def _episode(
    path: Path, tracks: ArmTracks, first_ns: int, last_ns: int, fps: int, written: Continuous
) -> Episode:
    episode = Episode(path, first_ns, [], [], [])
    for track in tracks.tracks:
        episode.gaps += track.gaps(first_ns, last_ns)
    number = 0
    while (stamp_ns := first_ns + number * NS // fps) <= last_ns:
        before, after, share = tracks.joints.at(stamp_ns)
        joints = (a + share * (b - a) for a, b in zip(before, after, strict=True))
        grip = CLOSED if tracks.gripper.at(stamp_ns) == "closed" else WIDE
        pose = written.of(six_of(_between(*tracks.poses.at(stamp_ns))))
        target = written.of(six_of(_between(*tracks.targets.at(stamp_ns))))
        episode.observations.append((*joints, *pose, grip))
        episode.actions.append((*target, grip))
        number += 1
    return episode


def _between(before: Sequence[float], after: Sequence[float], share: float) -> Pose:
    """Return the pose at a share of the way between two poses."""
    place = Vector3(*(a + share * (b - a) for a, b in zip(before[:3], after[:3], strict=True)))
    first = normalized(Quaternion(*before[3:]))
    turn = rotation_between(first, normalized(Quaternion(*after[3:])))
    turned = multiply(from_rotation_vector(scale(turn, share)), first)
    return Pose(place, turned, Frame.BASE)
