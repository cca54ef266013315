"""A GoFa over EGM driven by the model of its arm: the whole chain in virtual time."""

import itertools
import math

import pytest

from cardan.drivers.abb_egm import AbbEgm, AbbEgmOptions, EgmSession
from cardan.errors import MotionRefusedError
from cardan.gateway.arm.status import Phase
from cardan.gateway.arm.verb_methods import ArmVerbs
from cardan.gateway.arm.verb_results import Outcome
from cardan.gateway.session.arm_assembly import make_arm
from cardan.gateway.session.config import parse_config
from cardan.robots import load_arm
from cardan.sim_peers.egm_controller import EgmController, EgmControllerOptions, EgmMode
from tests.chain import PUSH, Chain
from tests.fault_benches import EgmBench, EgmJointBench
from tests.test_slip_compensation import SPEED_M_S, moving

INTO_THE_SINGULARITY = PUSH.replace("-0.5", "0.9")
"""Forward without end: the wrist straightens 27 cm ahead, where the arm's reach ends."""


def chain(mode, hand=PUSH, **more):
    options = AbbEgmOptions(mode=mode, robot="gofa_crb15000_5")
    config = parse_config(
        {
            "device": {"driver": "spacemouse"},
            "robot": {"driver": "abb_egm", "mode": mode, "robot": "gofa_crb15000_5"},
            "arm": {"model": "gofa_crb15000_5"},
        }
    )
    arm = make_arm(config, AbbEgm(options))
    return Chain(hand, arm=arm, egm=options, mode=EgmMode(mode), **more)


@pytest.mark.parametrize("mode", ["joint", "pose"])
def test_the_hand_drives_the_robot(mode):
    run = chain(mode).run(4.0)
    assert run.core.phase is Phase.MOVING
    moved = run.samples[0].position.x - run.samples[-1].position.x
    assert moved == pytest.approx(0.05 * 2.9, abs=0.015)
    assert abs(run.samples[-1].position.z - run.samples[0].position.z) < 1e-3
    assert max(s.speed for s in run.samples) < 0.06
    assert run.core.status().trips == 0


def test_the_end_of_reach_is_held_without_a_fault_and_left_again():
    """With joint commands; a controller that gets poses stops at its own singularities."""
    hand = INTO_THE_SINGULARITY + "9.0 axes -0.9 0 0 0 0 0 over 0.1\n"
    run = chain("joint", hand).run(9.0)
    status = run.core.status()
    assert status.trips == 0
    assert status.lead_used < 0.5
    assert status.arm.path_speed < 0.2
    far = run.samples[-1].position
    run.run(2.0)
    assert far.x - run.samples[-1].position.x > 0.1
    assert run.core.status().trips == 0


@pytest.mark.matrix("pose")
@pytest.mark.parametrize("mode", ["joint", "pose"])
def test_a_silent_controller_needs_rearming(mode):
    run = chain(mode, robot_faults={"drop": 0.2}).run(4.0)
    assert run.core.phase is Phase.MOVING  # 20 % loss in each direction is tolerated
    run.session_alive = False
    run.run(1.0)
    here = run.samples[-1].position
    run.session_alive = True
    run.run(1.0)
    assert math.dist(here, run.samples[-1].position) < 5e-3
    assert run.core.phase is not Phase.MOVING


def test_every_verb_with_default_options():
    """A program commands joints, in the controller's cycles."""
    controller = EgmController(EgmControllerOptions())
    robot = AbbEgm(AbbEgmOptions(robot="gofa_crb15000_5"))
    session = EgmSession(robot.options, 0.0)
    verbs = ArmVerbs.alone(load_arm("gofa_crb15000_5"), robot.capabilities)
    cycles = itertools.count()

    def run(seconds, until=lambda: False):
        for _ in range(round(seconds / controller.options.period_s)):
            now_s = next(cycles) * controller.options.period_s
            data = controller.cycle(now_s)
            state = session.receive(data, ("127.0.0.1", 40000), now_s) if data else None
            if state is not None:
                controller.receive(session.reply(verbs.controller.tick(state), now_s))
                assert now_s < 0.1 or state.hold_reason == ""
            if until():
                return

    def over(motion):
        run(20.0, lambda: verbs.start_pending() or motion.over)
        assert motion.outcome is Outcome.DONE, motion
        run(0.5)
        return verbs.stat().pose[:3]

    run(0.2)
    start = verbs.stat().pose
    assert over(verbs.movl([start[0] - 0.02, *start[1:]]))[0] == pytest.approx(
        start[0] - 0.02, abs=1e-3
    )
    assert over(verbs.movj(start)) == pytest.approx(start[:3], abs=1e-3)
    assert over(verbs.relj([0.0, 0.0, -0.02, 0.0, 0.0, 0.0]))[2] == pytest.approx(
        start[2] - 0.02, abs=1e-3
    )
    verbs.movv([-0.01, 0.0, 0.0, 0.0, 0.0, 0.0])
    run(2.0)
    verbs.stop()
    run(1.0)
    assert verbs.at_rest
    assert -0.02 < verbs.stat().pose[0] - start[0] < -0.015
    with pytest.raises(MotionRefusedError, match="this needs torque"):
        verbs.gcmp()


@pytest.mark.matrix(
    *(f"EGM pose-{stall_s}" for stall_s in (0.11, 0.12, 0.129, 0.15)),
    *(f"EGM joint-{stall_s}" for stall_s in (0.12, 0.132, 0.15, 0.19)),
)
@pytest.mark.parametrize("stall_s", [0.11, 0.12, 0.129, 0.132, 0.15, 0.19])
@pytest.mark.parametrize("kind", [EgmBench, EgmJointBench], ids=lambda kind: kind.name)
def test_a_process_that_stood_still_has_an_arm_go_no_faster(kind, stall_s):
    """Queued datagrams arrive at once, so that the agreed time advances less than the robot's."""
    with kind() as bench:
        moving(bench)
        since_s = bench.now_s
        bench.stall(stall_s)
        bench.run(0.4)
        motion = bench.motion(since_s)
        assert motion.peak_m_s <= 1.05 * SPEED_M_S
        assert motion.back_m <= 1e-4
