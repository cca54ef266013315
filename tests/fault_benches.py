"""Benches of seven robots, at the level of the wire, in virtual time.

A bench is one robot: a simulated controller, the network and the driver's process. Time passes
only while the process waits for the robot, or stands still. The robot's real motion, by its own
joints, is in `Bench.motion()`. The benches do not depend on the core: it is `Bench.answer`.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, TypeVar
from unittest import mock

import numpy as np

from cardan.drivers.abb_egm import AbbEgm, AbbEgmOptions
from cardan.drivers.base import RobotDriver
from cardan.drivers.motoros import Motoros, MotorosOptions
from cardan.drivers.robot_core import WAKE_S
from cardan.drivers.ros2_arm import Ros2Arm
from cardan.drivers.ros2_arm.session import STATE_TYPE
from cardan.drivers.ros2_arm.transport import MAX_STATES
from cardan.drivers.sim_arm import SimArm, SimArmOptions
from cardan.drivers.ur_rtde import UrRtde, UrRtdeOptions
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.protocols.egm.decode import decode_robot
from cardan.protocols.egm.encode import encode_robot
from cardan.protocols.egm.messages import EgmRobot, MCIState
from cardan.protocols.joint_stream.codec import decode_state, encode_state
from cardan.protocols.ros2.cdr import codec_of
from cardan.robots import ArmModel, load_arm
from cardan.sim_peers.arm.controller import SimulatedArm
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions, EgmMode
from cardan.sim_peers.ros2_arm import RosArm, RosArmOptions
from cardan.types import HoldCommand, RobotCapabilities, RobotCommand, RobotState, Vector3
from tests.drivers.motoros_bench import SessionBench as MotorosSessionBench
from tests.drivers.ros2_bench import received
from tests.drivers.tcp_bench import TcpBench
from tests.drivers.ur_bench import SessionBench as UrSessionBench

Array = np.ndarray
_B = TypeVar("_B", bound="Bench")

WINDOW_S = 0.02
"""Averaging window of speeds and accelerations: five periods of most robots. A shorter window would
take single pulses and rounding for acceleration."""

MARGIN = 0.05
"""Allowed overshoot of an arm's servos, relative to the speed."""

REST_M_S = 0.001
"""Slower than this the arm counts as stopped."""

SOCKET_DATAGRAMS = 160
"""Datagrams of a controller that the kernel keeps by default (208 KiB, 1.3 KiB for each)."""

JUMP_M = 0.2

_START_S = 100.0

CLOCKS: dict[str, Callable[[float], float]] = {
    "jumps ahead by 0.14 s": lambda since_s: 0.14,
    "jumps back by 0.14 s": lambda since_s: -0.14,
    "stands still": lambda since_s: -since_s,
    "0.5 times as fast": lambda since_s: -0.5 * since_s,
    "1.02 times as fast": lambda since_s: 0.02 * since_s,
    "1.6 times as fast": lambda since_s: 0.6 * since_s,
    "4 times as fast": lambda since_s: 3.0 * since_s,
    "is off by up to 20 ms, at random": lambda since_s: (
        0.04 * (math.sin(1e5 * since_s) * 1e4 % 1.0 - 0.5)
    ),
}
"""Error of the time that a controller reports, s, by the time since the fault began."""


class Motion(NamedTuple):
    """Motion of the TCP from a given time on."""

    stop_s: float
    """Time of the last motion faster than REST_M_S; infinite if the arm did not stop."""
    distance_m: float
    """Distance between the position at the fault and the rest or last position."""
    peak_m_s: float
    peak_m_s2: float
    back_m: float
    """Distance moved against the initial direction."""


