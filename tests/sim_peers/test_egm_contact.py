"""A surface under the simulated GoFa's TCP: forces, their messages, and the driver's decoding."""

import math

import pytest
from hypothesis import given, strategies as st

from cardan.drivers.abb_egm import AbbEgmOptions, EgmSession
from cardan.errors import ScriptError
from cardan.sim_peers.egm_controller import ContactSurface, EgmController, EgmControllerOptions
from cardan.sim_peers.egm_controller.contact import tcp_velocity, touch
from cardan.sim_peers.kinematics import forward
from cardan.spatial import norm, rotate, subtract
from cardan.types import Frame, HoldCommand, PoseCommand, Vector3
from tests.sim_peers.egm_pc import Pc

DOWN_DEG = (0.0, 20.0, 30.0, 0.0, 40.0, 0.0)
"""The tool points straight down, with the TCP 0.292 m above the base."""
TABLE = ContactSurface(0.28, stiffness_n_m=1000.0, damping_n_s_m=20.0, friction=0.3)

speeds = st.floats(-1.0, 1.0)


def pressing(depth_m, **options):
    """Return a PC that has pressed the TCP `depth_m` into TABLE and holds it there."""
    pc = Pc(
        mode="pose",
        joints_deg=DOWN_DEG,
        **{"surface": TABLE, "force_control": True, "max_speed_deviation_deg_s": 180.0, **options},
    )
    start = pc.core.tcp
    goal = start.position._replace(z=TABLE.height_m - depth_m)
    pc.hold = pc.pose(goal, start.orientation)
    pc.run(3.0, pc.hold)
    return pc


def mean_force(pc, seconds=0.5):
    forces = [m.measured_force.force for m in pc.run(seconds, pc.hold)]
    return [sum(force[n] for force in forces) / len(forces) for n in range(3)]


# -- the law --------------------------------------------------------------------------------------


@given(st.floats(-0.05, 0.05), speeds, speeds, speeds)
def test_a_surface_never_pulls_and_friction_is_coulombs(height_m, x, y, z):
    force = touch(TABLE, Vector3(0.5, 0.0, TABLE.height_m + height_m), Vector3(x, y, z))
    assert force.z <= 0.0
    along_n = math.hypot(force.x, force.y)
    assert along_n <= TABLE.friction * -force.z * (1.0 + 1e-9)
    assert force.x * x + force.y * y >= 0.0  # the friction of the pen drags the sheet along
    if height_m >= 0.0:
        assert force == (0.0, 0.0, 0.0)
    if force.z < 0.0 and math.hypot(x, y) > 0.001:
        assert along_n == pytest.approx(TABLE.friction * -force.z)


@given(speeds, speeds, speeds)
def test_damping_only_takes_energy(x, y, z):
    at = Vector3(0.5, 0.0, TABLE.height_m - 0.002)
    force = touch(TABLE, at, Vector3(x, y, z))
    still = touch(TABLE, at, Vector3(0.0, 0.0, 0.0))
    assert sum(v * (f - s) for v, f, s in zip((x, y, z), force, still, strict=True)) >= -1e-12


def test_the_velocity_of_the_tcp_is_the_derivative_of_its_position():
    joints, rates = [0.1, 0.3, -0.2, 0.5, 0.7, -0.4], [0.3, -0.2, 0.4, 0.1, -0.5, 0.6]
    step_s = 1e-6
    ahead = [q + v * step_s for q, v in zip(joints, rates, strict=True)]
    frames = forward(joints)
    way = subtract(forward(ahead).pose.position, frames.pose.position)
    assert tcp_velocity(frames, rates) == pytest.approx([w / step_s for w in way], abs=1e-5)


# -- on the wire ----------------------------------------------------------------------------------


def test_nothing_is_felt_above_the_surface():
    assert mean_force(pressing(-0.005)) == pytest.approx([0.0, 0.0, 0.0], abs=0.15)


