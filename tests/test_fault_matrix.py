"""Motion of the robot, in numbers, with every fault switch of both peers in the whole chain.

The hand grips at 0.8 s and pulls at 50 mm/s from 1.1 s on; at 6.0 s it releases everything, at 6.5
s it grips again, and from 6.8 s on it pushes. All in virtual time.
"""

import pytest

from cardan.gateway.arm.status import Phase
from cardan.sim_peers.egm_controller import FAULTS as ROBOT_FAULTS
from cardan.sim_peers.spacemouse.faults import FAULTS as HAND_FAULTS
from tests.chain import PC_ADDRESS, PUSH, PUSH_AND_REGRIP, Chain

pytestmark = pytest.mark.matrix

SPEED_M_S = 0.05
FIRST_PULL_M = 0.0424
"""Distance of the arm between 2.0 s and 2.9 s without faults."""

HARMLESS_HAND = {
    "short-report": 10.0,
    "unknown-id": 10.0,
    "padded-report": 64.0,
    "lost-half": 10.0,
    "duplicate-half": 10.0,
    "late-half": 10.0,
    "wrong-family": 1.0,
    "stuck-button": 1.0,
}
HARMLESS_ROBOT = {
    "drop": 0.05,
    "duplicate": 0.05,
    "reorder": 0.05,
    "delay": 20.0,
    "jitter": 8.0,
    "garbage": 0.1,
    "clock-step": 3600.0,
    "rapid-undefined": 1.0,
}
ELSEWHERE = {
    # in the socket of the served peer: tests/sim_peers/test_spacemouse_socket.py
    "newest-lost",
    # needs a model with a battery: tests/sim_peers/test_spacemouse_faults.py
    "low-battery",
}


def within_limits(chain, speed_m_s=SPEED_M_S, hardest_m_s2=1.3):
    """Check that the arm kept to its speed, and started and stopped gently."""
    assert chain.fastest_m_s() <= 1.1 * speed_m_s
    assert chain.hardest_m_s2() <= hardest_m_s2
    return chain


def stays_until_regripped(chain, from_s, until_s=6.7):
    assert chain.traveled_m(from_s, until_s) <= 2e-4
    assert chain.traveled_m(7.0, 8.5) == pytest.approx(0.071, rel=0.05)


def test_no_fault():
    chain = within_limits(Chain(PUSH_AND_REGRIP).run(9.0))
    assert chain.traveled_m(2.0, 2.9) == pytest.approx(FIRST_PULL_M, rel=0.01)
    assert chain.core.status().trips == 0
    assert sum(s.sent for s in chain.samples) == chain.cycles


@pytest.mark.parametrize(("fault", "value"), HARMLESS_HAND.items())
def test_faulty_reports_do_not_show_at_the_robot(fault, value):
    chain = within_limits(Chain(PUSH_AND_REGRIP, hand_faults={fault: value}).run(9.0))
    assert chain.traveled_m(2.0, 2.9) == pytest.approx(FIRST_PULL_M, rel=0.02)
    assert chain.traveled_m(6.3, 6.6) <= 2e-4
    assert chain.core.status().trips == 0


@pytest.mark.parametrize(("fault", "value"), HARMLESS_ROBOT.items())
def test_a_bad_network_is_ridden_out(fault, value):
    chain = within_limits(Chain(PUSH_AND_REGRIP, robot_faults={fault: value}).run(9.0))
    # A duplicate of our datagram is used twice: one period late each time, with a probability of 5
    # %.
    slowed = 0.06 if fault == "duplicate" else 0.02
    assert chain.traveled_m(2.0, 2.9) == pytest.approx(FIRST_PULL_M, rel=slowed)
    assert chain.core.status().trips == 0
    counters = chain.egm.counters
    assert (counters.lost > 50) == (fault in ("drop", "reorder"))
    assert (counters.duplicates > 50) == (fault == "duplicate")
    assert (sum(counters.malformed.values()) > 50) == (fault == "garbage")


def test_unplugged_while_moving():
    chain = within_limits(Chain(PUSH_AND_REGRIP, hand_faults={"unplug": 3.0}).run(9.0))
    # 50 ms of braking, then the servo delay and filter of the arm
    assert chain.traveled_m(3.0, 9.0) <= 0.004
    assert chain.rests_from() <= 3.3
    assert "unplugged" in chain.messages()
    assert chain.core.phase is Phase.DISARMED