class Bench(ABC):
    """A robot, its driver, and the process that runs the driver."""

    name: str
    arm: str
    direction: Vector3
    """Direction in which the TCP has room for 0.4 m from its start."""
    own_stop = ""
    """This robot's stop without commands; empty: within the requested limits."""

    def __init__(self) -> None:
        self.model: ArmModel = load_arm(self.arm)
        self.kinematics = ArmKinematics(self.model)
        self.now_s = _START_S
        self.answer: Callable[[RobotState], RobotCommand] = lambda state: HoldCommand()
        """Answer of the core to each state."""
        self.alive = True
        """False: the process was killed."""
        self.bad: str = ""
        """Error in the robot's reports: "nan", "jump", or a false reason why commands do not
        act."""
        self.clock = ""
        """Error of the controller's clock, a key of CLOCKS."""
        self._lies_since_s = math.inf
        self.flooded = False
        self._delay_s = 0.0
        self.states: list[RobotState] = []
        self.times: list[float] = []
        self.joints: list[tuple[float, ...]] = []
        """True joint positions of the arm."""

    @property
    @abstractmethod
    def driver(self) -> RobotDriver: ...

    @property
    def capabilities(self) -> RobotCapabilities:
        return self.driver.capabilities

    def __enter__(self: _B) -> _B:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @abstractmethod
    def close(self) -> None:
        """End the process like a regular exit."""

    # -- time -----------------------------------------------------------------------------------

    def run(self, seconds: float) -> None:
        """Run the process, or the robot alone if the process is dead."""
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            if self.alive:
                self._turn(end_s)
            else:
                self._world(end_s)

    def stall(self, seconds: float) -> None:
        """Stop the process; robot, network and kernel continue."""
        self._world(self.now_s + seconds)

    def delay(self, seconds: float) -> None:
        """Stop the process likewise between the next state that it may answer and its command."""
        self._delay_s = seconds

    @abstractmethod
    def _turn(self, end_s: float) -> None:
        """Let the process answer one state, or wait until `end_s`."""

    @abstractmethod
    def _world(self, until_s: float) -> None:
        """Let time pass outside of the process."""

    def _tell(self, state: RobotState) -> RobotCommand:
        self.states.append(state)
        command = self.answer(state)
        if self._delay_s and state.ready:
            seconds, self._delay_s = self._delay_s, 0.0
            self.stall(seconds)
        return command

    def _note(self, time_s: float, joints: Sequence[float]) -> None:
        self.times.append(time_s)
        self.joints.append(tuple(joints))

    def ready(self) -> Bench:
        """Run until commands act."""
        for _ in range(200):
            self.run(0.05)
            if self.states and self.states[-1].ready:
                return self
        raise AssertionError(self.states[-1].hold_reason)

    # -- faults ---------------------------------------------------------------------------------

    def kill(self) -> None:
        """Kill the process (SIGKILL): it sends no more data, and the kernel closes all files."""
        self.alive = False

    @abstractmethod
    def restart(self) -> None:
        """Switch the controller off and on."""

    @abstractmethod
    def unready(self) -> None:
        """Stop the robot at its controller."""

    @abstractmethod
    def unpower(self) -> None:
        """Cut the power of the motors."""

    def lie(self, clock: str) -> None:
        """Let the controller report wrong times from now on."""
        self.clock, self._lies_since_s = clock, self.now_s

    def lied_s(self, time_s: float) -> float:
        """Return the error of the controller's reported time at `time_s`, s."""
        since_s = time_s - self._lies_since_s
        return CLOCKS[self.clock](since_s) if self.clock and since_s >= 0.0 else 0.0

    def hold(self) -> None:
        """Let the robot report that commands do not act, although the controller obeys them."""
        self.bad = "somebody holds the arm"

    def _jumped(self, joints: Sequence[float]) -> tuple[float, ...]:
        """Return `joints` with the TCP moved by JUMP_M about the first axis."""
        position = self.kinematics.forward(np.array(joints)).translation
        return (joints[0] + JUMP_M / math.hypot(position[0], position[1]), *joints[1:])

    @property
    @abstractmethod
    def period_s(self) -> float:
        """Sampling period of `joints`."""

    # -- results ----------------------------------------------------------------------------------

    def path(self) -> tuple[Array, Array]:
        """Return times, s, and positions of the TCP, m."""
        forward = self.kinematics.forward
        points = [forward(np.array(q)).translation.copy() for q in self.joints]
        return np.array(self.times), np.array(points)

    def motion(self, since_s: float) -> Motion:
        """Return the motion of the TCP from `since_s` to the end."""
        times, points = self.path()
        return motion_of(times, points, since_s, self.period_s)


