"""The simulated controller against a capture of a real one, a big-endian controller of 2015.

The client's messages come from the capture, which is stored outside of the repository. The numbers
here come from it, too, and suffice for most tests without it.
"""

from __future__ import annotations

import contextlib
import itertools
import socket
import statistics
from types import SimpleNamespace
from typing import NamedTuple

import pytest

from cardan.protocols.simple_message.codec import WireFormat
from cardan.protocols.simple_message.codes import MessageType, MotionCommand, MotionResult
from cardan.protocols.simple_message.framing import ByteOrder, FrameReader
from cardan.protocols.simple_message.messages import (
    ZEROS,
    JointTrajPtFull,
    MotionCtrl,
    joints10,
    request,
)
from cardan.sim_peers.motoros_controller import (
    MotorosController,
    MotorosControllerOptions,
    MotorosControllerPeer,
    MotorosServers,
)
from tests import captures

MOTION, STATE = 50240, 50241
RETRY_S = 0.0054
"""Median time from a message to the client's next message or repetition."""
AFTER_START_S = 0.02
"""Time from the reply to START_TRAJ_MODE to the first point."""
TIMES_S = (
    0.0,
    0.218131,
    0.307255,
    0.376740,
    0.436049,
    0.488683,
    0.546823,
    0.615780,
    0.704673,
    0.919548,
)
BUSY = (0, 0, 0, 0, 0, 4, 8, 9, 12, 15)
"""Number of refusals of each point."""
WIRE = WireFormat(ByteOrder.BIG)


class Real(NamedTuple):
    """Contents of the capture. Times in s."""

    points: list[bytes]
    """Points, each once, as sent."""
    requests: list[bytes]
    """The two requests before the points."""
    answers: list[tuple[int, int]]
    """Sequence and result of the reply to each sent point."""
    waits_s: list[float]
    """Times from each sent point to the next one."""
    accepted_s: list[float]
    """Times at which points were accepted, from the first one on."""
    states: list[tuple[float, int]]
    """Time and type of each state message."""


@pytest.fixture(scope="module")
def real():
    found = Real([], [], [], [], [], [])
    sent_s = []
    for time_s, segment in captures.tcp_segments(captures.MOTOMAN):
        message = WIRE.decode(segment.payload)
        if segment.source.port == STATE:
            found.states.append((time_s, message.msg_type))
        elif segment.source.port == MOTION:
            if message.body.command == MessageType.JOINT_TRAJ_PT_FULL:
                found.answers.append((message.body.sequence, message.body.result))
                if message.body.result == MotionResult.SUCCESS:
                    found.accepted_s.append(time_s)
        elif isinstance(message.body, JointTrajPtFull):
            sent_s.append(time_s)
            if segment.payload not in found.points:
                found.points.append(segment.payload)
        else:
            found.requests.append(segment.payload)
    found.waits_s[:] = [later - sooner for sooner, later in itertools.pairwise(sent_s)]
    first_s = found.accepted_s[0]
    found.accepted_s[:] = [time_s - first_s for time_s in found.accepted_s]
    return found


@pytest.fixture(scope="module")
def reported():
    """Return the captured client without the capture: its times, on a path of our own."""
    way = [time_s / TIMES_S[-1] for time_s in TIMES_S]
    points = [
        JointTrajPtFull(
            0,
            number,
            15,
            time_s,
            joints10((0.1 + 0.1 * share, 1.2, 0.5, 0.0, 0.0, 0.0)),
            joints10((0.0 if share in (0.0, 1.0) else 0.1 / TIMES_S[-1],)),
            ZEROS,
        )
        for number, (time_s, share) in enumerate(zip(TIMES_S, way, strict=True))
    ]
    asked = (MotionCommand.CHECK_MOTION_READY, MotionCommand.START_TRAJ_MODE)
    return Real(
        [WIRE.encode(request(point)) for point in points],
        [WIRE.encode(request(MotionCtrl(0, 0, command))) for command in asked],
        [],
        [],
        [],
        [],
    )


@pytest.fixture(scope="module", params=["real", "reported"])
def client(request):
    """Provide the captured client; without the capture, its substitute."""
    return request.getfixturevalue(request.param)


