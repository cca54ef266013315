"""Controller of the simulated arm and its datagrams, in virtual time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from cardan.errors import ConfigurationError, ScriptError
from cardan.protocols.joint_stream.codec import (
    ArmCommand,
    ControlMode,
    MalformedDatagram,
    decode_state,
    encode_command,
)
from cardan.sim_peers.arm.controller import SimulatedArm
from cardan.sim_peers.arm.faults import FAULTS
from cardan.sim_peers.arm.options import PlantOptions, SimulatedArmOptions
from cardan.sim_peers.base import parse_faults

PERIOD_S = 0.002
START = tuple(map(math.radians, (0.0, 40.0, 0.0, 0.0, 30.0, 0.0)))
SPEED = (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)


class Client:
    """Commands an arm cycle by cycle and records its messages."""

    def __init__(self, faults=(), drive="dynamic", **options):
        self.arm = SimulatedArm(
            SimulatedArmOptions(
                robot="gofa_crb15000_5",
                plant=PlantOptions(drive=drive, start=START),
                faults=parse_faults(faults, FAULTS),
                **options,
            )
        )
        self.cycle = 0
        self.sequence = 0
        self.states = []
        self.junk = 0
        self.send(ControlMode.HOLD, session=0)

    @property
    def now_s(self):
        return self.cycle * PERIOD_S

    @property
    def state(self):
        return self.states[-1]

    def send(self, mode, values=(), feed_forward=(), session=None, sequence=None, **receive):
        self.sequence = self.sequence + 1 if sequence is None else sequence
        session = self.arm.session if session is None else session
        command = ArmCommand(session, self.sequence, 0.0, mode, values, feed_forward)
        data = encode_command(command, len(values) or 6)
        self.arm.receive(data, self.now_s, **receive)

    def run(self, seconds, mode=None, values=()):
        """Command each cycle of that time (nothing if `mode` is None); return the received
        states."""
        first = len(self.states)
        for _ in range(round(seconds / PERIOD_S)):
            if mode is not None:
                self.send(mode, values)
            self.cycle += 1
            for data in self.arm.cycle(self.now_s):
                state = decode_state(data)
                if isinstance(state, MalformedDatagram):
                    self.junk += 1
                else:
                    self.states.append(state)
        return self.states[first:]


def test_nobody_is_sent_anything_before_a_command():
    arm = SimulatedArm(SimulatedArmOptions(robot="gofa_crb15000_5"))
    assert all(not arm.cycle(k * PERIOD_S) for k in range(10))
    arm.receive(b"hello", 0.02)
    assert arm.client is None
    assert arm.counters.ignored == {"5 bytes are too short": 1}


def test_each_cycle_gives_a_state():
    client = Client()
    states = client.run(0.1, ControlMode.HOLD)
    assert [state.sequence for state in states] == list(range(1, 51))
    assert states[-1].stamp_s == pytest.approx(0.1)
    assert states[-1].positions == pytest.approx(START, abs=1e-6)
    assert states[-1].acknowledged == client.sequence
    assert np.linalg.norm(states[-1].pose[3:]) == pytest.approx(1.0)


def test_commands_move_the_arm_in_every_mode():
    client = Client()
    client.run(0.5, ControlMode.VELOCITY, SPEED)
    assert client.state.mode is ControlMode.VELOCITY
    assert client.state.positions[0] > 0.08
    client.run(1.0, ControlMode.POSITION, START)
    assert client.state.positions[0] == pytest.approx(0.0, abs=1e-3)
    client.run(0.1, ControlMode.TORQUE, (0.0,) * 6)
    assert client.state.mode is ControlMode.TORQUE
    assert client.state.torques == (0.0,) * 6
    assert client.state.positions[1] > START[1]


@pytest.mark.parametrize(
    ("mode", "drive"),
    [
        (ControlMode.VELOCITY, "dynamic"),
        (ControlMode.TORQUE, "dynamic"),
        (ControlMode.VELOCITY, "ideal"),
    ],
)
def test_when_commands_stop_the_arm_brakes_and_holds(mode, drive):
    client = Client(drive=drive)
    values = SPEED if mode is ControlMode.VELOCITY else (0.0,) * 6
    client.run(0.2, mode, values)
    moved = client.run(0.5)
    assert moved[20].mode is mode
    assert moved[-1].mode is ControlMode.HOLD
    assert np.abs(moved[-1].velocities).max() < 5e-3
    assert client.arm.counters.timeouts == 1
    # A new command acts again.
    client.send(mode, values)
    assert client.run(0.01)[-1].mode is mode


def test_a_client_that_falls_silent_is_forgotten_and_another_may_come():
    client = Client()
    client.send(ControlMode.HOLD, source="another")
    assert client.arm.counters.ignored == {"another client": 1}
    client.run(1.5)
    assert client.arm.client is None
    client.send(ControlMode.HOLD, session=0, sequence=1, source="another")
    assert client.arm.client == "another"
    assert client.run(0.01)


def test_late_double_and_foreign_commands_change_nothing():
    client = Client()
    client.run(0.1, ControlMode.HOLD)
    for sequence in (client.sequence, client.sequence - 5):
        client.send(ControlMode.VELOCITY, SPEED, sequence=sequence)
    client.sequence += 100
    client.send(ControlMode.VELOCITY, SPEED, session=99)
    assert client.run(0.01)[-1].mode is ControlMode.HOLD
    assert client.arm.counters.ignored == {"late or double": 2, "another session": 1}


@pytest.mark.parametrize(
    ("mode", "values", "reason"),
    [
        (ControlMode.POSITION, (9.0, 0.0, 0.0, 0.0, 0.0, 0.0), "is outside its range"),
        (ControlMode.VELOCITY, (0.0, 0.0, 99.0, 0.0, 0.0, 0.0), "is beyond its speed"),
        (ControlMode.VELOCITY, (0.0, 0.0), "command for 2 joints; the arm has 6"),
    ],
)
def test_what_it_cannot_do_is_refused_with_a_reason(mode, values, reason):
    client = Client()
    client.run(0.1, ControlMode.HOLD)
    client.send(mode, values)
    state = client.run(0.01)[-1]
    assert reason in state.reason
    assert state.mode is ControlMode.HOLD
    assert client.run(0.01, ControlMode.HOLD)[-1].reason == ""


def test_ideal_drives_refuse_torque():
    client = Client(drive="ideal")
    client.send(ControlMode.TORQUE, (0.0,) * 6)
    assert client.run(0.01)[-1].reason == "ideal drives have no torque mode"


def test_the_same_calls_give_the_same_datagrams():
    def play():
        client = Client(["noise-deg", "drop", "jitter", "garbage"], seed=3)
        client.run(0.5, ControlMode.VELOCITY, SPEED)
        return client.states, client.junk

    assert play() == play()


# -- faults -------------------------------------------------------------------------------------


def test_every_fault_is_tested():
    tested = {name.removeprefix("test_fault_") for name in globals() if "test_fault_" in name}
    tested |= {"reorder", "jitter"}  # tests/sim_peers/test_link.py
    assert {fault.name.replace("-", "_") for fault in FAULTS} <= tested


def test_fault_drop():
    client = Client(["drop=0.3"])
    assert 100 < len(client.run(0.4, ControlMode.HOLD)) < 180
    assert client.arm.counters.taken < 180


def test_fault_duplicate():
    client = Client(["duplicate=1"])
    client.run(0.1, ControlMode.HOLD)
    assert len(client.states) == 100
    assert client.arm.counters.ignored["late or double"] > 40


def test_fault_delay():
    client = Client(["delay=20"])
    assert client.run(0.02, ControlMode.HOLD) == []
    client.run(0.1, ControlMode.VELOCITY, SPEED)
    assert client.now_s - client.state.stamp_s == pytest.approx(0.02, abs=0.0021)
    first = next(s for s in client.states if s.mode is ControlMode.VELOCITY)
    assert first.stamp_s == pytest.approx(0.04, abs=0.0021)


def test_fault_garbage():
    client = Client(["garbage=0.5"])
    client.run(0.2, ControlMode.HOLD)
    assert client.junk > 20
    assert len(client.states) == 100


def test_fault_silence():
    client = Client(["silence=0.3"])
    stamps = [state.stamp_s for state in client.run(6.0, ControlMode.HOLD)]
    assert max(np.diff(stamps)) == pytest.approx(0.3, abs=0.004)


def test_fault_restart():
    client = Client(["restart=0.5"])
    client.run(0.498, ControlMode.VELOCITY, SPEED)
    assert client.run(1.0, ControlMode.VELOCITY, SPEED) == []
    before = client.arm.plant.positions
    assert client.arm.session == 1
    client.run(0.02)
    assert client.arm.session == 2
    client.send(ControlMode.VELOCITY, SPEED, session=1)  # for the previous session
    client.send(ControlMode.HOLD, session=0)
    state = client.run(0.01)[-1]
    assert (state.session, state.mode) == (2, ControlMode.HOLD)
    assert client.arm.plant.positions == pytest.approx(before, abs=1e-4)
    assert client.run(0.1, ControlMode.VELOCITY, SPEED)[-1].mode is ControlMode.VELOCITY


def test_fault_estop():
    client = Client(["estop=0.5"])
    client.run(0.498, ControlMode.VELOCITY, SPEED)
    state = client.run(0.5, ControlMode.VELOCITY, SPEED)[-1]
    assert state.reason == "emergency stop"
    assert np.abs(state.velocities).max() < 1e-3
    assert client.run(2.0, ControlMode.VELOCITY, SPEED)[-1].reason == ""
    assert client.state.velocities[0] == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("drive", ["dynamic", "ideal"])
def test_fault_offset_deg(drive):
    def rest(faults):
        client = Client(faults, drive=drive)
        assert client.run(0.1, ControlMode.HOLD)[-1].positions == pytest.approx(START, abs=1e-6)
        return np.degrees(client.run(1.0, ControlMode.POSITION, START)[-1].positions)

    assert rest(["offset-deg=1"]) - rest([]) == pytest.approx([1.0] * 6, abs=0.02)


def test_fault_jam():
    client = Client(["jam=1"])
    client.run(1.998, ControlMode.VELOCITY, SPEED)
    jammed_at = client.run(0.01, ControlMode.VELOCITY, SPEED)[-1].positions[0]
    state = client.run(1.5, ControlMode.VELOCITY, SPEED)[-1]
    assert state.positions[0] == pytest.approx(jammed_at, abs=2e-3)
    assert "joint" in state.reason
    assert "did not follow" in state.reason
    with pytest.raises(ConfigurationError, match="7 is not a joint"):
        Client(["jam=7"])


def test_fault_slow():
    client = Client(["slow=0.2"])
    client.run(1.0, ControlMode.VELOCITY, SPEED)
    assert client.state.velocities[0] == pytest.approx(0.04, abs=0.002)


def test_fault_noise_deg():
    client = Client(["noise-deg=0.1"])
    measured = np.degrees([state.positions[0] for state in client.run(1.0, ControlMode.HOLD)])
    assert np.std(measured) == pytest.approx(0.1, rel=0.2)


def test_bad_options_name_the_key():
    for options, key in (
        ({"port": 70000}, "port"),
        ({"period_s": 1.0}, "period_s"),
        ({"command_timeout_s": 0.0}, "command_timeout_s"),
    ):
        with pytest.raises(ConfigurationError) as raised:
            SimulatedArmOptions(robot="gofa_crb15000_5", **options)
        assert raised.value.key == key
    with pytest.raises(ScriptError, match="there is no fault 'nosuch'"):
        SimulatedArmOptions(robot="gofa_crb15000_5", faults={"nosuch": 1.0})