def motion_of(times: Array, points: Array, since_s: float, period_s: float) -> Motion:
    """Return the figures of a path that was sampled every `period_s`."""
    n = round(WINDOW_S / period_s)
    window_s = n * period_s
    velocity = (points[n:] - points[:-n]) / window_s
    change = np.linalg.norm(velocity[n:] - velocity[:-n], axis=1) / window_s
    speed = np.linalg.norm(velocity, axis=1)
    first = int(np.searchsorted(times, since_s + 1e-9))
    here = points[first - 1]
    ended = times[n:] >= since_s
    moving = np.nonzero((speed > REST_M_S) & ended)[0]
    # A window counts as moving until its end.
    last = int(moving[-1]) if len(moving) else 0
    stopped = last + 1 < len(speed)
    heading = points[first - 1] - points[max(first - 1 - n, 0)]
    size = float(np.linalg.norm(heading))
    along = (points[first - 1 :] - here) @ (heading / size if size > 0.0 else heading)
    farthest = np.maximum.accumulate(along)
    return Motion(
        max(float(times[last]) - since_s, 0.0) if stopped else math.inf,
        float(np.linalg.norm(points[-1] - here)),
        float(speed[ended].max()),
        float(change[times[2 * n :] >= since_s].max()),
        float((farthest - along).max()),
    )


# -- robots at the end of a socket ----------------------------------------------------------------


class _Datagrams(Bench):
    """Robot over UDP: its controller sends in every period, with or without a receiver."""

    def __init__(self) -> None:
        super().__init__()
        self.queue: deque[tuple[bytes, tuple[str, int]]] = deque()
        """Received datagrams in the kernel's buffer of the driver."""
        self._next_s = self.now_s
        with self._virtual():
            self.robot = self._opened()
            self._cycles = self.robot.cycles()

    @abstractmethod
    def _replaced(self) -> dict[str, object]:
        """Return the names of the driver's module to patch, and their stand-ins in virtual time."""

    @abstractmethod
    def _opened(self) -> RobotDriver: ...

    @abstractmethod
    def _cycle(self, now_s: float) -> Sequence[bytes]:
        """Run the controller for a period."""

    SOURCE = ("192.0.2.1", 40000)

    @property
    def driver(self) -> RobotDriver:
        return self.robot

    @contextlib.contextmanager
    def _virtual(self) -> Iterator[None]:
        with contextlib.ExitStack() as patches:
            for target, new in self._replaced().items():
                patches.enter_context(mock.patch(target, new))
            yield

    def close(self) -> None:
        with self._virtual():
            self.robot.close()

    def _turn(self, end_s: float) -> None:
        with self._virtual():
            while self.now_s < end_s - 1e-9 and self.alive:
                state = next(self._cycles)
                command = self._tell(state)
                if self.alive:
                    self.robot.send(command)

    def _world(self, until_s: float) -> None:
        while self._next_s <= until_s:
            self._period()
        self.now_s = max(self.now_s, until_s)

    def _period(self) -> None:
        now_s = self._next_s
        self._next_s += self.period_s
        for data in self._cycle(now_s):
            self.deliver(
                self._falsified(self._timed(data, self.lied_s(now_s)) if self.clock else data)
            )
        if self.flooded:
            for _ in range(20):
                self.deliver(b"garbage")
        self._note(now_s, self._true_joints())

    def deliver(self, data: bytes) -> None:
        if len(self.queue) < SOCKET_DATAGRAMS:
            self.queue.append((data, self.SOURCE))

    def wait(self, timeout_s: float) -> bool:
        """Let time pass until a datagram is there."""
        until_s = self.now_s + timeout_s
        while not self.queue and self._next_s <= until_s:
            self.now_s = max(self.now_s, self._next_s)
            self._period()
        if not self.queue:
            self.now_s = max(self.now_s, until_s)
        return bool(self.queue)

    @abstractmethod
    def _falsified(self, data: bytes) -> bytes:
        """Return `data` as it arrives, with the error `bad`."""

    @abstractmethod
    def _timed(self, data: Any, by_s: float) -> Any:
        """Return `data` with its time changed by `by_s`."""

    @abstractmethod
    def _true_joints(self) -> Sequence[float]: ...


class _Poll:
    """Stand-in for select.poll() of a bench's socket."""

    def __init__(self, bench: _Datagrams) -> None:
        self._bench = bench

    def register(self, sock: object, events: int) -> None:
        pass

    def poll(self, timeout_ms: float = 0.0) -> list[object]:
        bench = self._bench
        if not bench.queue and timeout_ms > 0.0:
            bench.wait(1e-3 * timeout_ms)
        return [bench] if bench.queue else []