def test_plugged_in_again_while_deflected():
    faults = {"unplug": 3.0, "replug": 4.0}
    chain = within_limits(Chain(PUSH_AND_REGRIP, hand_faults=faults).run(9.0))
    stays_until_regripped(chain, 3.3)


def test_radio_lost_while_deflected():
    chain = within_limits(Chain(PUSH_AND_REGRIP, hand_faults={"silence": 3.0}).run(9.0))
    # the last report drives for 0.1 s at most
    assert chain.traveled_m(3.0, 9.0) <= 0.1 * SPEED_M_S + 0.004
    assert chain.rests_from() <= 3.4
    assert "but no motion report for 0.09 s" in chain.messages()


def test_reports_that_stall_and_come_at_once():
    chain = within_limits(Chain(PUSH_AND_REGRIP, hand_faults={"burst": 0.5}).run(9.0))
    # The first stall disengages the device; the burst after it does not re-engage it.
    assert chain.traveled_m(2.0, 6.7) <= 3e-4
    assert chain.core.status().trips >= 1


def test_seized_device():
    chain = Chain(PUSH_AND_REGRIP, hand_faults={"seized": 1.0}).run(9.0)
    assert chain.traveled_m(0.0, 9.0) <= 1e-4
    assert "touch the cap" in chain.messages()


def test_a_device_that_opens_late_and_deflected():
    chain = Chain(PUSH_AND_REGRIP, hand_faults={"refuse": 2.0}).run(9.0)
    assert chain.traveled_m(0.0, 6.7) <= 2e-4
    stays_until_regripped(within_limits(chain), 2.0)


def test_a_drifting_device_rests_where_the_hand_rests():
    chain = within_limits(Chain(PUSH_AND_REGRIP, hand_faults={"drift": 5.0}).run(9.0), 0.053)
    assert chain.traveled_m(6.3, 6.6) <= 2e-4


def test_a_drifting_device_is_named():
    chain = Chain("", hand_faults={"drift": 5.0}).run(9.0)
    assert chain.traveled_m(0.0, 9.0) <= 1e-4
    assert "re-zero" in " ".join(chain.device.diagnosis(chain.now_s))


def test_more_than_full_deflection_is_full_deflection():
    hand = PUSH.replace("-0.5", "-1")
    chain = within_limits(Chain(hand, hand_faults={"overrange": 420.0}).run(3.0), 0.1)
    assert chain.fastest_m_s(2.0, 3.0) == pytest.approx(0.1, rel=0.02)


def test_a_dead_man_that_is_stuck_still_needs_the_cap():
    chain = within_limits(Chain(PUSH_AND_REGRIP, hand_faults={"stuck-button": 0.0}).run(9.0))
    assert chain.traveled_m(6.3, 6.6) <= 2e-4


def test_a_pause_of_the_controller_ends_the_session():
    chain = within_limits(Chain(PUSH_AND_REGRIP, robot_faults={"pause": 0.3}).run(9.0))
    stays_until_regripped(chain, 5.6)
    assert "the robot's controller fell silent" in chain.messages()
    assert chain.egm.metrics()["sessions"] == 2


def test_a_restarted_controller():
    chain = within_limits(Chain(PUSH_AND_REGRIP, robot_faults={"restart": 3.0}).run(9.0))
    # The arm stops by itself at 3.0 s and is back after 2 s, with sequence number 0.
    assert chain.traveled_m(3.2, 5.0) <= 2e-4
    stays_until_regripped(chain, 5.0)
    assert chain.egm.metrics()["sessions"] == 2


def test_the_controllers_port_changes():
    """During motion it may be another program, and gets no answer.

    The controller stops the arm by its CommTimeout. The program, which is started again at 6 s, is
    a new session.
    """
    chain = within_limits(Chain(PUSH_AND_REGRIP, robot_faults={"port-change": 3.0}).run(8.9))
    assert chain.traveled_m(3.0, 4.01) <= 0.011
    stays_until_regripped(chain, 4.2)
    assert chain.egm.metrics()["sessions"] == 2
    assert chain.egm.metrics()["foreign"] > 200


