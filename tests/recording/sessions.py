"""Sessions in virtual time: a simulated SpaceMouse drives a simulated UR5, and the loop's data
become a record equal to that of a recorder on the bus."""

from __future__ import annotations

import contextlib
import json
import threading
from pathlib import Path

from cardan.drivers.sim_arm import SimArm
from cardan.drivers.spacemouse import SpaceMouseOptions
from cardan.drivers.spacemouse.core import SpaceMouseCore
from cardan.gateway.arm.controller import ArmController
from cardan.gateway.arm.cycle_record import RecordedRequest, encode_cycle
from cardan.gateway.arm.loop import ArmLoop
from cardan.gateway.session.assembly import make_controller, make_robot
from cardan.gateway.session.config import SessionConfig, parse_config
from cardan.gateway.session.session import make_session
from cardan.protocols.connexion.devices import model_by_key
from cardan.protocols.ros2.cdr import codec_of
from cardan.protocols.ros2.type_hash import type_hash
from cardan.recording.mcap_file import RecordedMessage, RecordedTopic, RecordWriter
from cardan.sim_peers.base import parse_script
from cardan.sim_peers.scripted import play
from cardan.sim_peers.spacemouse.core import SimulatedSpaceMouse
from cardan.sim_peers.spacemouse.motion_script import SCRIPT_VERBS, ScriptedPuck
from tests.serving import PATIENT
from tests.waiting import WITHIN_S, until

NODE = "/cartesian_control_server_ros2"
STRING = "std_msgs/msg/String"
NS = 10**9

TABLES = {
    "device": {"driver": "spacemouse"},
    "robot": {"driver": "sim_arm", "robot": "ur5", "pacing": "virtual", "period_s": 0.004},
    "arm": {"model": "ur5"},
    "mapping": {"deadman": "left"},
}

HAND = """
0.1 axes 0.3 0 0 0 0 0
0.2 neutral
0.4 press left
0.5 axes -0.4 0.3 0.2 0 0.3 -0.2 over 0.1
1.6 axes 0.1 -0.7 -0.3 0.4 0 0.1 over 0.2
2.4 neutral
2.6 release left
"""
"""Touch, release, hold the dead-man, move, release."""


class Puck:
    """Simulated SpaceMouse and its driver, in the time of `clock`."""

    def __init__(self, clock, hand: str = HAND) -> None:
        model = model_by_key("spacenavigator")
        self._clock = clock
        self._puck = SimulatedSpaceMouse(model, jitter_lsb=1, seed=1)
        self._hand = ScriptedPuck(parse_script(hand, SCRIPT_VERBS), model)
        self._core = SpaceMouseCore(SpaceMouseOptions(), model)
        self._core.on_opened(0.0, model)

    def state(self):
        now_s = self._clock()
        for report in play(self._puck, self._hand, now_s):
            self._core.on_report(report, now_s)
        return self._core.state(now_s)

    def button_events(self):
        return self._core.events()


class Recorded:
    """Session of `seconds`; `during` gets the number of each cycle and the controller, and may
    command it."""

    def __init__(self, tables=TABLES, seconds: float = 3.2, during=None, hand: str = HAND) -> None:
        self.tables = tables
        self.config: SessionConfig = parse_config(tables)
        robot = make_robot(self.config)
        assert isinstance(robot, SimArm)
        controller: ArmController = make_controller(self.config, robot)
        requests: list[tuple[int, RecordedRequest]] = []
        controller.recorder = lambda ticks, name, argument: requests.append(
            (ticks, RecordedRequest(name, argument))
        )
        self.texts: list[str] = []
        self.stamps_s: list[float] = []
        with robot:
            puck = Puck(lambda: robot._joined().now(), hand)
            for cycle in ArmLoop(robot, controller, puck).cycles():
                number = controller.ticks
                before = [request for ticks, request in requests if ticks == number - 1]
                self.texts.append(encode_cycle(number, before, cycle))
                self.stamps_s.append(cycle.robot.stamp_s)
                if during is not None:
                    during(number, controller)
                if cycle.robot.stamp_s >= seconds:
                    break

    def write(self, path: Path) -> Path:
        """Write it as a file."""
        writer = RecordWriter(path)
        described = {"versions": {}, "tables": self.tables}
        for topic, texts in (
            ("configuration", [(0.0, json.dumps(described))]),
            ("controller_log", list(zip(self.stamps_s, self.texts, strict=True))),
        ):
            recorded = RecordedTopic(
                f"{NODE}/{topic}", STRING, type_hash(STRING), topic == "configuration", (NODE,)
            )
            for number, (stamp_s, text) in enumerate(texts, 1):
                now_ns = round(stamp_s * NS)
                data = codec_of(STRING).encode({"data": text})
                writer.add(RecordedMessage(recorded, now_ns, now_ns, number, data))
        writer.finish()
        return path


def session_file(folder: Path, endpoint: str) -> str:
    """Write a session's file that joins the bus at `endpoint`."""
    path = folder / "session.toml"
    text = f"""
[robot]
driver = "sim_arm"
[arm]
model = "ur5"
[network]
router = "{endpoint}"
"""
    path.write_text(text)
    return str(path)


@contextlib.contextmanager
def live_session(endpoint: str, **tables):
    """Run a session on the bus, with a simulated UR5 in real time and its loop in a thread. It
    connects to `endpoint`."""
    merged = {
        "robot": {"driver": "sim_arm", "robot": "ur5", "period_s": 0.004},
        "arm": {"model": "ur5"},
        "network": {"router": endpoint, "listen": ["tcp/127.0.0.1:0"]},
        "watchdogs": PATIENT,
    }
    for key, table in tables.items():
        merged[key] = {**merged.get(key, {}), **table}
    session = make_session(parse_config(merged, from_file=False))
    failed: list[BaseException] = []

    def run() -> None:
        try:
            session.run()
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        until(lambda: failed or session.snapshot.loop.cycles > 0)
        yield session
    finally:
        session.stop("enough")
        thread.join(WITHIN_S)
        assert not thread.is_alive()
        assert not failed
