"""The simulated JR3 board in virtual time: the real board's behavior, and faults."""

import itertools
import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.errors import ScriptError
from cardan.sim_peers.base import load_script, parse_script
from cardan.sim_peers.scripted import play
from cardan_jr3 import protocol as jr3
from cardan_jr3.peer import SCRIPT_VERBS, SCRIPTS, ScriptedJr3, SimulatedJr3
from tests.examples import examples

NODE = 33
SCALES = jr3.TEO_SENSORS["right-hand"]


class Host:
    """Client of the board that records the times of its messages."""

    def __init__(self, **options):
        options.setdefault("boot_s", 0.0)
        self.board = SimulatedJr3(NODE, SCALES, **options)
        self.now_s = 0.0
        self.heard = []

    def ask(self, message, now_s=None):
        frame = jr3.encode_from_host(message, NODE)
        self.board.receive(*frame, self.now_s if now_s is None else now_s)

    def run(self, seconds, step_s=0.0005):
        """Return the messages of this time: (time, message)."""
        self.heard = []
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s += step_s
            for frame in self.board.reports(self.now_s):
                self.heard.append((self.now_s, jr3.decode_from_board(*frame)))
        return self.heard

    def answers(self, message):
        self.ask(message)
        return [m for _, m in self.run(0.005) if isinstance(m, jr3.Ack)]

    def samples(self, seconds):
        messages = [m for _, m in self.run(seconds)]
        forces = [m for m in messages if isinstance(m, jr3.Forces)]
        moments = [m for m in messages if isinstance(m, jr3.Moments)]
        return forces, moments


def started(period_us=5000, cutoff_centihz=0, **options):
    host = Host(**options)
    host.run(0.01)
    host.ask(jr3.StartAsync(cutoff_centihz, period_us))
    host.run(0.01)
    return host


def test_it_reports_its_boot_and_is_not_ready_before():
    host = Host(boot_s=2.0)
    assert host.answers(jr3.GetState()) == [jr3.Ack(1)]
    assert host.answers(jr3.StartAsync(0, 1000)) == [jr3.Ack(1)]
    (scales,) = host.answers(jr3.GetFsForces())
    assert scales.state == 1
    assert len(scales.full_scales) == 3
    boots = [(t, m) for t, m in host.run(2.0) if isinstance(m, jr3.Bootup)]
    assert [t for t, _ in boots] == [pytest.approx(2.0, abs=1e-3)]
    assert host.samples(0.1) == ([], [])  # The start command was ignored.
    assert host.answers(jr3.GetState()) == [jr3.Ack(0)]


def test_full_scales_are_given():
    host = Host()
    host.run(0.01)
    assert host.answers(jr3.GetFsForces()) == [jr3.Ack(0, (115, 111, 185))]
    assert host.answers(jr3.GetFsMoments()) == [jr3.Ack(0, (56, 52, 61))]


def test_without_a_sensor_it_never_boots():
    host = Host(faults={"no-sensor": 1.0})
    assert host.run(5.0) == []
    assert host.answers(jr3.GetState()) == [jr3.Ack(1)]


def test_answers_take_up_to_two_milliseconds():
    delays = []
    host = Host()
    host.run(0.01)
    for _ in range(200):
        host.ask(jr3.GetState())
        asked_s = host.now_s
        delays += [t - asked_s for t, _ in host.run(0.004, 0.0001)]
    assert len(delays) == 200
    assert 0.0 <= min(delays) < 0.0005
    assert 0.001 < max(delays) <= 0.0021


def test_it_sends_by_its_own_clock():
    host = started(period_us=10_000)
    times = [t for t, m in host.run(1.0, 0.0001) if isinstance(m, jr3.Forces)]
    assert len(times) == 100
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert all(gap == pytest.approx(0.01, abs=2e-4) for gap in gaps)


def test_the_counter_counts_samples_and_wraps():
    host = started(period_us=1000, faults={"counter": 65000.0})
    forces, moments = host.samples(1.0)
    if forces[0].counter != moments[0].counter:  # Acquisition began within a pair.
        forces, moments = forces[:-1], moments[1:]
    assert [m.counter for m in moments] == [f.counter for f in forces]
    steps = [jr3.samples_between(b.counter, a.counter) for a, b in itertools.pairwise(forces)]
    assert set(steps) <= {7, 8}
    assert sum(steps) / (len(steps) * 1e-3) == pytest.approx(1 / jr3.SAMPLE_PERIOD_S, rel=0.002)
    assert min(f.counter for f in forces) < 100 < 65500 < max(f.counter for f in forces)