class _Socket:
    """UDP socket with the driver's end of a bench."""

    WAKE_S = 0.1

    def __init__(self, bench: EgmBench) -> None:
        self._bench = bench
        self._blocks = open(os.devnull, "rb")  # noqa: SIM115

    def setsockopt(self, *args: object) -> None:
        pass

    def fileno(self) -> int:
        """Return the number of a blocking file, like the real socket's."""
        return self._blocks.fileno()

    def getsockname(self) -> tuple[str, int]:
        return ("192.0.2.2", 6510)

    def recvfrom(self, size: int, flags: int = 0) -> tuple[bytes, tuple[str, int]]:
        bench = self._bench
        if not bench.queue and (flags or not bench.wait(self.WAKE_S)):
            raise BlockingIOError
        return bench.queue.popleft()

    def sendto(self, data: bytes, address: tuple[str, int]) -> int:
        self._bench.controller.receive(data)
        return len(data)

    def close(self) -> None:
        self._blocks.close()


class _Select:
    """Stand-in for the module `select`, with the functions that the driver uses."""

    POLLIN = select.POLLIN

    def __init__(self, bench: _Datagrams) -> None:
        self._bench = bench

    def poll(self) -> _Poll:
        return _Poll(self._bench)


class EgmBench(_Datagrams):
    """GoFa with Externally Guided Motion."""

    arm = "gofa_crb15000_5"
    direction = Vector3(-1.0, 0.0, 0.0)
    own_stop = "its ramp of 0.5 s after CommTimeout, 0.2 s"
    mode = "pose"
    name = "EGM pose"

    def __init__(self) -> None:
        self.controller = EgmController(
            EgmControllerOptions(mode=EgmMode(self.mode), comm_timeout_s=0.2)
        )
        super().__init__()

    def _replaced(self) -> dict[str, object]:
        module = "cardan.drivers.abb_egm.driver"
        return {
            f"{module}.bind_udp": lambda host, port: _Socket(self),
            f"{module}.select": _Select(self),
            f"{module}._monotonic": lambda: self.now_s,
        }

    def _opened(self) -> AbbEgm:
        robot = AbbEgm(AbbEgmOptions(mode=self.mode, robot=self.arm))  # type: ignore[arg-type]
        robot.open()
        return robot

    @property
    def period_s(self) -> float:
        return self.controller.options.period_s

    def _cycle(self, now_s: float) -> Sequence[bytes]:
        data = self.controller.cycle(now_s)
        return () if data is None else (data,)

    def _falsified(self, data: bytes) -> bytes:
        if not self.bad:
            return data
        message = decode_robot(data)
        assert isinstance(message, EgmRobot)
        motion = message.feed_back
        assert motion is not None
        assert motion.joints is not None
        if self.bad == "nan":
            found = motion._replace(joints=(math.nan,) * 6)
            return encode_robot(message._replace(feed_back=found))
        if self.bad == "jump":
            joints = self._jumped(motion.joints)
            placed = self.kinematics.forward(np.array(joints)).translation
            assert motion.cartesian is not None
            pose = motion.cartesian._replace(pos=Vector3(*placed.tolist()))
            found = motion._replace(joints=joints, cartesian=pose)
            return encode_robot(message._replace(feed_back=found))
        return encode_robot(message._replace(mci_state=MCIState.STOPPED))

    def _timed(self, data: bytes, by_s: float) -> bytes:
        message = decode_robot(data)
        assert isinstance(message, EgmRobot)
        header, motion = message.header, message.feed_back
        assert header is not None
        assert header.tm_ms is not None
        assert motion is not None
        assert motion.time_us is not None
        tm_ms = (header.tm_ms + round(1e3 * by_s)) & 0xFFFFFFFF
        motion = motion._replace(time_us=motion.time_us + round(1e6 * by_s))
        return encode_robot(message._replace(header=header._replace(tm_ms=tm_ms), feed_back=motion))

    def _true_joints(self) -> Sequence[float]:
        return self.controller.joints_rad

    def restart(self) -> None:
        self.controller.do("controller-restart")

    def unready(self) -> None:
        self.controller.do("program-stop")

    def unpower(self) -> None:
        self.controller.do("motors-off")


