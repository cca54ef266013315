"""The EGM driver over real loopback sockets. No test sleeps: peers answer each other."""

from __future__ import annotations

import contextlib
import errno
import itertools
import math
import os
import socket
import struct
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from cardan.drivers import registry
from cardan.drivers.abb_egm import AbbEgm, AbbEgmOptions, address, driver as driver_module
from cardan.drivers.robot_core import WAKE_S
from cardan.errors import AddressError, CommandError, DriverError, NotOpenError
from cardan.protocols.egm.messages import EgmMeasuredForce, EgmRapidData
from cardan.types import HoldCommand, JointCommand, JointVelocityCommand, RobotLink, RobotState
from tests.waiting import WITHIN_S

from .egm_controller import HOME, PERIOD_S, Controller, sensor_of, speeds_of

pytestmark = pytest.mark.matrix

FAST = JointCommand((1.5, *HOME[1:]))
ZEROS = (0.0,) * 6


class Peer:
    """The controller's end, with its own socket."""

    def __init__(self, robot: AbbEgm) -> None:
        self.controller = Controller()
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.connect(robot.endpoint)
        self.socket.settimeout(WITHIN_S)

    def say(self, times: int = 1) -> None:
        """Send the next datagrams."""
        for _ in range(times):
            self.socket.send(self.controller.datagram())

    def hear(self) -> bytes:
        """Return the next answer, which the simulated robot follows."""
        answer = self.socket.recv(2048)
        self.controller.follow(answer)
        return answer

    def rest(self) -> list[bytes]:
        """Return the answers that have already arrived."""
        answers = []
        self.socket.setblocking(False)
        try:
            while True:
                with contextlib.suppress(ConnectionRefusedError):  # reported before data
                    answers.append(self.socket.recv(2048))
        except BlockingIOError:
            self.socket.settimeout(WITHIN_S)
        return answers


@pytest.fixture
def robot() -> Iterator[AbbEgm]:
    with AbbEgm(AbbEgmOptions(listen_port=0, mode="joint")) as driver:
        yield driver


@pytest.fixture
def peer(robot: AbbEgm) -> Iterator[Peer]:
    peer = Peer(robot)
    yield peer
    peer.socket.close()


@pytest.fixture
def waits_ms(robot: AbbEgm, monkeypatch: pytest.MonkeyPatch) -> set[float]:
    """Longest waits that the driver asks poll() for."""
    asked, poll = set[float](), robot._poll.poll

    def asking(longest_ms: float) -> list[tuple[int, int]]:
        asked.add(longest_ms)
        return poll(longest_ms)

    monkeypatch.setattr(robot, "_poll", SimpleNamespace(poll=asking))
    return asked


