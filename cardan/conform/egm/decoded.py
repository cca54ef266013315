"""Decoded EGM datagrams of a timeline and their sessions, for the checks."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

from cardan.conform.timeline import Kind, Traffic, WireTimeline
from cardan.protocols.egm import decode, messages as m

_WRAP = 1 << 32
_OVERTAKEN_AT_MOST = 16
"""A sequence number that decreases by up to this was overtaken; by more, a session begins."""


def step(before: int, after: int) -> int:
    """Return the signed step of a 32-bit counter."""
    return (after - before + _WRAP // 2) % _WRAP - _WRAP // 2


class Robot(NamedTuple):
    """A datagram of a controller."""

    number: int
    time_s: float
    source: str
    message: m.EgmRobot

    @property
    def seqno(self) -> int | None:
        """Sequence number in its header; None without one."""
        return None if self.message.header is None else self.message.header.seqno

    @property
    def running(self) -> bool:
        """True if guidance is running."""
        return self.message.mci_state == m.MCIState.RUNNING

    @property
    def motors_on(self) -> bool:
        """True if it reports motors on."""
        return self.message.motor_state == m.MotorState.ON

    @property
    def joints(self) -> tuple[float, ...]:
        """Measured joints, rad; empty if absent."""
        return joints_of(self.message.feed_back)

    @property
    def position(self) -> tuple[float, ...]:
        """Measured TCP position, m; empty if absent."""
        return place_of(self.message.feed_back)


def joints_of(motion: m.EgmMotion | None) -> tuple[float, ...]:
    """Return the joints, rad; empty if absent."""
    return () if motion is None else motion.joints or ()


def place_of(motion: m.EgmMotion | None) -> tuple[float, ...]:
    """Return the TCP position, m; empty if absent."""
    pose = None if motion is None else motion.cartesian
    return () if pose is None else tuple(pose.pos or ())


def not_normal(motion: m.EgmMotion | None) -> str | None:
    """Return a wrong length of a motion's quaternion; empty: 1, to 1e-3; None: no quaternion."""
    pose = None if motion is None else motion.cartesian
    if pose is None or pose.orient is None:
        return None
    length = math.sqrt(sum(u * u for u in pose.orient))
    return f"length {length:.4f}" if abs(length - 1.0) > 1e-3 else ""


class SensorDatagram(NamedTuple):
    """A datagram of a PC."""

    number: int
    time_s: float
    message: m.EgmSensor | m.EgmSensorPathCorr


class EgmTraffic(Traffic):
    """The datagrams of a timeline; `robot_sends`: we are the controller."""

    def __init__(self, timeline: WireTimeline, robot_sends: bool = False) -> None:
        super().__init__(timeline)
        self.robots: list[Robot] = []
        self.answers: list[SensorDatagram] = []
        self.junk: list[tuple[int, float]] = []
        """Sent datagrams that are not EGM, with their times."""
        for index, event in enumerate(timeline):
            if event.kind is not Kind.DATA:
                continue
            of_robot = event.sent == robot_sends
            message: Any = (decode.decode_robot if of_robot else decode.decode_from_pc)(event.data)
            if isinstance(message, m.MalformedEgmMessage):
                if not event.sent:
                    self.unread.append((index, message.detail))
                else:
                    self.junk.append((index, event.time_s))
            elif isinstance(message, m.EgmRobot):
                self.robots.append(Robot(index, event.time_s, event.note, message))
            else:
                self.answers.append(SensorDatagram(index, event.time_s, message))

    def during(self, *names: str) -> list[Robot]:
        """Return the controller's datagrams of these phases."""
        return self.within(self.robots, *names)

    @cached_property
    def sessions(self) -> list[list[Robot]]:
        """Runs of datagrams with continuous sequence numbers."""
        found: list[list[Robot]] = []
        newest: int | None = None
        for each in self.robots:
            number = each.seqno
            if number is None:
                continue
            if newest is None or step(newest, number) < -_OVERTAKEN_AT_MOST:
                found.append([])
                newest = number
            elif number == 0 and newest != 0 and found[-1][-1].time_s < each.time_s - 0.25:
                found.append([])  # A short session, and silence after it.
                newest = number
            found[-1].append(each)
            newest = number if step(newest, number) > 0 else newest
        return found

    def steps(self) -> Iterator[tuple[Robot, Robot, int]]:
        """Yield neighbors in a session, and the step of the sequence number between them."""
        for session in self.sessions:
            for one, other in pairwise(session):
                assert one.seqno is not None
                assert other.seqno is not None
                yield one, other, step(one.seqno, other.seqno)