def test_sync_is_a_flag():
    host = Host()
    host.run(0.01)
    host.ask(jr3.StartSync(0))
    host.run(0.01)
    assert host.samples(0.1) == ([], [])
    host.ask(jr3.Sync())
    assert len(host.samples(0.01)[0]) == 1
    host.ask(jr3.Sync())
    host.ask(jr3.Sync())  # before the loop looks
    assert len(host.samples(0.01)[0]) == 1


def test_sync_while_stopped_is_ignored():
    host = Host()
    host.run(0.01)
    host.ask(jr3.Sync())
    assert host.samples(0.01) == ([], [])


def test_the_filter_is_of_first_order():
    host = started(period_us=1000, cutoff_centihz=200)
    host.board.set_wrench((100, 0, 0, 0, 0, 0))
    forces, _ = host.samples(1.0 / (2 * math.pi * 2.0))
    full = 100 * 16384 / 115
    assert forces[-1].x == pytest.approx(full * (1 - math.exp(-1)), rel=0.02)
    host.ask(jr3.SetFilter(0))
    assert host.samples(0.01)[0][-1].x == pytest.approx(full, abs=1)


def test_noise_passes_the_filter_as_it_should():
    host = started(period_us=2000, cutoff_centihz=0, noise_n=0.5, seed=1)
    raw = [f.x for f in host.samples(2.0)[0]]
    host.ask(jr3.SetFilter(1000))
    host.run(0.5)
    filtered = [f.x for f in host.samples(4.0)[0]]
    spread = lambda values: math.sqrt(sum(v * v for v in values) / len(values))  # noqa: E731
    assert spread(raw) * 115 / 16384 == pytest.approx(0.5, rel=0.1)
    alpha = jr3.SAMPLE_PERIOD_S / (jr3.SAMPLE_PERIOD_S + 1 / (2 * math.pi * 10))
    assert spread(filtered) / spread(raw) == pytest.approx(math.sqrt(alpha / (2 - alpha)), rel=0.25)


def test_zero_takes_the_filtered_value_and_a_sample_of_zeros_follows():
    host = started(offset=(4, -3, -8, 0.2, -0.1, 0.05))
    before = host.samples(0.02)[0][-1]
    assert before.x == pytest.approx(4 * 16384 / 115, abs=1)
    host.board.set_wrench((10, 0, 0, 0, 0, 0))
    host.run(0.002)
    host.ask(jr3.ZeroOffs())
    forces, _ = host.samples(0.003)
    host.board.set_wrench((30, 0, 0, 0, 0, 0))
    forces += host.samples(0.05)[0]
    zeros = [f for f in forces if f[:3] == (0, 0, 0)]
    assert len(zeros) == 1
    assert forces[-1].x == pytest.approx(20 * 16384 / 115, abs=1)


def test_stop_resets_the_counter():
    host = started()
    host.samples(0.5)
    assert host.answers(jr3.Stop()) == [jr3.Ack(0)]
    assert host.samples(0.1) == ([], [])
    host.ask(jr3.StartAsync(0, 5000))
    assert host.samples(0.02)[0][0].counter < 60


def test_reset_reads_the_calibration_and_blocks_meanwhile():
    host = Host()
    host.run(0.01)
    host.ask(jr3.Reset())
    host.run(0.005)
    host.ask(jr3.GetState())
    assert host.run(0.2) == []
    assert [m for _, m in host.run(0.2)] == [jr3.Ack(0), jr3.Ack(0)]
    host.board.unplug_sensor()
    host.ask(jr3.Reset())
    host.run(0.005)
    host.ask(jr3.GetState())
    assert host.run(2.0) == []


def test_the_gripper_is_not_acknowledged():
    host = Host()
    host.run(0.01)
    for percent, shown in ((40.0, 40.0), (1e9, 100.0), (math.nan, 100.0), (-150.0, -100.0)):
        assert host.answers(jr3.GripperPwm(percent)) == []
        assert host.board.gripper_percent == shown


def test_its_queue_holds_32_commands():
    host = Host()
    host.run(0.01)
    for _ in range(40):
        host.ask(jr3.GetState())
    assert len(host.run(0.01)) == 32
    assert host.board.dropped == 8


def test_other_nodes_are_not_its_concern():
    host = Host()
    host.run(0.01)
    host.board.receive(0x422, b"", host.now_s)
    host.board.receive(0x7E1 & 0x780 | 34, b"", host.now_s)
    assert host.run(0.01) == []
    host.board.receive(0x021, b"", host.now_s)  # an unknown opcode
    assert host.run(0.01) == []
    assert host.board.ignored == 1


