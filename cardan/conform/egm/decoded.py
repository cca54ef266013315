"""What judges of EGM look at: the datagrams of a timeline, decoded once, and their sessions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

from cardan.conform.timeline import Kind, Timeline, Traffic
from cardan.protocols import egm

_WRAP = 1 << 32
_OVERTAKEN_AT_MOST = 16
"""A sequence number that falls by no more than this was overtaken; by more, it begins anew."""


def step(before: int, after: int) -> int:
    """How far a 32-bit counter went, with its sign."""
    return (after - before + _WRAP // 2) % _WRAP - _WRAP // 2


class Robot(NamedTuple):
    """A datagram of a controller."""

    number: int
    time_s: float
    source: str
    message: egm.EgmRobot

    @property
    def seqno(self) -> int | None:
        """As in its header."""
        return None if self.message.header is None else self.message.header.seqno

    @property
    def running(self) -> bool:
        """Whether guidance acts."""
        return self.message.mci_state == egm.MCIState.RUNNING

    @property
    def motors_on(self) -> bool:
        """Whether it says so."""
        return self.message.motor_state == egm.MotorState.ON

    @property
    def joints(self) -> tuple[float, ...]:
        """Measured, rad; empty where absent."""
        return joints_of(self.message.feed_back)

    @property
    def position(self) -> tuple[float, ...]:
        """Measured, m; empty where absent."""
        return place_of(self.message.feed_back)


def joints_of(motion: egm.EgmMotion | None) -> tuple[float, ...]:
    """Rad; empty where absent."""
    return () if motion is None else motion.joints or ()


def place_of(motion: egm.EgmMotion | None) -> tuple[float, ...]:
    """Of the TCP, m; empty where absent."""
    pose = None if motion is None else motion.cartesian
    return () if pose is None else tuple(pose.pos or ())


def not_normal(motion: egm.EgmMotion | None) -> str | None:
    """How long a motion's quaternion is where that is not 1, to 1e-3; None: there is none."""
    pose = None if motion is None else motion.cartesian
    if pose is None or pose.orient is None:
        return None
    length = math.sqrt(sum(u * u for u in pose.orient))
    return f"length {length:.4f}" if abs(length - 1.0) > 1e-3 else ""


class Answer(NamedTuple):
    """A datagram of a PC."""

    number: int
    time_s: float
    message: egm.EgmSensor | egm.EgmSensorPathCorr


class Refused(NamedTuple):
    """A datagram that is not EGM."""

    number: int
    time_s: float
    malformed: egm.MalformedEgmMessage


class EgmTraffic(Traffic):
    """The datagrams of a timeline; `robot_sends` says whether we are the controller."""

    def __init__(self, timeline: Timeline, robot_sends: bool = False) -> None:
        super().__init__(timeline)
        self.robots: list[Robot] = []
        self.answers: list[Answer] = []
        self.refused: list[Refused] = []
        """Of who is judged."""
        self.raw: dict[int, bytes] = {}
        """Of who is judged."""
        self.junk: list[tuple[int, float]] = []
        """What we sent that is not EGM, with its times."""
        for index, event in enumerate(timeline):
            if event.kind is not Kind.DATA:
                continue
            judged = not event.sent
            if judged:
                self.raw[index] = event.data
            decode: Callable[[bytes], Any] = egm.decode_from_pc
            if event.sent == robot_sends:
                decode = egm.decode_robot
            message = decode(event.data)
            if isinstance(message, egm.MalformedEgmMessage):
                if judged:
                    self.refused.append(Refused(index, event.time_s, message))
                else:
                    self.junk.append((index, event.time_s))
            elif isinstance(message, egm.EgmRobot):
                self.robots.append(Robot(index, event.time_s, event.note, message))
            else:
                self.answers.append(Answer(index, event.time_s, message))

    def during(self, *names: str) -> list[Robot]:
        """The controller's datagrams of these phases."""
        return self.within(self.robots, *names)

    @cached_property
    def sessions(self) -> list[list[Robot]]:
        """Runs of datagrams whose sequence numbers go on."""
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
        """Neighbors in a session, and how far the sequence number went between them."""
        for session in self.sessions:
            for one, other in pairwise(session):
                assert one.seqno is not None
                assert other.seqno is not None
                yield one, other, step(one.seqno, other.seqno)
