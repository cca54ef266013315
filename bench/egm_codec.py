"""Cost of one EGM datagram: our codec against protobuf's parser alone, in turns, in one run.

Protobuf's parser is used as in ABBRobotEGM. Parsing alone yields no values: reading them is the
second line. The table has medians of batches and their ratio to the first line. The datagrams are a
six-axis controller's (joints, pose with and without Euler angles, clocks, states), the same with
all optional fields of RobotWare 7, and one whose field order only the general decoder accepts.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from ABBRobotEGM import EGM
from ABBRobotEGM._egm_protobuf import egm_pb2

from bench.figures import median_costs
from cardan.protocols.egm.decode import decode_from_pc, decode_robot
from cardan.protocols.egm.encode import encode_rapid_to_robot, encode_robot
from cardan.protocols.egm.messages import (
    EgmCollisionInfo,
    EgmHeader,
    EgmMeasuredForce,
    EgmMotion,
    EgmPose,
    EgmRapidData,
    EgmRobot,
)
from cardan.protocols.egm.reader import FeedbackReader
from cardan.protocols.egm.replies import encode_joint_reply, encode_pose_reply
from cardan.types import Pose, Quaternion, Twist, Vector3

SEQNO, TM_MS = 90_000, 12_345_678
JOINTS = (0.1, -0.2, 0.3, -0.4, math.pi / 6, 0.6)
SIX = (1.5, -2.25, 10.0, 0.125, 0.0, -0.5)
POSITION = Vector3(0.5975, 0.001, 0.83775)
ORIENTATION = Quaternion(0.5, 0.0, 0.8660254037844386, 0.0)
EULER = Vector3(math.pi, math.pi / 3, math.pi)
TIME_US = 1_700_000_001_208_000


def robot(euler: Vector3 | None) -> EgmRobot:
    """Return the message of a six-axis robot's controller."""
    motion = EgmMotion(JOINTS, EgmPose(POSITION, ORIENTATION, euler), None, TIME_US)
    return EgmRobot(
        header=EgmHeader(SEQNO, TM_MS, 2),
        feed_back=motion,
        planned=motion._replace(time_us=TIME_US + 4032),
        motor_state=1,
        mci_state=3,
        mci_convergence_met=False,
        rapid_exec_state=2,
    )


def cases() -> dict[str, Callable[[], object]]:
    """Timed functions by name; protobuf's parser first."""
    usual = encode_robot(robot(EULER))
    reader = FeedbackReader()
    reader.read(usual)
    reader.learn()
    without_euler = encode_robot(robot(None))
    full = encode_robot(
        robot(EULER)._replace(
            measured_force=EgmMeasuredForce(SIX, True),
            utilization_rate=12.5,
            move_index=1,
            collision_info=EgmCollisionInfo(False, SIX),
            rapid_from_robot=EgmRapidData(True, SIX),
            torque_ref=SIX,
        )
    )
    header_bytes = 2 + usual[1]
    unusual = usual[header_bytes:] + usual[:header_bytes]

    def parse() -> egm_pb2.EgmRobot:
        message = egm_pb2.EgmRobot()
        message.ParseFromString(usual)
        return message

    client = EGM.__new__(EGM)  # without opening its socket
    client.send_sequence_number = 0
    degrees = [math.degrees(joint) for joint in JOINTS]

    def client_encode() -> bytes:
        message = client._create_sensor_message(degrees, degrees, None, None, None, None)
        encoded: bytes = message.SerializeToString()
        return encoded

    pose = Pose(POSITION, ORIENTATION)
    twist = Twist(Vector3(0.01, 0.0, -0.02), Vector3(0.1, 0.0, 0.2))
    outputs = encode_rapid_to_robot(EgmRapidData(True, (1.0, 2.0)))
    reply = encode_pose_reply(SEQNO, TM_MS, pose, twist)
    values = robot(EULER)
    return {
        "protobuf parse alone": parse,
        "ABBRobotEGM parse to state": lambda: client._parse_robot_message(parse()),
        "ABBRobotEGM encode joints": client_encode,
        "read feedback (driver)": lambda: reader.read(usual),
        "decode robot": lambda: decode_robot(usual),
        "decode robot, no Euler": lambda: decode_robot(without_euler),
        "decode robot, all of RW 7": lambda: decode_robot(full),
        "decode robot, odd order": lambda: decode_robot(unusual),
        "encode pose reply": lambda: encode_pose_reply(SEQNO, TM_MS, pose, twist, outputs),
        "encode joint reply": lambda: encode_joint_reply(SEQNO, TM_MS, JOINTS, JOINTS, outputs),
        "encode robot (peer)": lambda: encode_robot(values),
        "decode reply (peer)": lambda: decode_from_pc(reply),
    }


def main() -> None:
    """Print the table."""
    costs = median_costs(cases())
    base_s = next(iter(costs.values()))
    print("\nEGM codec, one datagram\n")
    for name, cost_s in costs.items():
        print(f"{name:28}{cost_s * 1e6:9.2f} µs {cost_s / base_s:6.2f}x")
    print(f"\n(x: times {next(iter(costs))})")


if __name__ == "__main__":
    main()