@pytest.mark.parametrize("fault", ["estop", "motors-off"])
def test_stopped_at_the_robot(fault):
    chain = within_limits(Chain(PUSH_AND_REGRIP, robot_faults={fault: 3.0}).run(9.0))
    assert chain.traveled_m(3.0, 9.0) <= 0.004
    assert "the motors are off" in chain.messages()


def test_motors_on_again_makes_no_step(tmp_path):
    script = "0 movej\n0 getid\n0 setup\n0 act window=1e-9 max-speed=180\n"
    script += "0 run cond-time=1e6\n3 motors-off\n4 motors-on\n4.5 restart\n"
    program = tmp_path / "program.txt"
    program.write_text(script)
    chain = Chain(PUSH, script=str(program)).run(6.0)
    within_limits(chain)
    assert chain.samples[-1].phase is Phase.DISARMED
    assert chain.traveled_m(3.3, 6.0) <= 2e-4


@pytest.mark.parametrize("source", [PC_ADDRESS, ("127.0.0.1", 6666)], ids=["forged", "foreign"])
def test_a_flooded_port(source):
    chain = Chain(PUSH_AND_REGRIP).run(3.0)
    receive = chain.egm.receive

    def flooded(data, address, now_s):
        if 3.0 <= now_s < 4.0:
            for _ in range(20):
                assert receive(b"garbage", source, now_s) is None
        return receive(data, address, now_s)

    chain.egm.receive = flooded
    within_limits(chain.run(6.0))
    # Detected within a few cycles; then 50 ms of braking and the arm's own delay.
    assert chain.traveled_m(3.1, 6.7) <= 0.003
    assert "is flooded with datagrams that are not the controller's" in chain.messages()
    assert chain.core.status().trips == 1
    # Every datagram of the controller was answered throughout.
    assert sum(s.sent for s in chain.between(3.0, 6.0)) == len(chain.between(3.0, 6.0))
    assert chain.traveled_m(7.0, 8.5) == pytest.approx(0.071, rel=0.05)


@pytest.mark.parametrize("comm_timeout_s", [0.1, 0.5])
def test_the_gateways_process_is_killed(comm_timeout_s):
    chain = Chain(PUSH, comm_timeout_s=comm_timeout_s).run(3.0)
    chain.session_alive = False
    chain.run(4.0)
    within_limits(chain)
    # EGM continues at the last speed until CommTimeout, then ramps down over 0.5 s.
    longest_m = SPEED_M_S * (comm_timeout_s + 0.5) + 0.003
    assert chain.traveled_m(3.0, 7.0) <= longest_m
    assert chain.rests_from() <= 3.0 + comm_timeout_s + 0.8
    assert 41822 in [event.code for event in chain.controller.events]


def test_killed_gateway_and_a_new_one_needs_rearming():
    chain = Chain(PUSH, comm_timeout_s=0.2).run(3.0)
    chain.session_alive = False
    chain.run(1.0)
    fresh = Chain(PUSH)
    chain.core, chain.egm, chain.device = fresh.core, fresh.egm, fresh.device
    chain.device.on_opened(chain.now_s, chain.puck.model)
    chain.session_alive = True
    chain.run(5.0)
    assert chain.traveled_m(4.5, 9.0) <= 2e-4
    assert chain.samples[-1].phase is Phase.DISARMED


def test_the_singularity_in_front_stops_the_arm_and_says_so():
    chain = within_limits(Chain(PUSH.replace("-0.5", "1")).run(6.0), 0.1, hardest_m_s2=2.0)
    assert 50026 in [event.code for event in chain.controller.events]
    assert chain.traveled_m(5.0, 6.0) <= 1e-4
    assert "the RAPID program is stopped" in chain.messages()


def test_every_fault_switch_is_in_the_matrix():
    named = {
        *HARMLESS_HAND,
        *HARMLESS_ROBOT,
        *ELSEWHERE,
        *("unplug", "replug", "silence", "burst", "seized", "refuse", "drift", "overrange"),
        *("pause", "restart", "port-change", "estop", "motors-off"),
    }
    assert named == {f.name for f in (*HAND_FAULTS, *ROBOT_FAULTS)}
