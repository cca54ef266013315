"""The JR3 driver's core against the simulated board, in virtual time."""

import math

import pytest
from hypothesis import given, settings, strategies as st

from cardan.errors import CommandError
from cardan.types import DeviceLink, Frame
from cardan_jr3.driver import Jr3Core, Jr3Options
from cardan_jr3.protocol import Ack, Forces, Moments, Opcode, encode_from_board
from jr3_bench import NODE_ID, STEP_S, Bench
from tests.examples import examples

OFFSET = (4.2, -3.1, -8.6, 0.21, -0.13, 0.05)
REST = (0.0,) * 6


def opcodes(bench):
    return [frame.arbitration_id & ~0x7F for frame in bench.sent]


# -- start-up --------------------------------------------------------------------------------------


def test_it_is_brought_up_one_request_at_a_time():
    bench = Bench(offset=OFFSET)
    state = bench.live()
    assert opcodes(bench) == [
        Opcode.GET_STATE,
        Opcode.START_ASYNC,
        Opcode.GET_FS_FORCES,
        Opcode.GET_FS_MOMENTS,
        Opcode.ZERO_OFFS,
    ]
    assert bench.sent[1].data == bytes.fromhex("e803 10270000")  # 10 Hz, 10 ms
    assert state.link is DeviceLink.LIVE
    assert 0.0 <= bench.now_s - state.stamp_s <= 0.1
    assert state.reason == ""
    assert state.wrench.force == pytest.approx((0, 0, 0), abs=0.01)
    assert state.wrench.frame is Frame.TOOL


def test_full_scales_that_are_given_are_not_asked_for():
    options = Jr3Options(force_full_scales_n=(115, 111, 185), torque_full_scales_nm=(5.6, 5.2, 6.1))
    bench = Bench(options)
    assert bench.live().link is DeviceLink.LIVE
    assert opcodes(bench) == [Opcode.GET_STATE, Opcode.START_ASYNC, Opcode.ZERO_OFFS]
    bench.board.set_wrench((10, 0, 0, 0, 0, 1))
    wrench = bench.run(1.0).wrench
    assert wrench.force.x == pytest.approx(10, abs=0.01)
    assert wrench.torque.z == pytest.approx(1, abs=0.001)


def test_zero_waits_for_the_filter_of_the_board():
    bench = Bench(Jr3Options(cutoff_hz=2.0), offset=OFFSET)
    bench.open()
    bench.run(0.39)
    assert Opcode.ZERO_OFFS not in opcodes(bench)
    state = bench.run(1.0)
    assert state.link is DeviceLink.LIVE
    # After five time constants less than 1 % of the step is missing.
    assert max(map(abs, state.wrench.force)) < 0.01 * 8.6


def test_the_boards_zero_stays_when_asked_for():
    bench = Bench(Jr3Options(zero_on_open=False), offset=OFFSET)
    state = bench.live()
    assert Opcode.ZERO_OFFS not in opcodes(bench)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "take the hand off" in state.reason
    assert state.axes == REST
    assert state.wrench.force == pytest.approx(OFFSET[:3], abs=0.02)


def test_zero_is_not_taken_while_the_hand_moves():
    bench = Bench()
    swing = [0.0]

    def push():
        swing[0] = 5 * math.sin(2 * math.pi * bench.now_s / 0.5)
        bench.board.set_wrench((swing[0], 0, 0, 0, 0, 0))

    bench.each = push
    bench.open()
    state = bench.run(3.0)
    assert Opcode.ZERO_OFFS not in opcodes(bench)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert "keep the hand off" in state.reason
    assert "Fx changes by" in state.reason
    bench.each = lambda: None
    bench.board.set_wrench(REST)
    assert bench.run(1.0).link is DeviceLink.LIVE


def test_a_board_that_is_switched_on_later_is_picked_up_by_its_boot():
    bench = Bench(boot_s=2.0)
    bench.open()
    state = bench.run(1.9)
    assert state.link is DeviceLink.LOST
    assert "has not read the sensor's calibration" in state.reason
    bench.run(0.15)
    assert bench.core.metrics(bench.now_s)["boots"] == 1
    assert bench.run(1.2).link is DeviceLink.LIVE


def test_a_board_without_a_sensor_is_distinguished_from_one_that_is_not_there():
    bench = Bench(faults={"no-sensor": 1.0})
    bench.open()
    assert "check the sensor's cable" in bench.run(1.0).reason
    bench = Bench()
    bench.board.power_off()
    bench.open()
    state = bench.run(1.0)
    assert state.link is DeviceLink.LOST
    assert "node 33 does not answer its ping" in state.reason


