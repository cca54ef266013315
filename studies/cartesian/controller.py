"""A robot controller that speaks EGM, and a session connected to it."""

from __future__ import annotations

import contextlib
import functools
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from cardan.common.arm_libraries import np
from cardan.gateway.kinematics.arm import ArmKinematics
from cardan.gateway.kinematics.base import to_pose
from cardan.gateway.session.subprocesses import cardan_subprocess
from cardan.protocols.egm.decode import decode_from_pc
from cardan.protocols.egm.encode import encode_robot
from cardan.protocols.egm.messages import (
    EgmHeader,
    EgmMeasuredForce,
    EgmMotion,
    EgmPose,
    EgmRobot,
    EgmSensor,
)
from cardan.robots import load_arm
from cardan.types import Quaternion, Vector3

START = EgmMotion(
    (0.0, 0.0, 0.0, 0.0, 0.5235987755982988, 0.0),
    EgmPose(Vector3(0.5975, 0.0, 0.83775), Quaternion(0.5, 0.0, 0.8660254037844386, 0.0)),
)


def datagram(
    cycle: int,
    at: EgmMotion = START,
    force: EgmMeasuredForce | None = None,
    time_ms: int | None = None,
) -> bytes:
    """Return the message of a RobotWare 7 controller in this cycle (joints, pose, clock, states).
    `time_ms`: its ms clock, if cycles do not come every 4 ms."""
    motion = at._replace(time_us=1_700_000_000_000_000 + cycle * 4000)
    tm_ms = 1_000_000 + (cycle * 4 if time_ms is None else time_ms)
    header = EgmHeader(seqno=cycle, tm_ms=tm_ms, mtype=2)
    return encode_robot(
        EgmRobot(
            header=header,
            feed_back=motion,
            planned=motion,
            motor_state=1,
            mci_state=3,
            mci_convergence_met=False,
            rapid_exec_state=2,
            measured_force=force,
            utilization_rate=12.5,
        )
    )


@functools.cache
def _gofa() -> ArmKinematics:
    return ArmKinematics(load_arm("gofa_crb15000_5"))


def obeyed(answer: bytes, before: EgmMotion) -> EgmMotion:
    """Return the position of a robot that obeys at once; its TCP pose is that of the GoFa."""
    reported = decode_from_pc(answer)
    if not isinstance(reported, EgmSensor) or reported.planned is None:
        return before
    if reported.planned.joints is not None:
        pose = to_pose(_gofa().forward(np.array(reported.planned.joints)))
        return EgmMotion(reported.planned.joints, EgmPose(pose.position, pose.orientation))
    return before._replace(cartesian=reported.planned.cartesian)


@contextlib.contextmanager
def session(port: int, more: str, script: str = "") -> Iterator[None]:
    """Run ``cardan run`` with a simulated SpaceMouse that plays `script`, or without an operator
    device. `more`: additional lines of the robot's table, then further tables."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        tables = f'[robot]\ndriver = "abb_egm"\nlisten_port = {port}\n{more}\n'
        if script:
            hid_path, played = str(Path(folder) / "hid"), Path(folder) / "script"
            tables += (
                f'[device]\ndriver = "spacemouse"\ntransport = "socket"\npath = "{hid_path}"\n'
                '[mapping]\ndeadman = "left"\n'
            )
            played.write_text(script)
            words = ("sim", "spacemouse", "--hid", hid_path, "--script", str(played))
            stack.enter_context(cardan_subprocess(*words))
        config = Path(folder) / "bench.toml"
        config.write_text(tables)
        process = subprocess.Popen(
            [sys.executable, "-m", "cardan", "run", str(config)], stdout=subprocess.PIPE
        )
        try:
            assert process.stdout is not None
            process.stdout.readline()  # the first view shows that the loop runs
            yield
        finally:
            process.terminate()
            process.communicate()
