"""Cost of one message of simple message: our codec against struct alone, in turns, in one run.

`struct` alone reads the numbers of a feedback message into one flat tuple: no field has a name and
nothing is checked. The table has medians of batches, and their ratio to that of struct. `cut and
decode` includes the framing.
"""

from __future__ import annotations

import struct
from collections.abc import Callable

from bench.figures import median_costs
from cardan.protocols.simple_message.codec import wire
from cardan.protocols.simple_message.codes import MotionCommand
from cardan.protocols.simple_message.framing import ByteOrder, FrameReader
from cardan.protocols.simple_message.messages import (
    ZEROS,
    JointFeedback,
    JointFeedbackEx,
    JointTrajPtFull,
    JointVelocity,
    MotionCtrl,
    MotionReply,
    RobotStatus,
    joints10,
    reply,
    request,
    topic,
)

JOINTS = joints10((0.1, -0.2, 0.3, -0.4, 0.5, 0.6))


def cases() -> dict[str, Callable[[], object]]:
    """Timed functions by name; struct alone first."""
    little, big = wire(), wire(ByteOrder.BIG)
    feedback = topic(JointFeedback(0, 6, 0.0, JOINTS, JOINTS, ZEROS))
    status = topic(RobotStatus(1, 0, 0, 0, 0, 2, 1))
    point = request(JointTrajPtFull(0, 1, 7, 0.04, JOINTS, JOINTS, ZEROS))
    velocity = topic(JointVelocity(0, 5, 5, 1.25, ZEROS, JOINTS, ZEROS))
    control = request(MotionCtrl(0, 1, MotionCommand.CHECK_QUEUE_CNT))
    answer = reply(MotionReply(0, 1, MotionCommand.CHECK_QUEUE_CNT, 0, 3))
    groups = tuple(JointFeedback(group, 6, 0.0, JOINTS, JOINTS, ZEROS) for group in range(4))
    several = topic(JointFeedbackEx(4, groups))
    data = {
        name: little.encode(message)
        for name, message in {
            "feedback": feedback,
            "status": status,
            "reply": answer,
            "velocity": velocity,
            "feedback of 4 groups": several,
        }.items()
    }
    big_feedback = big.encode(feedback)
    plain = struct.Struct("<4i2i31f")
    reader = FrameReader(ByteOrder.LITTLE)
    cycle = data["feedback"] + data["status"]

    def cut_and_decode() -> None:
        reader.feed(cycle)
        while (frame := reader.take()) is not None:
            little.decode(frame)

    def decode(name: str) -> Callable[[], object]:
        found = data[name]
        return lambda: little.decode(found)

    return {
        "struct alone, feedback": lambda: plain.unpack(data["feedback"]),
        **{f"decode {name}": decode(name) for name in data},
        "decode feedback, big-endian": lambda: big.decode(big_feedback),
        "cut and decode a state cycle": cut_and_decode,
        "encode point": lambda: little.encode(point),
        "encode velocity": lambda: little.encode(velocity),
        "encode command": lambda: little.encode(control),
        "encode feedback (peer)": lambda: little.encode(feedback),
        "encode reply (peer)": lambda: little.encode(answer),
    }


def main() -> None:
    """Print the table."""
    costs = median_costs(cases())
    base_s = next(iter(costs.values()))
    print("\nsimple message codec, one message\n")
    for name, cost_s in costs.items():
        print(f"{name:30}{cost_s * 1e6:9.2f} µs {cost_s / base_s:6.2f}x")
    print(f"\n(x: times {next(iter(costs))})")


if __name__ == "__main__":
    main()