def test_a_sensor_that_is_unplugged_leaves_the_last_sample():
    host = started()
    host.samples(0.1)
    host.board.unplug_sensor()
    forces, _ = host.samples(0.1)
    assert len({f.counter for f in forces[1:]}) == 1
    assert len(forces) == 20


def test_overload_shows_more_than_full_scale_until_sixteen_bits_end():
    host = started()
    host.board.set_wrench((150, -1000, 0, 0, 0, 7))
    forces, moments = host.samples(0.02)
    assert forces[-1].x == pytest.approx(150 * 16384 / 115, abs=1)
    assert forces[-1].y == -32768
    assert moments[-1].z > 16384


def test_a_late_peer_makes_no_burst():
    host = started(period_us=1000)
    host.board.skip_to(host.now_s + 0.5)
    host.now_s += 0.5
    assert 1 <= len(host.samples(0.002)[0]) <= 3


@pytest.mark.parametrize(
    ("fault", "value"),
    [("silence", 0.2), ("power-cycle", 0.2), ("stopped", 0.2)],
)
def test_faults_count_from_the_start(fault, value):
    host = started(faults={fault: value})
    host.samples(0.15)
    assert host.heard
    host.run(0.06)
    assert not [m for _, m in host.run(0.4) if isinstance(m, jr3.Forces)]


def test_power_comes_back_with_a_boot():
    host = started(faults={"power-cycle": 0.1})
    boots = [t for t, m in host.run(1.0) if isinstance(m, jr3.Bootup)]
    assert boots == [pytest.approx(0.11 + 0.5, abs=0.01)]


def test_lost_and_mangled_frames():
    host = started(
        period_us=1000,
        faults={"lost-moments": 4.0, "short-frame": 5.0, "duplicate": 10.0, "unknown-frame": 7.0},
    )
    messages = [m for _, m in host.run(2.0)]
    kinds = [type(m) for m in messages]
    pairs = 2000
    assert kinds.count(jr3.Moments) == pytest.approx(pairs * (1 - 1 / 4 + 1 / 10), rel=0.02)
    assert kinds.count(jr3.Malformed) == pytest.approx(pairs * (1 / 5 + 1 / 7), rel=0.02)


def test_loss_is_a_share():
    host = started(period_us=1000, faults={"lost": 0.3}, seed=5)
    assert len(host.run(2.0)) == pytest.approx(4000 * 0.7, rel=0.05)


@settings(max_examples=examples(40))
@given(st.lists(st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8)), max_size=30))
def test_nothing_on_the_bus_breaks_it(frames):
    host = Host()
    host.run(0.005)
    for arbitration_id, data in frames:
        host.board.receive(arbitration_id, data, host.now_s)
        host.run(0.001)
    host.board.power_off()
    host.board.power_on()
    assert [m for _, m in host.run(0.01)] == [jr3.Bootup()]


# -- scripts ---------------------------------------------------------------------------------------


def hand(text):
    return ScriptedJr3(parse_script(text, SCRIPT_VERBS))


def test_a_script_begins_when_the_board_is_started():
    board = SimulatedJr3(NODE, SCALES, boot_s=0.0)
    script = hand("0.5 wrench 10 0 0 0 0 0 over 0.2\n1 swing 0 4 0 0 0 0 over 1\n3 release over 1")
    board.on_first_start = script.start
    play(board, script, 2.0)
    board.receive(*jr3.encode_from_host(jr3.StartAsync(0, 1000), NODE), 2.0)
    loads = {}
    for tick in range(2001, 6500):
        play(board, script, tick * 1e-3)
        loads[tick] = board.wrench
    assert loads[2400] == (0,) * 6
    assert loads[2600][0] == pytest.approx(5, abs=0.3)
    assert loads[2800][0] == 10
    assert loads[3250][:2] == pytest.approx((10, 4), abs=0.1)
    assert loads[4100][:2] == (10, 0)
    assert loads[5500][0] == pytest.approx(5, abs=0.3)
    assert loads[6400] == (0,) * 6


@pytest.mark.parametrize("name", SCRIPTS)
def test_built_in_scripts_leave_two_seconds_for_zeroing(name):
    board = SimulatedJr3(NODE, SCALES, boot_s=0.0)
    script = ScriptedJr3(load_script(name, SCRIPTS, SCRIPT_VERBS))
    board.on_first_start = script.start
    board.receive(*jr3.encode_from_host(jr3.StartSync(0), NODE), 0.0)
    moved = False
    for tick in range(1, 20_000, 5):
        play(board, script, tick * 1e-3)
        assert not any(board.wrench) or tick > 2500
        moved = moved or any(board.wrench)
    assert moved is (name != "rest")