def test_pings_are_spaced_out():
    bench = Bench()
    bench.board.power_off()
    bench.open()
    bench.run(20.0)
    assert set(opcodes(bench)) == {Opcode.GET_STATE}
    assert 8 <= len(bench.sent) <= 12  # 0.25, 0.5, 1, 2, 2 ... s after each 0.25 s of waiting


@pytest.mark.parametrize("every", [2.0, 3.0])
def test_lost_acknowledgments_only_delay_it(every):
    bench = Bench(faults={"lost-ack": every})
    bench.open()
    assert bench.run(5.0).link is DeviceLink.LIVE
    assert bench.core.metrics(bench.now_s)["timeouts"] > 0


def test_late_acknowledgments_are_not_taken_for_others():
    bench = Bench(faults={"late-ack": 300.0})
    bench.open()
    bench.run(10.0)
    metrics = bench.core.metrics(bench.now_s)
    assert metrics["unexpected_acks"] > 2
    assert Opcode.START_ASYNC not in opcodes(bench)


def test_an_error_of_the_board_is_shown():
    bench = Bench(faults={"error-ack": 2.0})
    bench.open()
    state = bench.run(1.0)
    assert state.link is DeviceLink.LOST
    assert "error 2" in state.reason


def test_an_acknowledgment_of_the_wrong_kind_answers_nothing():
    core = Jr3Core(Jr3Options())
    core.on_opened(0.0)
    core.poll(0.0)
    core.on_frame(*encode_from_board(Ack(0, (1, 2, 3)), NODE_ID), 0.01)
    assert not core.answered
    assert core.metrics(0.01)["unexpected_acks"] == 1


def test_full_scales_of_zero_are_not_believed():
    core = Jr3Core(Jr3Options())
    core.on_opened(0.0)
    for now_s in (0.0, 0.01, 0.02):
        core.poll(now_s)
        scales = (115, 0, 185) if now_s == 0.02 else None
        core.on_frame(*encode_from_board(Ack(0, scales), NODE_ID), now_s)
    state = core.state(0.02)
    assert state.link is DeviceLink.LOST
    assert "(115, 0, 185)" in state.reason


# -- measurement -----------------------------------------------------------------------------------


def test_the_hand_deflects_the_axes_beyond_the_dead_bands():
    bench = Bench(offset=OFFSET)
    bench.live()
    bench.board.set_wrench((6, -0.9, -21, 0, 1.1, -0.05))
    axes = bench.run(1.0).axes
    # (6 - 1) N of 10; below 1 N; clamped; (1.1 - 0.1) N·m of 2; below 0.1 N·m.
    assert axes == pytest.approx((0.5, 0, -1, 0, 0.5, 0), abs=0.002)


def test_left_handed_sensors_are_turned_round():
    bench = Bench(Jr3Options(left_handed=True))
    bench.live()
    bench.board.set_wrench((6, 5, 4, 0.6, 0.5, 0.4))
    wrench = bench.run(1.0).wrench
    assert (*wrench.force, *wrench.torque) == pytest.approx((-6, 5, 4, -0.6, 0.5, 0.4), abs=0.01)


def test_the_wrench_is_about_the_tcp_along_the_tools_axes():
    # The sensor's x is the tool's y; its origin lies 0.1 m behind the TCP along the tool's z.
    options = Jr3Options(sensor_rpy_deg=(0, 0, 90), sensor_xyz_m=(0, 0, -0.1))
    bench = Bench(options)
    bench.live()
    bench.board.set_wrench((5, 0, 0, 0, 0, 0.3))
    wrench = bench.run(1.0).wrench
    assert wrench.force == pytest.approx((0, 5, 0), abs=0.01)
    assert wrench.torque == pytest.approx((0.5, 0, 0.3), abs=0.002)


def test_the_filter_on_this_computer_adds_to_the_boards():
    quick, slow = (
        Bench(Jr3Options(cutoff_hz=0.0)),
        Bench(Jr3Options(cutoff_hz=0.0, host_cutoff_hz=1.0)),
    )
    for bench in (quick, slow):
        bench.live()
        bench.board.set_wrench((10, 0, 0, 0, 0, 0))
        bench.run(1.0 / (2 * math.pi))
    assert quick.states[-1].wrench.force.x == pytest.approx(10, abs=0.01)
    assert slow.states[-1].wrench.force.x == pytest.approx(10 * (1 - math.exp(-1)), rel=0.1)