def captured_controller(real, **changes):
    """Return a controller configured like the captured one: FS100, IPC 2 ms, firmware without speed
    feedback.

    Its arm had seven axes; a GP8 moves the first six of them.
    """
    start = WIRE.decode(real.points[0]).body.pos
    return MotorosControllerOptions(
        **{
            "big_endian": True,
            "velocity_mode": False,
            "ipc_s": 0.002,
            "queue_increments": 200,
            "feedback_fields": 2,
            "job_start_s": 0.11,
            "servo_on": True,
            "start": start[:6],
            "faults": {"old-firmware": 1.0},
            **changes,
        }
    )


class Replay:
    """The captured client in virtual time.

    `waits_s` are the times from each sent point to the next one; then RETRY_S applies. The client
    starts `offset_s` after the controller's clock.
    """

    def __init__(self, real, waits_s=(), offset_s=0.0, **changes):
        options = captured_controller(real, **changes)
        self.real = real
        self.servers = MotorosServers(MotorosController(options), options)
        self.waits_s = list(waits_s)
        self.states, self.replies, self.answers, self.accepted_s = [], [], [], []
        self.now_s = 500.0
        self.servers.advance(self.now_s)
        self.run(self.now_s + offset_s)
        self.state = self.servers.accepted("state", self.now_s)
        self.motion = self.servers.accepted("motion", self.now_s)

    def run(self, until_s):
        while self.now_s < until_s:
            self.now_s = min(until_s, max(self.servers.next_s, self.now_s + 1e-6))
            self.servers.advance(self.now_s)
            self.poll()

    def poll(self):
        for number, data in self.servers.outgoing():
            retained = self.states if number == self.state else self.replies
            retained.append((self.now_s, WIRE.decode(data)))

    def ask(self, data, until_s=1.0):
        """Send a request; return the reply's time in the servers, and the reply."""
        sent_s = self.now_s
        self.servers.data(self.motion, data, sent_s)
        self.poll()
        while not self.replies and self.now_s < sent_s + until_s:
            self.run(min(self.servers.next_s, sent_s + until_s))
        ((came_s, message),) = self.replies
        self.replies.clear()
        return came_s - sent_s, message

    def move(self):
        """Repeat the captured sequence: requests, start, points."""
        took_s = [self.ask(data)[0] for data in self.real.requests]
        self.run(self.now_s + AFTER_START_S)
        for data in self.real.points:
            accepted = False
            while not accepted:
                sent_s = self.now_s
                _, answer = self.ask(data)
                self.answers.append((answer.body.sequence, answer.body.result))
                accepted = answer.body.result == MotionResult.SUCCESS
                assert accepted or answer.body.result == MotionResult.BUSY
                if accepted:
                    self.accepted_s.append(sent_s)
                self.run(sent_s + (self.waits_s.pop(0) if self.waits_s else RETRY_S))
        return took_s


def results(answers, wanted):
    return sum(result == wanted for _, result in answers)


def refusals(answers):
    return tuple(
        sum(answer == (sequence, MotionResult.BUSY) for answer in answers)
        for sequence in range(len(TIMES_S))
    )


def test_the_capture_is_what_the_numbers_say(real):
    points = [WIRE.decode(data).body for data in real.points]
    assert [point.sequence for point in points] == list(range(10))
    assert [point.time for point in points] == pytest.approx(TIMES_S, abs=1e-6)
    assert refusals(real.answers) == BUSY
    assert [WIRE.decode(data).body.command for data in real.requests] == [
        MotionCommand.CHECK_MOTION_READY,
        MotionCommand.START_TRAJ_MODE,
    ]


def test_points_are_accepted_and_refused_as_by_the_real_controller(real):
    replay = Replay(real, real.waits_s)
    took_s = replay.move()
    assert took_s[1] == pytest.approx(0.11, abs=0.01)
    assert results(replay.answers, MotionResult.SUCCESS) == 10
    assert results(replay.answers, MotionResult.BUSY) == 48
    assert replay.answers == real.answers
    accepted_s = [each - replay.accepted_s[0] for each in replay.accepted_s]
    assert accepted_s[-1] == pytest.approx(0.32, abs=0.01)
    assert accepted_s == pytest.approx(real.accepted_s, abs=0.002)