class EgmJointBench(EgmBench):
    """The same robot with joint commands."""

    mode = "joint"
    name = "EGM joint"


class _Link:
    """Driver's transport to a simulated arm, without a network."""

    def __init__(self, bench: JointStreamBench) -> None:
        self._bench = bench

    def now(self) -> float:
        return self._bench.now_s

    def send(self, data: bytes) -> None:
        self._bench.peer.receive(data, self._bench.now_s, "client")

    def wait(self) -> list[bytes]:
        bench = self._bench
        bench.wait(0.1)
        return self.waiting()

    def waiting(self) -> list[bytes]:
        found = [data for data, _ in self._bench.queue]
        self._bench.queue.clear()
        return found

    def close(self) -> None:
        pass


class JointStreamBench(_Datagrams):
    """UR5 with a joint stream."""

    name = "joint stream"
    arm = "ur5"
    direction = Vector3(0.0, -1.0, 0.0)
    own_stop = "the braking of its joints after 0.1 s without a command"

    def __init__(self) -> None:
        self.peer = SimulatedArm(
            SimulatedArmOptions(robot=self.arm, plant=PlantOptions(gravity_feedforward=True))
        )
        super().__init__()

    def _replaced(self) -> dict[str, object]:
        return {"cardan.drivers.sim_arm.driver.UdpTransport": lambda *address: _Link(self)}

    def _opened(self) -> SimArm:
        robot = SimArm(SimArmOptions(robot=self.arm, transport="udp"))
        robot.open()
        return robot

    @property
    def period_s(self) -> float:
        return self.peer.options.period_s

    def _cycle(self, now_s: float) -> Sequence[bytes]:
        return self.peer.cycle(now_s)

    def _falsified(self, data: bytes) -> bytes:
        if not self.bad:
            return data
        state = decode_state(data)
        if self.bad == "nan":
            return encode_state(state._replace(positions=(math.nan,) * 6))
        if self.bad == "jump":
            joints = self._jumped(state.positions)
            placed = self.kinematics.forward(np.array(joints)).translation
            pose = (*placed.tolist(), *state.pose[3:])
            return encode_state(state._replace(positions=joints, pose=pose))
        return encode_state(state._replace(reason=self.bad))

    def _timed(self, data: bytes, by_s: float) -> bytes:
        state = decode_state(data)
        return encode_state(state._replace(stamp_s=state.stamp_s + by_s))

    def _true_joints(self) -> Sequence[float]:
        return self.peer.plant.positions

    def restart(self) -> None:
        self.peer.restart()

    def unready(self) -> None:
        self.peer.emergency_stop()

    def unpower(self) -> None:
        self.peer.plant.give_in()
        self.peer.emergency_stop()


class Ros2Bench(_Datagrams):
    """UR5 of a ROS 2 system with its forward_position_controller."""

    name = "ROS 2"
    arm = "ur5"
    direction = Vector3(0.0, -1.0, 0.0)
    own_stop = "its controller, which keeps the last position"

    def __init__(self) -> None:
        self.peer = RosArm(RosArmOptions(robot=self.arm, rate_hz=250.0))
        self.taken = True
        super().__init__()

    def _replaced(self) -> dict[str, object]:
        transports = {"zenoh": lambda _options: _RosLink(self)}
        return {"cardan.drivers.ros2_arm.driver.TRANSPORTS": transports}

    def _opened(self) -> Ros2Arm:
        robot = Ros2Arm(robot=self.arm, rate_hz=250.0)
        robot.open()
        return robot

    @property
    def period_s(self) -> float:
        return self.peer.options.period_s

    def _cycle(self, now_s: float) -> Sequence[Any]:
        states = self.peer.cycle(now_s)
        return [received(each.data, each.sequence, each.sender) for each in states]

    def deliver(self, data: Any) -> None:
        if isinstance(data, bytes):
            data = received(data, 1, 9)
        if len(self.queue) == MAX_STATES:
            self.queue.popleft()
        self.queue.append((data, self.SOURCE))

    def _falsified(self, data: Any) -> Any:
        if self.bad not in ("nan", "jump"):
            return data
        codec = codec_of(STATE_TYPE)
        message = codec.decode(data.data)
        names, position = message["name"], message["position"]
        if self.bad == "nan":
            message["position"] = [math.nan] * len(position)
        else:
            order = [names.index(joint.name) for joint in self.model.joints]
            jumped = self._jumped([position[index] for index in order])
            for index, value in zip(order, jumped, strict=True):
                position[index] = value
        return data._replace(data=codec.encode(message))

    def _timed(self, data: Any, by_s: float) -> Any:
        codec = codec_of(STATE_TYPE)
        message = codec.decode(data.data)
        stamp = message["header"]["stamp"]
        ns = stamp["sec"] * 1_000_000_000 + stamp["nanosec"] + round(1e9 * by_s)
        stamp["sec"], stamp["nanosec"] = divmod(ns, 1_000_000_000)
        return data._replace(data=codec.encode(message))

    def _true_joints(self) -> Sequence[float]:
        return self.peer.plant.positions

    def restart(self) -> None:
        self.peer.go_down()

    def unready(self) -> None:
        self.peer.unload()

    def unpower(self) -> None:
        self.peer.plant.give_in()
        self.peer.unload()

    def hold(self) -> None:
        self.taken = False