def test_the_counter_may_wrap():
    bench = Bench(faults={"counter": 65500.0})
    bench.live()
    bench.run(10.0)
    assert {state.link for state in bench.states} == {DeviceLink.LIVE}
    metrics = bench.core.metrics(bench.now_s)
    assert metrics["lost_samples"] == metrics["repeated_samples"] == metrics["late_samples"] == 0


@pytest.mark.parametrize("period_s", [0.001, 0.004, 0.02])
def test_lost_samples_are_counted_by_the_counter(period_s):
    bench = Bench(Jr3Options(period_s=period_s), faults={"lost-moments": 10.0})
    bench.live()
    before = bench.core.metrics(bench.now_s)
    bench.run(2.0)
    after = bench.core.metrics(bench.now_s)
    expected = 2.0 / period_s / 10
    assert after["lost_samples"] - before["lost_samples"] == pytest.approx(expected, abs=2)
    assert after["unpaired_samples"] - before["unpaired_samples"] == pytest.approx(expected, abs=2)
    assert bench.states[-1].link is DeviceLink.LIVE


def test_only_pairs_of_one_sample_count():
    bench = Bench(faults={"wrong-counter": 1.0})
    bench.open()
    assert bench.run(2.0).link is DeviceLink.STALE
    assert not bench.core.heard


def test_another_node_on_the_bus_does_not_disturb():
    bench = Bench()
    bench.live()
    before = bench.core.metrics(bench.now_s)
    for message in (Forces(9999, 0, 0, 7), Moments(9999, 0, 0, 7), Ack(1)):
        bench.core.on_frame(*encode_from_board(message, 34), bench.now_s)
    bench.core.on_frame(0x0A1, b"\1\2", bench.now_s)
    assert bench.core.metrics(bench.now_s) == before


# -- SYNC ------------------------------------------------------------------------------------------


def test_the_driver_sends_sync_at_its_period():
    bench = Bench(Jr3Options(mode="sync", period_s=0.005))
    assert bench.live().link is DeviceLink.LIVE
    bench.sent.clear()
    bench.run(1.0)
    assert opcodes(bench) == [Opcode.SYNC] * 200
    assert all(frame == (0x080, b"") for frame in bench.sent)


def test_a_stall_makes_no_burst_of_sync():
    bench = Bench(Jr3Options(mode="sync", period_s=0.005))
    bench.live()
    bench.sent.clear()
    assert len(bench.core.poll(bench.now_s + 0.5)) == 1
    due_s = bench.core.next_due_s
    assert bench.now_s + 0.5 < due_s <= bench.now_s + 0.505 + 1e-9


def test_a_bus_master_may_send_sync():
    bench = Bench(Jr3Options(mode="sync", period_s=0.005, send_sync=False))
    bench.open()
    state = bench.run(2.5)
    assert state.link is DeviceLink.STALE
    assert "no master on the bus sends SYNC" in state.reason
    assert Opcode.SYNC not in opcodes(bench)
    bench.master_period_s = 0.005
    assert bench.run(2.0).link is DeviceLink.LIVE


# -- zero ------------------------------------------------------------------------------------------


def test_zero_takes_away_what_is_measured_now():
    bench = Bench()
    bench.live()
    bench.board.set_wrench((0, 0, -4, 0, 0, 0))  # a tool was mounted
    bench.run(1.0)
    due = bench.core.ask_zero(bench.now_s)
    assert bench.core.state(bench.now_s).axes == REST
    assert "taking zero" in bench.core.state(bench.now_s).reason
    state = bench.run(0.5)
    assert bench.core.zeros == due
    assert state.link is DeviceLink.LIVE
    assert state.wrench.force == pytest.approx((0, 0, 0), abs=0.01)
    # On the way, live states are at rest only.
    assert {state.axes for state in bench.states} == {REST}


def test_zero_is_refused_while_the_force_changes():
    bench = Bench()
    bench.live()
    bench.each = lambda: bench.board.set_wrench((20 * math.sin(20 * bench.now_s), 0, 0, 0, 0, 0))
    bench.run(1.0)
    sent = len(bench.sent)
    with pytest.raises(CommandError, match="Fx changes by"):
        bench.core.ask_zero(bench.now_s)
    bench.step()
    assert len(bench.sent) == sent


def test_zero_waits_until_the_force_has_been_watched():
    bench = Bench()
    bench.live()
    bench.core.ask_zero(bench.now_s)
    bench.run(0.01)
    assert bench.core.watching
    with pytest.raises(CommandError, match="not been watched"):
        bench.core.ask_zero(bench.now_s)
    bench.run(0.3)
    assert not bench.core.watching
    bench.core.ask_zero(bench.now_s)