@pytest.fixture
def in_step(peer: Peer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Advance the driver's clock by a period for each datagram of the controller.

    In real time these cycles would be fast enough to look like a wrong clock.
    """
    began_s, began_us = driver_module._monotonic(), peer.controller.clock_us
    monkeypatch.setattr(
        driver_module, "_monotonic", lambda: began_s + 1e-6 * (peer.controller.clock_us - began_us)
    )


def run(robot: AbbEgm, peer: Peer, cycles: Iterator[RobotState], times: int) -> bytes:
    """Run some cycles towards a far target; return the last answer."""
    for _ in range(times):
        peer.say()
        next(cycles)
        robot.send(FAST)
        answer = peer.hear()
    return answer


class LiveController:
    """Controller in a thread, which sends a datagram after each answer.

    `impatient`: it also sends one after waiting in vain, because its application may have closed by
    then.
    """

    def __init__(self, peer: Peer, impatient: bool = False) -> None:
        self.peer, self.impatient = peer, impatient
        self.answers: list[bytes] = []
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self.serve)

    def serve(self) -> None:
        answered = True
        while not self.ended.is_set():
            try:
                if answered or self.impatient:
                    self.peer.say()
                answered = False
                self.answers.append(self.peer.hear())
                answered = True
            except TimeoutError:
                continue
            except ConnectionRefusedError:
                return

    def __enter__(self) -> LiveController:
        self.peer.socket.settimeout(0.3)
        self.thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.ended.set()
        self.thread.join()
        self.answers += self.peer.rest()


class TestLoop:
    @pytest.mark.usefixtures("in_step")
    def test_each_datagram_gets_its_answer_from_send(self, robot: AbbEgm, peer: Peer) -> None:
        cycles = robot.cycles()
        for k in range(20):
            peer.say()
            state = next(cycles)
            assert (state.link, state.sequence) == (RobotLink.LIVE, k)
            assert peer.rest() == []
            robot.send(FAST)
            answer = peer.hear()
            header = sensor_of(answer).header
            assert header is not None
            assert header.seqno == k
        assert speeds_of(answer)[0] > 0.5  # type: ignore[index]
        assert robot.metrics()["answers"] == 20
        assert robot.metrics()["reply_latency_max_s"] < 0.1

    def test_a_second_send_in_a_cycle_has_no_effect(self, robot: AbbEgm, peer: Peer) -> None:
        cycles = robot.cycles()
        peer.say()
        next(cycles)
        robot.send(FAST)
        robot.send(FAST)
        assert len(peer.rest()) == 1
        with pytest.raises(CommandError, match="joint velocity"):
            robot.send(JointVelocityCommand(ZEROS))

    @pytest.mark.real
    def test_of_many_waiting_the_newest_is_answered_once(self, robot: AbbEgm, peer: Peer) -> None:
        peer.say(10)
        state = next(robot.cycles())
        assert state.sequence == 9
        robot.send(HoldCommand())
        answer = peer.hear()
        assert peer.rest() == []
        header = sensor_of(answer).header
        assert header is not None
        assert header.tm_ms == (peer.controller.clock_us - round(PERIOD_S * 1e6)) // 1000 % 2**32

    def test_an_invalid_newest_does_not_hide_the_valid_one(self, robot: AbbEgm, peer: Peer) -> None:
        peer.say(2)
        for garbage in (b"", b"\xff\xff", b"\x00" * 3000):
            peer.socket.send(garbage)
        assert next(robot.cycles()).sequence == 1
        metrics = robot.metrics()
        assert metrics["malformed"] == 3
        assert metrics["malformed_empty"] == metrics["malformed_oversized"] == 1

    def test_a_datagram_nobody_answers_is_answered_with_a_hold(
        self, robot: AbbEgm, peer: Peer
    ) -> None:
        cycles = robot.cycles()
        run(robot, peer, cycles, 50)
        peer.say()
        next(cycles)
        peer.say()
        next(cycles)
        first = peer.hear()
        assert peer.rest() == []
        assert 0.0 < speeds_of(first)[0] < math.radians(90.0)  # type: ignore[index]
        assert robot.metrics()["driver_holds"] == 1

    def test_a_refused_command_leaves_the_answer_to_the_driver(
        self, robot: AbbEgm, peer: Peer
    ) -> None:
        cycles = robot.cycles()
        peer.say()
        next(cycles)
        with pytest.raises(CommandError):
            robot.send(JointCommand((math.nan,) * 6))
        assert peer.rest() == []
        peer.say()
        next(cycles)
        assert speeds_of(peer.hear()) == ZEROS

    def test_silence_is_reported_and_taken_no_commands(self, robot: AbbEgm, peer: Peer) -> None:
        cycles = robot.cycles()
        waiting = next(cycles)
        assert (waiting.link, waiting.session) == (RobotLink.WAITING, 0)
        robot.send(FAST)
        peer.say()
        assert next(cycles).link is RobotLink.LIVE
        robot.send(FAST)
        lost = next(cycles)
        assert (lost.link, lost.session, lost.joints) == (
            RobotLink.LOST,
            1,
            pytest.approx(HOME),
        )
        robot.send(FAST)
        assert len(peer.rest()) == 1
        peer.say()
        assert next(cycles).session == 2

    def test_silence_is_waited_for_where_the_socket_does_not_wait(
        self, robot: AbbEgm, peer: Peer
    ) -> None:
        sock = robot._socket
        assert sock is not None
        os.set_blocking(sock.fileno(), False)  # like gevent
        cycles = robot.cycles()
        end_s, waiting = time.monotonic() + 0.5, 0
        while time.monotonic() < end_s:
            assert next(cycles).link is RobotLink.WAITING
            waiting += 1
        assert waiting <= 6
        peer.say()
        assert next(cycles).link is RobotLink.LIVE

    def test_a_flood_of_garbage_does_not_keep_the_loop_from_its_watch(
        self, robot: AbbEgm, peer: Peer, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        clock = itertools.count(1e6, 0.02)
        monkeypatch.setattr(driver_module, "_monotonic", lambda: next(clock))
        for _ in range(100):
            peer.socket.send(b"\xff" * 50)
        assert next(robot.cycles()).link is RobotLink.WAITING
        assert peer.rest() == []
        errors = robot.protocol_errors()
        assert sum(errors.values()) == robot.metrics()["malformed"] > 0

    def test_a_backlog_that_may_be_incomplete_is_not_answered(
        self, robot: AbbEgm, peer: Peer
    ) -> None:
        peer.say(60)
        assert next(robot.cycles()).link is RobotLink.LOST
        assert peer.rest() == []
        assert robot.metrics()["superseded"] == 60

    def test_what_cannot_have_waited_for_a_period_is_answered_at_once(
        self,
        robot: AbbEgm,
        peer: Peer,
        waits_ms: set[float],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        now_s = [1e6]
        monkeypatch.setattr(driver_module, "_monotonic", lambda: now_s[0])
        cycles = robot.cycles()
        peer.say()
        next(cycles)
        robot.send(FAST)
        for later_s, newest in ((0.9 * PERIOD_S, 1), (0.3 * PERIOD_S, 3)):
            if newest == 1:
                peer.say(3)
            now_s[0] += later_s
            assert next(cycles).sequence == newest
            robot.send(FAST)
        assert robot.metrics()["superseded"] == 1
        assert waits_ms == {0}

    def test_only_the_first_controller_is_answered(self, robot: AbbEgm, peer: Peer) -> None:
        cycles = robot.cycles()
        peer.say()
        next(cycles)
        robot.send(HoldCommand())
        other = Peer(robot)
        other.controller.seqno = 1000
        other.say()
        peer.say()
        assert next(cycles).sequence == 1
        robot.send(HoldCommand())
        assert len(peer.rest()) == 2
        assert other.rest() == []
        assert robot.metrics()["foreign"] == 1
        other.socket.close()

    def test_a_newer_loop_ends_the_one_before(
        self, robot: AbbEgm, peer: Peer, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        old = robot.cycles()
        peer.say()
        next(old)
        new = robot.cycles()
        peer.say()
        next(new)
        assert list(old) == []
        robot.send(HoldCommand())
        assert len(peer.rest()) <= 2

        def hear_until_it_is_left() -> RobotState | None:
            robot.cycles()
            return hear()

        hear = robot._hear
        monkeypatch.setattr(robot, "_hear", hear_until_it_is_left)
        peer.say()
        assert list(new) == []

    def test_an_answer_that_cannot_leave_is_counted(self, robot: AbbEgm, peer: Peer) -> None:
        cycles = robot.cycles()
        peer.say()
        next(cycles)
        robot.session.peer = ("255.255.255.255", 9)
        robot.send(HoldCommand())
        assert robot.metrics()["send_errors"] == 1
        assert any("could not be sent" in words for words in robot.diagnosis())


class TestLeaving:
    """The robot brakes and the last message has zero speed, however the loop ends."""

    def last_words(self, peer: Peer) -> tuple[float, ...]:
        speeds = [speeds_of(answer) for answer in peer.rest()]
        assert speeds
        assert speeds[-1] is not None
        return speeds[-1]

    @pytest.mark.real
    def test_an_application_that_crashes(self, robot: AbbEgm, peer: Peer) -> None:
        def application() -> None:
            for _ in robot.cycles():
                robot.send(FAST)
                peer.hear()
                peer.say()
                if robot.metrics()["answers"] == 30:
                    raise ZeroDivisionError

        peer.say()
        with pytest.raises(ZeroDivisionError):
            application()
        assert self.last_words(peer) == ZEROS

    def test_a_crash_before_the_answer(self, robot: AbbEgm, peer: Peer) -> None:
        def application() -> None:
            for state in robot.cycles():
                if state.sequence == 30:
                    raise ZeroDivisionError
                robot.send(FAST)
                peer.hear()
                peer.say()

        peer.say()
        with pytest.raises(ZeroDivisionError):
            application()
        assert self.last_words(peer) == ZEROS

    @pytest.mark.parametrize("way", ["close the loop", "close the driver", "leave the loop"])
    def test_leaving_on_purpose(self, robot: AbbEgm, peer: Peer, way: str) -> None:
        cycles = robot.cycles()
        run(robot, peer, cycles, 30)
        if way == "close the loop":
            cycles.close()
        elif way == "close the driver":
            robot.close()
            assert list(cycles) == []
        else:
            del cycles
        answers = peer.rest()
        assert speeds_of(answers[-1]) == ZEROS

    @pytest.mark.real
    @pytest.mark.usefixtures("in_step")
    def test_a_live_controller_sees_a_ramp_within_the_limits(
        self, robot: AbbEgm, peer: Peer
    ) -> None:
        with LiveController(peer) as live:
            for k, _ in enumerate(robot.cycles()):
                robot.send(FAST)
                if k == 60:
                    break
            robot.close()
        speeds = [speeds_of(answer)[0] for answer in live.answers]  # type: ignore[index]
        assert max(speeds) == pytest.approx(math.radians(90.0))
        assert speeds[-1] == 0.0
        largest = math.radians(720.0) * 4 * PERIOD_S
        changes = [abs(b - a) for a, b in itertools.pairwise(speeds)]
        assert max(changes) <= largest + 1e-9
        assert sum(1 for a, b in itertools.pairwise(speeds) if b < a) > 20

    @pytest.mark.real
    def test_close_from_another_thread(self, robot: AbbEgm, peer: Peer) -> None:
        running = threading.Event()

        def application() -> None:
            for state in robot.cycles():
                robot.send(FAST)
                if state.sequence >= 40:
                    running.set()

        with LiveController(peer, impatient=True) as live:
            thread = threading.Thread(target=application)
            thread.start()
            assert running.wait(30.0)
            robot.close()
            thread.join(30.0)
            assert not thread.is_alive()
        assert speeds_of(live.answers[-1]) == ZEROS
        with pytest.raises(NotOpenError):
            robot.send(FAST)

    def test_a_late_command_is_replaced_by_braking(
        self, robot: AbbEgm, peer: Peer, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        cycles = robot.cycles()
        last = speeds_of(run(robot, peer, cycles, 30))
        assert last is not None
        peer.say()
        next(cycles)
        # Meanwhile the robot moves on at the last speed.
        first, *others = peer.controller.joints
        peer.controller.joints = (first + last[0] * PERIOD_S, *others)
        late_s = robot.options.command_timeout_s + 0.05
        monotonic = driver_module._monotonic
        monkeypatch.setattr(driver_module, "_monotonic", lambda: monotonic() + late_s)
        with LiveController(peer) as live:
            robot.send(FAST)
            assert not robot.session.moving
            live.ended.set()
        speeds = [speeds_of(answer)[0] for answer in live.answers]  # type: ignore[index]
        assert 0.0 < speeds[0] < last[0]
        assert sorted(speeds, reverse=True) == speeds
        assert speeds[-1] == 0.0
        assert robot.metrics()["late_commands"] == 1

    def test_a_controller_that_fell_silent_long_ago_is_sent_nothing(
        self,
        robot: AbbEgm,
        peer: Peer,
        waits_ms: set[float],
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        cycles = robot.cycles()
        run(robot, peer, cycles, 30)
        monotonic = driver_module._monotonic
        for how in ("leave", "send"):
            peer.say()
            next(cycles)
            with monkeypatch.context() as later:
                later.setattr(driver_module, "_monotonic", lambda: monotonic() + 0.8)
                if how == "send":
                    robot.send(FAST)
                else:
                    cycles.close()
                    cycles = robot.cycles()
            assert peer.rest() == []
        assert robot.metrics()["answers"] == 30
        assert robot.metrics()["final_commands"] == 0
        assert robot.metrics()["reply_latency_max_s"] < 0.2
        assert waits_ms == {0, 1e3 * robot.options.lost_after_s}

    def test_a_last_message_is_no_answer(self, robot: AbbEgm, peer: Peer) -> None:
        cycles = robot.cycles()
        run(robot, peer, cycles, 30)
        assert next(cycles).link is RobotLink.LOST
        cycles.close()
        assert self.last_words(peer) == ZEROS
        metrics = robot.metrics()
        assert (metrics["answers"], metrics["final_commands"]) == (30, 1)
        assert metrics["reply_latency_max_s"] < 0.1


class TestStolenPort:
    def test_a_program_on_the_controllers_address_does_not_get_the_robot(
        self, robot: AbbEgm, peer: Peer, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """The controller pauses now and then, and the other program still gets no answer."""
        thief = Peer(robot)
        cycles = robot.cycles()
        run(robot, peer, cycles, 30)
        monotonic, hiccups = driver_module._monotonic, 0
        monkeypatch.setattr(driver_module, "_monotonic", lambda: monotonic() + 0.05 * hiccups)
        for _ in range(50):
            hiccups += 1
            thief.say()
            peer.say()
            assert next(cycles).session == 1
            robot.send(FAST)
            peer.hear()
        assert thief.rest() == []
        assert robot.metrics()["foreign"] == 50
        thief.socket.close()

    def test_the_port_before_is_left_at_rest(self, robot: AbbEgm, peer: Peer) -> None:
        cycles = robot.cycles()
        run(robot, peer, cycles, 30)
        assert robot.session.moving
        assert next(cycles).link is RobotLink.LOST
        after = Peer(robot)
        after.say()
        state = next(cycles)
        assert (state.link, state.session) == (RobotLink.LIVE, 2)
        assert [speeds_of(answer) for answer in peer.rest()] == [ZEROS]
        robot.send(FAST)
        assert speeds_of(after.hear()) == ZEROS
        assert robot.metrics()["final_commands"] == 1
        after.socket.close()


class TestOpening:
    def test_open_and_close_twice(self) -> None:
        robot = AbbEgm(AbbEgmOptions(listen_port=0))
        assert robot.diagnosis() == ("the EGM driver is not open",)
        robot.close()
        robot.open()
        endpoint = robot.endpoint
        robot.open()
        assert robot.endpoint == endpoint
        robot.close()
        robot.close()
        for use in (
            robot.cycles,
            robot.stream,
            lambda: robot.send(HoldCommand()),
            lambda: robot.endpoint,
        ):
            with pytest.raises(NotOpenError):
                use()
        robot.open()
        assert robot.metrics()["sessions"] == 0
        robot.close()

    def test_defaults(self) -> None:
        assert registry.load("abb_egm") is AbbEgm
        robot = AbbEgm()
        assert (robot.options.listen_host, robot.options.listen_port) == ("127.0.0.1", 6510)
        assert robot.capabilities.period_s == pytest.approx(PERIOD_S)

    def test_a_port_in_use_names_its_holder(self, robot: AbbEgm) -> None:
        other = AbbEgm(AbbEgmOptions(listen_port=robot.endpoint[1]))
        with pytest.raises(AddressError, match="in use") as refusal:
            other.open()
        words = str(refusal.value)
        assert str(os.getpid()) in words
        assert "listen_port" in words
        assert str(robot.endpoint[1]) in words

    def test_an_address_that_is_not_ours(self) -> None:
        with pytest.raises(AddressError, match=r"192\.0\.2\.1 is not an address of this computer"):
            AbbEgm(AbbEgmOptions(listen_host="192.0.2.1")).open()

    def test_a_networks_broadcast_address_is_no_address_to_guide_a_robot_by(self) -> None:
        words = "127.255.255.255 is a broadcast address"
        with pytest.raises(AddressError, match=f"listen_host .*{words}"):
            AbbEgm(listen_host="127.255.255.255", listen_port=0).open()
        with pytest.raises(AddressError, match=f"controller_host .*{words}"):
            AbbEgm(listen_port=0, controller_host="127.255.255.255").open()

    def test_anybodys_robot_is_warned_of(self) -> None:
        for safe in (
            AbbEgm(),
            AbbEgm(listen_host="localhost"),
            AbbEgm(listen_host="0.0.0.0", controller_host="192.168.125.1"),
        ):
            assert safe.cautions() == ()
        for host in ("0.0.0.0", "192.168.125.50"):
            (words,) = AbbEgm(listen_host=host).cautions()
            assert words.startswith(f"listen_host {host} without controller_host")
            assert "set controller_host to the controller's address" in words
        with AbbEgm(listen_host="0.0.0.0", listen_port=0) as robot:
            assert robot.diagnosis()[0].startswith("listen_host 0.0.0.0 without controller_host")

    @pytest.mark.parametrize(
        ("error", "words"),
        [
            (PermissionError(errno.EACCES, "Permission denied"), "port 80 .* privileged"),
            (PermissionError(errno.EACCES, "denied"), "port 1024 .* cannot be used: denied"),
            (socket.gaierror(socket.EAI_NONAME, "Name or service not known"), "not a known IPv4"),
            (OSError(errno.ENOBUFS, "No buffer space available"), "No buffer space"),
        ],
    )
    def test_other_refusals_of_the_system(
        self, monkeypatch: pytest.MonkeyPatch, error: OSError, words: str
    ) -> None:
        class Refusing(socket.socket):
            def bind(self, address: Any) -> None:
                raise error

        monkeypatch.setattr(socket, "socket", Refusing)
        with pytest.raises(AddressError, match=words):
            address.bind_udp("127.0.0.1", 1024 if "1024" in words else 80)

    @pytest.mark.parametrize("silence_s", [0.05, 0.5])
    def test_the_loop_waits_in_the_socket_itself(self, silence_s: float) -> None:
        with AbbEgm(listen_port=0, silence_s=silence_s) as robot:
            sock = robot._open_socket()
            assert sock.getblocking()
            waits = struct.unpack("@ll", sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, 16))
            assert waits == pytest.approx((0, 1e6 * min(silence_s, WAKE_S)), abs=1e4)

    def test_a_controller_given_by_name_is_the_only_one(self) -> None:
        options = AbbEgmOptions(listen_port=0, mode="joint", controller_host="localhost")
        with AbbEgm(options) as robot:
            peer = Peer(robot)
            peer.say()
            assert next(robot.cycles()).link is RobotLink.LIVE
            peer.socket.close()

    def test_a_controller_without_an_address(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def unknown(*_: object) -> None:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

        monkeypatch.setattr(socket, "getaddrinfo", unknown)
        with pytest.raises(AddressError, match="controller_host 'robot'"):
            AbbEgm(AbbEgmOptions(listen_port=0, controller_host="robot")).open()


class TestContent:
    def test_outputs_rapid_data_and_force_control(self, robot: AbbEgm, peer: Peer) -> None:
        assert robot.rapid_data is None
        assert robot.force_control_active is None
        robot.set_outputs(True, (1.0, -2.0))
        data = EgmRapidData(True, (4.0,))
        peer.controller.fields["rapid_from_robot"] = data
        peer.controller.fields["measured_force"] = EgmMeasuredForce((1.0,) * 6, False)
        peer.say()
        state = next(robot.cycles())
        robot.send(HoldCommand())
        assert sensor_of(peer.hear()).rapid_to_robot == EgmRapidData(True, (1.0, -2.0))
        assert robot.rapid_data == data
        assert robot.force_control_active is False
        assert state.wrench is not None
        assert robot.message is not None
        with pytest.raises(CommandError):
            robot.set_outputs(values=(math.inf,))

    def test_diagnosis_of_an_open_driver(self, robot: AbbEgm, peer: Peer) -> None:
        peer.controller.mci = 2
        peer.say()
        next(robot.cycles())
        assert "EGM is stopped" in robot.diagnosis()[0]


class TestStream:
    def test_a_thread_answers_with_the_newest_command(self, robot: AbbEgm, peer: Peer) -> None:
        with robot.stream() as stream:
            assert stream.state().link is RobotLink.WAITING
            with pytest.raises(CommandError):
                stream.command(JointVelocityCommand(ZEROS))
            peer.say()
            assert speeds_of(peer.hear()) == ZEROS
            speed = 0.0
            due_s = time.monotonic()
            for k in range(1, 40):
                due_s += PERIOD_S
                threading.Event().wait(max(due_s - time.monotonic(), 0.0))  # for a period
                stream.command(FAST)
                peer.say()
                answer = peer.hear()
                assert stream.state().sequence == k
                faster = speeds_of(answer)[0]  # type: ignore[index]
                assert faster >= speed
                speed = faster
        assert speed > 1.0
        assert speeds_of(peer.rest()[-1]) == ZEROS

    def test_a_command_ends_with_its_session(self, robot: AbbEgm, peer: Peer) -> None:
        with robot.stream() as stream:
            peer.say()
            peer.hear()
            stream.command(FAST)
            peer.say()
            assert speeds_of(peer.hear())[0] > 0.0  # type: ignore[index]
            peer.controller.seqno = 0
            for _ in range(3):
                peer.say()
                assert speeds_of(peer.hear()) == ZEROS
            assert stream.state().session == 2

    def test_an_old_command_ends_in_a_hold(
        self, robot: AbbEgm, peer: Peer, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with robot.stream() as stream:
            peer.say()
            peer.hear()
            stream.command(FAST)
            command, stamp_s, session = stream._newest
            stream._newest = (command, stamp_s - 1.0, session)
            peer.say()
            assert speeds_of(peer.hear()) == ZEROS

    def test_a_thread_that_fails_says_so(
        self, robot: AbbEgm, peer: Peer, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def fail(*_: object) -> None:
            raise RuntimeError("broken")

        with robot.stream() as stream:
            monkeypatch.setattr(robot.session, "reply", fail)
            peer.say()
            assert stream._thread is not None
            stream._thread.join(5.0)
            for use in (stream.state, lambda: stream.command(FAST)):
                with pytest.raises(DriverError, match="broken"):
                    use()
            monkeypatch.undo()
