"""Cost of an EGM message in a capture, measured in turns: figures alone, with lines, and decoding.

The capture is of a session at 250 Hz: a six-axis controller's datagrams and a PC's answers.
"""

from __future__ import annotations

import io
import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from bench.egm_codec import EULER, JOINTS, SEQNO, TIME_US, TM_MS, robot
from cardan.protocols.egm.decode import decode_from_pc, decode_robot
from cardan.protocols.egm.encode import encode_robot
from cardan.protocols.egm.messages import EgmHeader
from cardan.protocols.egm.replies import encode_joint_reply
from cardan_dissect import EGM_PORTS, dissect_file

CYCLES = 10_000
TURNS = 3
CONTROLLER, PC = (bytes((10, 0, 0, 1)), 50123), (bytes((10, 0, 0, 2)), EGM_PORTS[0])


def datagrams() -> list[tuple[bytes, bytes]]:
    """Return the controller's datagram and the answer for every cycle."""
    values, found = robot(EULER), []
    for cycle in range(CYCLES):
        seqno, tm_ms = SEQNO + cycle, TM_MS + 4 * cycle
        sent = encode_robot(values._replace(header=EgmHeader(seqno, tm_ms, 2)))
        found.append((sent, encode_joint_reply(seqno, tm_ms, JOINTS, JOINTS)))
    return found


def packet(time_us: int, source: tuple[bytes, int], to: tuple[bytes, int], data: bytes) -> bytes:
    """Return a datagram as a pcap record."""
    udp = struct.pack("!HHHH", source[1], to[1], 8 + len(data), 0) + data
    ip = struct.pack("!BxH4xBBxx4s4s", 0x45, 20 + len(udp), 64, 17, source[0], to[0])
    frame = bytes(12) + b"\x08\x00" + ip + udp
    return struct.pack("<4I", *divmod(time_us, 10**6), len(frame), len(frame)) + frame


def main() -> None:
    """Print the table."""
    cycles = datagrams()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "egm.pcap")
        with path.open("wb") as file:
            file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1))
            for cycle, (sent, answer) in enumerate(cycles):
                time_us = TIME_US + 4000 * cycle
                file.write(packet(time_us, CONTROLLER, PC, sent))
                file.write(packet(time_us + 500, PC, CONTROLLER, answer))

        def decode() -> None:
            for sent, answer in cycles:
                decode_robot(sent)
                decode_from_pc(answer)

        calls: dict[str, Callable[[], object]] = {
            "decoders alone": decode,
            "cardan dissect --summary": lambda: dissect_file(path, io.StringIO(), summary=True),
            "cardan dissect": lambda: dissect_file(path, io.StringIO()),
        }
        costs = dict.fromkeys(calls, float("inf"))
        for _ in range(TURNS):
            for name, call in calls.items():
                start_s = time.process_time()
                call()
                cost_s = (time.process_time() - start_s) / (2 * CYCLES)
                costs[name] = min(costs[name], cost_s)
    base_s = costs["decoders alone"]
    print("\nEGM in a capture, one message\n")
    for name, cost_s in costs.items():
        print(f"{name:28}{cost_s * 1e6:9.2f} µs {cost_s / base_s:6.2f}x")


if __name__ == "__main__":
    main()