def test_zero_needs_a_running_sensor():
    core = Jr3Core(Jr3Options())
    with pytest.raises(CommandError, match="not opened"):
        core.ask_zero(0.0)
    bench = Bench()
    bench.live()
    bench.board.hang()
    bench.run(0.2)
    with pytest.raises(CommandError, match="no new sample"):
        bench.core.ask_zero(bench.now_s)


def test_the_sample_of_zeros_after_a_zero_is_no_rest():
    """A push that is zeroed and then grows never makes the link live."""
    bench = Bench(Jr3Options(cutoff_hz=0.0))
    bench.live()
    bench.core.ask_zero(bench.now_s)
    bench.board.set_wrench((8, 0, 0, 0, 0, 0))
    bench.run(0.003)  # By now zero has been taken, of the push.
    bench.board.set_wrench((16, 0, 0, 0, 0, 0))
    state = bench.run(1.0)
    assert state.link is DeviceLink.NEEDS_NEUTRAL
    assert {state.axes for state in bench.states} == {REST}


# -- values ----------------------------------------------------------------------------------------


@settings(max_examples=examples(60))
@given(
    st.lists(
        st.tuples(
            st.one_of(st.integers(0, 0x7FF), st.sampled_from([0x121, 0x621, 0x6A1, 0x721])),
            st.binary(max_size=8),
            st.floats(0, 0.3),
        ),
        max_size=40,
    )
)
def test_nothing_on_the_bus_raises_or_moves(frames):
    core = Jr3Core(Jr3Options())
    now_s = 100.0
    core.on_opened(now_s)
    for arbitration_id, data, pause_s in frames:
        now_s += pause_s
        core.poll(now_s)
        core.on_frame(arbitration_id, data, now_s)
        state = core.state(now_s)
        assert all(-1.0 <= axis <= 1.0 for axis in state.axes)
        assert state.link is DeviceLink.LIVE or not any(state.axes)
        assert core.next_due_s >= 100.0
    core.diagnosis(now_s)
    core.metrics(now_s)


def test_a_closed_core_sends_nothing():
    bench = Bench()
    bench.live()
    assert [f.arbitration_id for f in bench.core.final_command()] == [Opcode.STOP + NODE_ID]
    bench.core.on_closed(bench.now_s)
    assert bench.core.poll(bench.now_s) == []
    assert bench.core.next_due_s == math.inf
    state = bench.core.state(bench.now_s)
    assert (state.link, state.axes, state.wrench) == (DeviceLink.CLOSED, REST, None)


def test_it_never_asks_to_be_polled_in_vain():
    """Due work is done at once: a shell that sleeps until the next due time never busy-waits."""
    bench = Bench()
    bench.open()

    def look():
        bench.core.poll(bench.now_s)
        assert bench.core.next_due_s > bench.now_s

    for load in (0.0, 5.0):
        bench.each = look
        bench.board.set_wrench((load, 0, 0, 0, 0, 0))
        bench.run(1.5)
    bench.board.hang()
    bench.run(3.0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"node_id": 0}, "1 to 127"),
        ({"node_id": 128}, "1 to 127"),
        ({"interface": ""}, "python-can"),
        ({"mode": "poll"}, "async, sync"),
        ({"period_s": 0.0}, "0.001 to 0.04"),
        ({"period_s": 0.1}, "0.001 to 0.04"),
        ({"cutoff_hz": -1.0}, "655.35"),
        ({"cutoff_hz": 0.001}, "0.01 Hz"),
        ({"host_cutoff_hz": math.nan}, "655.35"),
        ({"bitrate": 0}, "bit/s"),
        ({"port": 65536}, "ports have 16 bits"),
        ({"force_dead_band_n": 0.0}, "above 0"),
        ({"torque_full_nm": 0.0}, "above 0"),
        ({"steady_n_s": math.inf}, "above 0"),
        ({"sensor_rpy_deg": (0.0, 0.0)}, "3 values"),
        ({"sensor_xyz_m": (0.0, 0.0, math.nan)}, "-10 to 10 m"),
        ({"force_full_scales_n": (0, 1, 1)}, "1 to 65535"),
        ({"torque_full_scales_nm": (0.0, 1.0, 1.0)}, "6553.5"),
    ],
)
def test_options_say_what_is_allowed(options, words):
    (key,) = options
    with pytest.raises(ValueError, match=f"(?s){key}: .* is not allowed; it must be .*{words}"):
        Jr3Options(**options)


def test_steps_of_the_bench_are_those_of_the_shortest_period():
    assert STEP_S == 0.001
