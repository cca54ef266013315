"""The suite of a client that moves an arm over the joint stream."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.conduct import Conduct, Pilot
from cardan.conform.joint_stream.seen import JointStreamSeen
from cardan.conform.joint_stream.suite import PORT
from cardan.conform.joint_stream_driver.faults import FAULTS
from cardan.conform.joint_stream_driver.requirements import requires
from cardan.conform.joint_stream_driver.rig import JointStreamDriverRig
from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, Transport
from cardan.conform.timeline import Timeline
from cardan.conform.wires import Listen, Wires, host_and_port
from cardan.sim_peers.base import FaultSwitch


class JointStreamDriver(Suite[JointStreamSeen]):
    """A driver of a UR5 over the joint stream: Cardan is the arm, and nothing real moves."""

    name = "joint-stream-driver"
    judges = "the driver"
    speaks = "joint stream on UDP, 125 Hz"
    target = "[HOST]:PORT to listen at, 0.0.0.0:6520"
    peer = "sim_arm"
    harmless = Level.HOLD
    requirements = requires.all()
    transport = Transport("udp", {"": PORT}, frozenset(("",)))
    seconds = 0.8
    # Seen where it is ended, which only level 3 does.
    tried_on: ClassVar[Mapping[str, Level]] = {"leaves-moving": Level.BY_HAND}

    def see(self, timeline: Timeline) -> JointStreamSeen:
        return JointStreamSeen(timeline, arm_sends=True)

    def pilot(self, level: Level, seconds: float) -> Pilot:
        # The simulated arm needs the extra cardan[arm]; judging what it heard does not.
        from cardan.conform.joint_stream_driver.pilot import ArmPilot

        return ArmPilot(level, seconds)

    def simulate(self, conduct: Conduct, faults: Mapping[str, float], seed: int) -> None:
        JointStreamDriverRig(conduct, faults).run()

    def wires(self, target: str) -> Wires:
        host, port = host_and_port(target, "--target", PORT)
        return Listen(host or "0.0.0.0", port)

    def switches(self) -> tuple[FaultSwitch, ...]:
        return FAULTS
