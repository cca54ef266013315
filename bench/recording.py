"""Cost of recording in a session's loop: `python -m bench recording`.

A session of a simulated UR5 at 250 Hz on the bus, with and without `cardan net record` (a separate
process), in turns within one run.
"""

from __future__ import annotations

import os
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from typing import Any, ClassVar

from cardan.common.realtime import ask_for_real_time
from cardan.drivers import registry
from cardan.drivers.sim_arm import SimArm
from cardan.gateway.session.config import parse_config
from cardan.gateway.session.session import make_session
from cardan.types import RobotCommand, RobotState

TURN_S, TURNS = 6.0, 4
SETTLE_S = 6.0
"""Wait before the first turn: a new session keeps cycles for recorders that are discovered late."""

OFF, ON = "not recorded", "recorded"


class _Timed(SimArm):
    """Recorder of the duration of each cycle of a session's loop."""

    rows: ClassVar[list[tuple[bool, float, float]]] = []
    """Per cycle: True if recorded; time until the answer; time of the whole cycle, s."""

    def cycles(self) -> Any:
        return self._timed()

    def _timed(self) -> Iterator[RobotState]:
        for state in super().cycles():
            self._began_s = self._answered_s = time.perf_counter()
            tapped = self.raw_packet_callback is not None
            yield state
            ended_s = time.perf_counter()
            if tapped is (self.raw_packet_callback is not None):
                self.rows.append(
                    (tapped, self._answered_s - self._began_s, ended_s - self._began_s)
                )

    def send(self, command: RobotCommand) -> None:
        super().send(command)
        self._answered_s = time.perf_counter()


def _free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def main() -> None:
    """Measure and print."""
    registry.BUILT_IN["timed_arm"] = f"{__name__}:_Timed"
    endpoint = _free_endpoint()
    session = make_session(
        parse_config(
            {
                "robot": {"driver": "timed_arm", "robot": "ur5", "period_s": 0.004},
                "arm": {"model": "ur5"},
                "network": {"router": "", "listen": [endpoint]},
            }
        )
    )

    def take_turns() -> None:
        time.sleep(SETTLE_S)
        with tempfile.TemporaryDirectory() as folder:
            file = os.path.join(folder, "session.toml")
            with open(file, "w", encoding="utf-8") as written:
                written.write("""[robot]\ndriver = "sim_arm"\n[arm]\nmodel = "ur5"\n""")
                written.write(f'''[network]\nrouter = "{endpoint}"\n''')
            for turn in range(TURNS):
                if turn % 2 == 0:
                    time.sleep(TURN_S)
                    continue
                path = os.path.join(folder, f"{turn}.mcap")
                words = ["net", "record", "-o", path, "--session", file, "--seconds", str(TURN_S)]
                command = [sys.executable, "-m", "cardan", *words]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                print(done.stdout.splitlines()[1:])
        session.stop("measured")

    thread = threading.Thread(target=take_turns)
    thread.start()
    print(f"scheduling: {ask_for_real_time()}")
    session.run()
    thread.join()
    rows = _Timed.rows[round(SETTLE_S / 0.004) :]
    medians = {}
    for name, tapped in ((OFF, False), (ON, True)):
        answers = sorted(1e6 * row[1] for row in rows if row[0] is tapped)
        wholes = sorted(1e6 * row[2] for row in rows if row[0] is tapped)
        figures = [
            f"{what} p50 {statistics.median(values):.0f}, p99 {values[len(values) * 99 // 100]:.0f}"
            for what, values in (("answer", answers), ("whole cycle", wholes))
        ]
        medians[name] = statistics.median(answers), statistics.median(wholes)
        print(f"{name}: {len(answers)} cycles, µs: {'; '.join(figures)}")
    off, on = medians[OFF], medians[ON]
    print(
        f"recorded over not: answer {on[0] / off[0]:.2f}, whole cycle {on[1] / off[1]:.2f} "
        f"(+{on[1] - off[1]:.0f} µs, {(on[1] - off[1]) / 40.0:.1f} % of the period)"
    )


if __name__ == "__main__":
    main()