class _RosLink:
    """Driver's transport to the bench."""

    def __init__(self, bench: Ros2Bench) -> None:
        self._bench = bench

    def now(self) -> float:
        return self._bench.now_s

    def send(self, data: bytes) -> None:
        self._bench.peer.receive(data)

    def wait(self) -> list[Any]:
        self._bench.wait(WAKE_S)
        return self.waiting()

    def waiting(self) -> list[Any]:
        queue = self._bench.queue
        return [queue.popleft()[0] for _ in range(len(queue))]

    def taken(self) -> bool:
        bench = self._bench
        return bench.taken and bench.peer.up and bench.peer.loaded

    def publisher(self, _gid: bytes) -> str:
        return ""

    def description(self) -> str:
        return ""

    def close(self) -> None:
        pass


# -- robots of several TCP connections ------------------------------------------------------------


class _Connections(Bench):
    """Robot at the end of a session's bench."""

    session_bench: TcpBench
    _driver: RobotDriver

    @property
    def driver(self) -> RobotDriver:
        return self._driver

    def ready(self) -> Bench:
        self.session_bench.ready()
        return self

    def _turn(self, end_s: float) -> None:
        self.session_bench.run(end_s - self.session_bench.now_s)
        self.now_s = self.session_bench.now_s

    def _world(self, until_s: float) -> None:
        self.session_bench.stall(until_s - self.session_bench.now_s)

    def close(self) -> None:
        self.session_bench.session.leave(self.session_bench.now_s)

    def kill(self) -> None:
        super().kill()
        session_bench = self.session_bench
        for number in session_bench.numbers.values():
            session_bench.servers.eof(number, session_bench.now_s)
        session_bench.numbers.clear()

    def _cut(self) -> None:
        """Break all connections for both ends."""
        for channel in tuple(self.session_bench.numbers):
            self.session_bench.unplug(channel)

    def hold(self) -> None:
        self.session_bench.session.ask("disable", self.session_bench.now_s)


# -- MotoROS --------------------------------------------------------------------------------------


class _WatchedMotoros(MotorosSessionBench):
    """Bench of the MotoROS tests that records the arm's positions."""

    def __init__(self, bench: MotorosBench, *args: object, **kwargs: object) -> None:
        self._bench = bench
        super().__init__(*args, **kwargs)

    def turn(self) -> None:
        super().turn()
        self._bench.watch()