@pytest.mark.parametrize("offset_ms", [0.0, 0.3, 0.9, 1.4, 1.9])
def test_a_client_with_a_steady_retry_sees_the_same(client, offset_ms):
    """The phase between its retries and the controller's clock is arbitrary."""
    replay = Replay(client, offset_s=offset_ms * 1e-3)
    replay.move()
    assert results(replay.answers, MotionResult.SUCCESS) == 10
    assert results(replay.answers, MotionResult.BUSY) == pytest.approx(48, abs=3)
    assert replay.answers.index((5, MotionResult.BUSY)) == 5
    assert refusals(replay.answers) == pytest.approx(BUSY, abs=1)


def test_a_point_waits_until_all_but_a_queue_of_the_one_before_is_played(client):
    replay = Replay(client)
    replay.move()
    started_s = replay.accepted_s[1]
    for number in range(5, 10):
        played_s = TIMES_S[number - 1] - 0.4
        assert 0.0 <= replay.accepted_s[number] - started_s - played_s < RETRY_S + 0.005


def test_the_arm_ends_where_the_last_point_says(client):
    replay = Replay(client)
    replay.move()
    replay.run(replay.now_s + 1.0)
    end = WIRE.decode(client.points[-1]).body.pos[:6]
    controller = replay.servers.controller
    assert controller.command_rad(0) == pytest.approx(end, abs=1e-4)
    assert controller.queue_count(0) == 0
    assert not controller.moving_data


def test_states_come_as_from_the_real_controller(real):
    replay = Replay(real)
    replay.move()
    ours = [(time_s, message.msg_type) for time_s, message in replay.states]
    for states in (ours, real.states):
        types = [msg_type for _, msg_type in states]
        whole = types[: len(types) // 2 * 2]
        assert whole == [MessageType.JOINT_FEEDBACK, MessageType.ROBOT_STATUS] * (len(whole) // 2)
        cycles = [time_s for time_s, msg_type in states if msg_type == MessageType.ROBOT_STATUS]
        gaps = [b - a for a, b in itertools.pairwise(cycles)]
        assert statistics.median(gaps) == pytest.approx(0.025, abs=2e-4)
        assert max(abs(gap - 0.025) for gap in gaps) < 0.002
    feedback = next(m.body for _, m in replay.states if m.msg_type == MessageType.JOINT_FEEDBACK)
    assert feedback.valid_fields == 2


def test_over_tcp_replies_come_within_a_state_period_and_the_move_is_made(client, monkeypatch):
    """Each read of the clock advances it."""
    clock = itertools.count(500.0, 1e-4)
    monkeypatch.setattr(
        "cardan.sim_peers.tcp_peer.time", SimpleNamespace(monotonic=lambda: next(clock))
    )
    peer = MotorosControllerPeer(captured_controller(client, base_port=0))
    reader = FrameReader(ByteOrder.BIG)
    took_s, answers = [], []
    with contextlib.closing(peer), socket.socket() as link:
        peer.open()
        link.connect(("127.0.0.1", peer.motion_port))
        link.setblocking(False)
        for data in (*client.requests, *client.points):
            accepted = False
            while not accepted:
                sent_s = next(clock)
                link.sendall(data)
                while (frame := reader.take()) is None:
                    assert next(clock) < sent_s + 1.0
                    peer.step(next(clock) + 0.0005)
                    with contextlib.suppress(BlockingIOError):
                        reader.feed(link.recv(4096))
                took_s.append(next(clock) - sent_s)
                answer = WIRE.decode(frame).body
                answers.append((answer.sequence, answer.result))
                accepted = data in client.requests or answer.result == MotionResult.SUCCESS
                assert accepted or answer.result == MotionResult.BUSY
                peer.step(sent_s + RETRY_S)
    del answers[: len(client.requests)]
    assert refusals(answers) == pytest.approx(BUSY, abs=1)
    assert statistics.median(took_s) < 0.025
