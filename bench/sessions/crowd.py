"""Robots and operators of the measured sessions, played by one process in C."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

import numpy as np

from bench.arms import kinematics
from cardan.errors import DriverError
from cardan.gateway.kinematics.base import to_pose
from cardan.protocols.connexion.reports import encode_buttons
from cardan.protocols.egm.encode import encode_robot
from cardan.protocols.egm.messages import EgmHeader, EgmMotion, EgmPose, EgmRobot
from cardan.robots import load_arm

ARM = "gofa_crb15000_5"

MODEL = "spacemouse-compact"
"""Model of the mice."""

SOURCE = Path(__file__).with_name("crowd.c")

NUMBER = 0xFFFF_FFFF
"""Placeholder of the sequence number and the clock: the longest encoding of a number in EGM's
header."""

AS_VARINT = b"\xff\xff\xff\xff\x0f"

TIME_US = NUMBER * 1_000_000 + 999_999
"""Placeholder of a measurement's clock, likewise."""


class Played(NamedTuple):
    """Counts of one run of the player."""

    sent: int
    """Control instants of all robots."""
    missed: int
    """Instants without an answer before the next instant."""
    worst: int
    """Largest number of misses of one robot."""
    moved: int
    """Answers that moved their robot."""
    skipped: int
    """Instants for which the player itself was late; they count for no session."""
    p50_s: float
    """Median time from sending the datagram to the arrival of the answer, by the kernel's time
    stamp."""
    p99_s: float
    late_p99_s: float
    """Delay of the player's own datagrams."""
    late_max_s: float

    @property
    def missed_share(self) -> float:
        """Share of missed instants."""
        return self.missed / self.sent if self.sent else 0.0


def template() -> tuple[bytes, tuple[int, int, int, int, int, int]]:
    """Return the message of a robot at its home, and the offsets in it of the sequence number, the
    header's clock, the measured and planned joints, and their clocks."""
    joints = tuple(load_arm(ARM).home)
    pose = to_pose(kinematics(ARM).forward(np.array(joints)))
    home = EgmMotion(joints, EgmPose(pose.position, pose.orientation), time_us=TIME_US)
    data = encode_robot(
        EgmRobot(
            header=EgmHeader(NUMBER, NUMBER, 2),
            feed_back=home,
            planned=home,
            motor_state=1,
            mci_state=3,
            mci_convergence_met=False,
            rapid_exec_state=2,
            utilization_rate=12.5,
        )
    )
    sequence = data.index(AS_VARINT)
    clock = data.index(AS_VARINT, sequence + len(AS_VARINT))
    # The field joints has 54 bytes: joints of 9 bytes each, a tag and a double.
    measured = data.index(b"\x0a\x36\x09") + 3
    planned = data.index(b"\x0a\x36\x09", measured) + 3
    # The field time: seconds, a tag, microseconds.
    measured_clock = data.index(AS_VARINT, measured)
    planned_clock = data.index(AS_VARINT, planned)
    return data, (sequence, clock, measured, planned, measured_clock, planned_clock)


def compiler() -> str | None:
    """Return the C compiler, if there is one."""
    return shutil.which(os.environ.get("CC", "cc"))


def build(folder: Path, *more: str) -> Path:
    """Return the program, compiled into `folder`; `more`: flags. Raises DriverError."""
    cc = compiler()
    if cc is None:
        raise DriverError("there is no C compiler (Debian: apt-get install gcc libc6-dev)")
    program = folder / "crowd"
    flags = ("-std=c11", "-D_GNU_SOURCE", "-O2", "-Wall", "-Wextra", "-Wshadow", *more)
    subprocess.run([cc, *flags, "-o", str(program), str(SOURCE), "-lm"], check=True)
    return program


class Crowd:
    """The player's process, which serves a mouse in `folder` for each port, and plays on
    request."""

    def __init__(self, folder: Path, ports: Sequence[int], *flags: str) -> None:
        """`flags`: additional compiler flags."""
        data, places = template()
        words = (
            folder, data.hex(), ",".join(map(str, places)), encode_buttons(1, 3).hex(),
            encode_buttons(0, 3).hex(), *ports,
        )  # fmt: skip
        self._process = subprocess.Popen(
            [str(build(folder, *flags)), *map(str, words)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.scheduling = self._line("READY ").removeprefix("READY ")

    @staticmethod
    def mouse(folder: Path, number: int) -> Path:
        """Return the path of the mouse with that number."""
        return folder / f"{number}.mouse"

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def play(
        self, count: int, warm_up_s: float, seconds: float, begun: Callable[[], None]
    ) -> Played:
        """Play the first `count` robots; `begun` is called after the warm-up."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"play {count} {warm_up_s} {seconds}\n")
        self._process.stdin.flush()
        self._line("BEGIN")
        begun()
        return Played(**json.loads(self._line("{")))

    def _line(self, start: str) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.startswith(start):
            raise DriverError(f"who plays the robots has ended: {line!r}")
        return line.rstrip()

    def __enter__(self) -> Crowd:
        return self

    def __exit__(
        self,
        _type: type[BaseException] | None,
        _error: BaseException | None,
        _trace: TracebackType | None,
    ) -> None:
        self._process.terminate()
        self._process.communicate()