def test_acts_of_a_script():
    board = SimulatedJr3(NODE, SCALES, boot_s=0.0)
    script = hand("0.1 overload MZ\n0.2 sensor-unplug\n0.3 silence\n0.4 resume\n0.5 power-off")
    board.on_first_start = script.start
    board.receive(*jr3.encode_from_host(jr3.StartAsync(0, 1000), NODE), 0.0)
    play(board, script, 0.15)
    assert board.wrench == (0, 0, 0, 0, 0, pytest.approx(1.5 * 6.1))
    play(board, script, 0.25)
    assert not board.sensor_plugged
    play(board, script, 0.35)
    assert board.hung
    play(board, script, 0.45)
    assert not board.hung
    play(board, script, 0.55)
    assert not board.powered


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("1 wrench 1 2 3", "MX is missing"),
        ("1 wrench 1 2 3 4 5 x", "must be a number"),
        ("1 wrench 1 2 3 4 5 6 7", "too much"),
        ("1 swing 1 2 3 4 5 6", "'over' is missing"),
        ("1 swing 1 2 3 4 5 6 over 0", "from 0.002"),
        ("1 overload ff", "not a component"),
        ("1 release over -1", "from 0"),
        ("1 power-off now", "too much"),
        ("0 loop", "after 0 s"),
        ("1 loop\n2 release", "last step"),
        ("1 jump", "after the time comes"),
    ],
)
def test_wrong_scripts_are_named(line, words):
    with pytest.raises(ScriptError, match=words):
        hand(line)


def test_wrong_faults_and_loads_are_named():
    with pytest.raises(ScriptError, match="no fault"):
        SimulatedJr3(NODE, SCALES, faults={"nosuch": 1.0})
    with pytest.raises(ScriptError, match="not in 0 to 1"):
        SimulatedJr3(NODE, SCALES, faults={"lost": 2.0})
    with pytest.raises(ValueError, match="six finite"):
        SimulatedJr3(NODE, SCALES).set_wrench((math.nan,) * 6)


# -- what the bus carries ----------------------------------------------------------------------


def bits(frames):
    """Return the length on the bus, with the maximum number of stuff bits."""
    sizes = [len(frame.data) for frame in frames]
    return sum(47 + 8 * size + (33 + 8 * size) // 4 for size in sizes)


@pytest.mark.parametrize("faults", [{}, {"duplicate": 1.0}, {"duplicate": 1.0, "unknown-frame": 1}])
@pytest.mark.parametrize("payload", [b"", b"\0\0", bytes(6), bytes((0, 0, 1, 0, 0, 0))])
def test_no_period_floods_the_bus(payload, faults):
    board = SimulatedJr3(NODE, SCALES, boot_s=0.0, faults=faults)
    board.reports(0.001)
    board.receive(jr3.Opcode.START_ASYNC + NODE, payload, 0.001)
    board.reports(1.0)
    frames = [frame for tick in range(100) for frame in board.reports(1.01 + 0.01 * tick)]
    assert 0.9e6 < bits(frames) <= 1e6
    counters = [m.counter for f in frames if isinstance(m := jr3.decode_from_board(*f), jr3.Forces)]
    steps = [jr3.samples_between(b, a) for a, b in itertools.pairwise(counters)]
    assert sum(steps) == pytest.approx(1.0 / jr3.SAMPLE_PERIOD_S, rel=0.01)  # No backlog grows.


def test_no_number_of_requests_floods_the_bus():
    board = SimulatedJr3(NODE, SCALES, boot_s=0.0)
    board.reports(0.001)
    frames = []
    for tick in range(1000):
        for _ in range(100):
            board.receive(*jr3.encode_from_host(jr3.GetState(), NODE), 0.001 * (tick + 1))
        frames += board.reports(0.001 * (tick + 2))
    assert 0.9e6 < bits(frames) <= 1e6
    assert board.dropped + board.unsent + len(frames) > 90_000


def test_a_late_acknowledgment_does_not_hold_up_the_samples():
    host = started(period_us=1000, faults={"late-ack": 300.0})
    host.ask(jr3.GetState())
    forces, moments = host.samples(0.2)
    assert len(forces) == len(moments) == 200