@pytest.mark.matrix("base-exerted--1.0", "tool-reaction--1.0")
@pytest.mark.parametrize(
    ("frame", "sense", "sign"),
    [
        # Pressed down: along the tool's z, against the base's.
        ("tool", "exerted", 1.0),
        ("base", "exerted", -1.0),
        ("tool", "reaction", -1.0),
        ("base", "reaction", 1.0),
    ],
)
def test_a_pen_pressed_on_a_table_in_every_convention(frame, sense, sign):
    pc = pressing(0.010, force_frame=frame, force_sense=sense)
    assert pc.core.contact_force.z == pytest.approx(-10.0, abs=0.1)
    assert mean_force(pc)[2] == pytest.approx(sign * 10.0, abs=0.3)


def test_the_raw_sensor_adds_its_bias():
    compensated, raw = (mean_force(pressing(0.010, force_control=on)) for on in (True, False))
    assert norm(subtract(Vector3(*raw), Vector3(*compensated))) > 5.0


def test_friction_is_felt_against_the_stroke():
    pc = pressing(0.010, force_frame="base")
    tcp = pc.core.tcp
    strengths = []
    for n in range(100):
        at = tcp.position._replace(y=0.0005 * n)
        pc.run(0.004032, pc.pose(at, tcp.orientation))
        strengths.append(pc.core.contact_force)
    last = strengths[-1]
    assert last.y == pytest.approx(-TABLE.friction * last.z, rel=0.05)


def test_a_hard_press_is_a_collision():
    pc = pressing(0.010, collision_force_n=40.0)
    quota = pc.last.collision_info.coll_det_quota[0]
    assert quota == pytest.approx(25.0, abs=1.0)
    tcp = pc.core.tcp
    pc.run(2.0, pc.pose(tcp.position._replace(z=TABLE.height_m - 0.08), tcp.orientation))
    assert any("Motion supervision" in event.text for event in pc.core.events)
    assert -pc.core.contact_force.z < 60.0  # the arm stopped there


def test_a_script_puts_a_surface_there_and_takes_it_away():
    steps = (
        "0 movej\n0 setup\n0 act window=1e-9\n0 run cond-time=1e6\n"
        "0.1 wall 300 2 10 0.1\n0.5 wall 300 0\n"
    )
    pc = Pc(steps, mode="pose", joints_deg=DOWN_DEG, force_control=True)
    pc.run(0.3)
    assert pc.core.contact_force.z == pytest.approx(-2000.0 * (0.3 - pc.core.tcp.position.z))
    pc.run(0.4)
    assert pc.core.contact_force == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("line", ["0 wall 300", "0 wall 300 -1", "0 wall 300 1 1 1 1"])
def test_a_wall_that_is_none_is_refused(line):
    with pytest.raises(ScriptError, match="usage: wall"):
        Pc(line + "\n")


# -- understood by the driver ---------------------------------------------------------------------


@pytest.mark.parametrize("frame", ["tool", "base"])
def test_the_drivers_wrench_is_what_the_pen_exerts_so_that_its_reaction_points_up(frame):
    controller = EgmController(
        EgmControllerOptions(
            joints_deg=DOWN_DEG, surface=TABLE, force_control=True, force_frame=frame
        )
    )
    session = EgmSession(AbbEgmOptions(force_frame=frame), 0.0)
    goal = controller.tcp._replace(
        position=controller.tcp.position._replace(z=TABLE.height_m - 0.005)
    )
    up_n = []
    for cycle in range(1000):
        now_s = cycle * controller.options.period_s
        data = controller.cycle(now_s)
        state = None if data is None else session.receive(data, ("127.0.0.1", 40000), now_s)
        if state is None:
            continue
        command = PoseCommand(goal) if state.ready else HoldCommand()
        controller.receive(session.reply(command, now_s))
        wrench = state.wrench
        force = wrench.force
        if wrench.frame is Frame.TOOL:
            force = rotate(state.pose.orientation, force)
        up_n.append(-force.z)
    assert sum(up_n[:20]) / 20 == pytest.approx(0.0, abs=0.3)
    assert sum(up_n[-200:]) / 200 == pytest.approx(5.0, abs=0.3)