class MotorosBench(_Connections):
    """GP8 over MotoROS in velocity mode."""

    name = "MotoROS velocity"
    arm = "gp8"
    direction = Vector3(0.0, 1.0, 0.0)
    mode = "velocity"
    own_stop = "the braking of its joints after 0.1 s without a command"
    IPC_S = 0.004

    def __init__(self) -> None:
        super().__init__()
        self._row = 0
        self.session_bench = _WatchedMotoros(
            self,
            {"mode": self.mode, "robot": self.arm},
            self._tell,
            start_s=self.now_s,
            tick_s=1e-3,
            velocity_mode=self.mode == "velocity",
        )
        feedback = self.session_bench.controller.feedback
        self.session_bench.controller.feedback = lambda group: self._falsified(feedback(group))
        self._driver = Motoros(MotorosOptions(mode=self.mode, robot=self.arm))  # type: ignore[arg-type]

    @property
    def period_s(self) -> float:
        return self.IPC_S

    def watch(self) -> None:
        """Record the arm's position once in each interpolation period."""
        self.now_s = now_s = self.session_bench.now_s
        row = int((now_s - _START_S) / self.IPC_S + 1e-6)
        if row > self._row:
            joints = self.session_bench.controller.measured_rad(0)
            for n in range(self._row + 1, row + 1):
                self._note(_START_S + n * self.IPC_S, joints)
            self._row = row

    def _falsified(self, feedback: object) -> object:
        time_s = feedback.time + self.lied_s(self.now_s)  # type: ignore[attr-defined]
        feedback = feedback._replace(time=time_s)  # type: ignore[attr-defined]
        if self.bad not in ("nan", "jump"):
            return feedback
        pos = feedback.pos  # type: ignore[attr-defined]
        if self.bad == "nan":
            return feedback._replace(pos=(math.nan,) * 10)  # type: ignore[attr-defined]
        jumped = (*self._jumped(pos[:6]), *pos[6:])
        return feedback._replace(pos=jumped)  # type: ignore[attr-defined]

    def restart(self) -> None:
        """Break its connections; the controller is back at once, with the drives off."""
        self._cut()
        self.unpower()

    def unready(self) -> None:
        self.session_bench.controller.job_stop(self.session_bench.now_s)

    def unpower(self) -> None:
        self.session_bench.controller.servo(False, self.session_bench.now_s)


class MotorosStreamBench(MotorosBench):
    """GP8 whose controller has no velocity mode."""

    name = "MotoROS stream"
    mode = "stream"
    own_stop = "its command stops dead when its queue is empty"


# -- Universal Robots -----------------------------------------------------------------------------


class _WatchedUr(UrSessionBench):
    """Bench of the UR tests that records the arm's positions."""

    def __init__(self, bench: UrBench, *args: object, **kwargs: object) -> None:
        self._bench = bench
        super().__init__(*args, **kwargs)

    def turn(self) -> None:
        self._bench.now_s = self.now_s
        super().turn()
        self._bench.watch()


class UrBench(_Connections):
    """UR5e over RTDE at 250 Hz."""

    name = "UR"
    arm = "ur5e"
    direction = Vector3(0.0, 1.0, 0.0)
    own_stop = "its program's stopj after 0.1 s without a command"
    RATE_HZ = 250.0

    def __init__(self) -> None:
        super().__init__()
        given = {"robot": self.arm, "rate_hz": self.RATE_HZ}
        self._rows = 0
        self.session_bench = _WatchedUr(self, given, self._tell, start_s=self.now_s)
        telemetry = self.session_bench.servers.telemetry
        value = telemetry.value
        telemetry.value = lambda name: self._falsified(name, value(name))  # type: ignore[method-assign]
        self._driver = UrRtde(UrRtdeOptions(**given))  # type: ignore[arg-type]

    @property
    def capabilities(self) -> RobotCapabilities:
        return self.session_bench.session.capabilities

    @property
    def period_s(self) -> float:
        return self.session_bench.controller.period_s

    def watch(self) -> None:
        """Record the arm's position in each frame of its controller."""
        trace = self.session_bench.trace
        for time_s, _, joints in trace[self._rows :]:
            self._note(time_s, joints)
        self._rows = len(trace)

    def _falsified(self, name: str, value: Any) -> Any:
        if name == "timestamp":
            return value + self.lied_s(self.session_bench.now_s)
        if name != "actual_q" or self.bad not in ("nan", "jump"):
            return value
        return (math.nan,) * len(value) if self.bad == "nan" else self._jumped(value)

    def restart(self) -> None:
        """Break its connections; its program and registers are lost, and its power is off."""
        self._cut()
        self.session_bench.controller.restart()

    def unready(self) -> None:
        self.session_bench.controller.stop_program()

    def unpower(self) -> None:
        self.session_bench.controller.power_off()


BENCHES: tuple[type[Bench], ...] = (
    EgmBench,
    EgmJointBench,
    UrBench,
    MotorosStreamBench,
    MotorosBench,
    JointStreamBench,
    Ros2Bench,
)
