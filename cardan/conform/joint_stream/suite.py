"""The suite of an arm that speaks the joint stream."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from cardan.conform.conduct import Conduct
from cardan.conform.joint_stream.pilot import JointStreamPilot
from cardan.conform.joint_stream.requirements import requires
from cardan.conform.joint_stream.seen import JointStreamSeen
from cardan.conform.requirements import Level
from cardan.conform.suite import Suite, Transport
from cardan.conform.timeline import Timeline
from cardan.conform.wires import SendTo, Wires, host_and_port

PORT = 6520


class JointStream(Suite[JointStreamSeen]):
    """An arm that is commanded joint by joint, as Cardan's own simulated arm is."""

    name = "joint-stream"
    judges = "the controller"
    speaks = "joint stream on UDP"
    target = "HOST[:PORT] of the controller, 6520"
    peer = "arm"
    requirements = requires.all()
    transport = Transport("udp", {"": PORT})
    seconds = 2.0
    # Beyond the cycle of the rig; while it is held; below the speed of a micro-motion.
    tried_with: ClassVar[Mapping[str, float]] = {
        "jitter": 20.0,
        "silence": 3.0,
        "restart": 2.0,
        "estop": 2.0,
        "slow": 0.0002,
    }

    def see(self, timeline: Timeline) -> JointStreamSeen:
        return JointStreamSeen(timeline)

    def pilot(self, level: Level, seconds: float) -> JointStreamPilot:
        return JointStreamPilot(level, seconds)

    def simulate(self, conduct: Conduct, faults: Mapping[str, float], seed: int) -> None:
        # The simulated arm needs the extra cardan[arm]; a real one does not.
        from cardan.conform.joint_stream.rig import JointStreamRig

        JointStreamRig(conduct, faults, seed).run()

    def wires(self, target: str) -> Wires:
        host, port = host_and_port(target, "--target", PORT)
        return SendTo(host, port)
