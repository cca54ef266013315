"""Plant of the simulated Motoman arm, from command to feedback."""

from __future__ import annotations

import pytest

from cardan.errors import OptionError
from cardan.sim_peers.motoros_controller.options import MotorosControllerOptions
from cardan.sim_peers.motoros_controller.plant import PLANTS, Plant, PlantModel

IPC_S = 0.004


def follow(model, commands, ipc_s=IPC_S):
    """Return the measured pulses of one axis for these commands, IPC by IPC."""
    plant = Plant(model, ipc_s, [commands[0]])
    found = []
    for command in commands:
        plant.step([command])
        found.append(plant.measured[0])
    return found


def test_an_ideal_arm_is_one_period_behind():
    commands = [0, 5, 5, -7, 100]
    assert follow(PLANTS["ideal"], commands) == [0, 0, 5, 5, -7]


@pytest.mark.parametrize("ipc_s", [0.002, 0.004])
def test_the_papers_arm_tracks_a_ramp_0_268_s_late(ipc_s):
    step = 1000
    commands = [step * k for k in range(int(3.0 / ipc_s))]
    late_s = (commands[-1] - follow(PLANTS["paper"], commands, ipc_s)[-1]) / step * ipc_s
    assert late_s == pytest.approx(0.268, abs=0.004)


def test_the_papers_arm_has_a_dead_time():
    moved = follow(PLANTS["paper"], [0] + [10_000] * 200)
    first = next(k for k, pulses in enumerate(moved) if pulses)
    assert 0.04 <= first * IPC_S <= 0.25


@pytest.mark.parametrize(
    ("model", "late_s"),
    [
        (PlantModel(dead_time_s=0.2), 0.2),
        (PlantModel(average_s=0.204), 0.1),
        (PlantModel(lag_s=0.05), 0.05),
    ],
)
def test_each_part_delays_a_ramp_by_its_own_time(model, late_s):
    commands = [100 * k for k in range(1500)]
    behind = (commands[-1] - follow(model, commands)[-1]) / 100
    assert behind * IPC_S == pytest.approx(late_s + IPC_S, abs=1e-6)


@pytest.mark.parametrize("name", PLANTS)
def test_it_arrives_exactly_and_stays_responsive(name):
    plant = Plant(PLANTS[name], IPC_S, [10, -20])
    for command in ([500, -3000], [500, -3001], [-8, 7]):
        for _ in range(1000):
            plant.step(command)
        assert plant.measured == command
        assert plant.change == [0.0, 0.0]


def test_the_command_is_copied():
    plant = Plant(PLANTS["paper"], IPC_S, [0])
    command = [0]
    for k in range(500):
        command[0] = k
        plant.step(command)
    assert 499 - plant.measured[0] == pytest.approx(0.268 / IPC_S, rel=0.02)


def test_change_is_the_way_made_in_the_period():
    plant = Plant(PLANTS["paper"], IPC_S, [0])
    before = 0.0
    for k in range(300):
        plant.step([k * 10])
        assert plant.change[0] == pytest.approx(plant.measured[0] - before)
        before = plant.measured[0]


@pytest.mark.parametrize("bad", [-0.1, float("nan"), 11.0])
def test_times_out_of_range_are_named(bad):
    with pytest.raises(OptionError, match=rf"plant: .*lag_s={bad}.* 0 to 10 s"):
        MotorosControllerOptions(plant=PlantModel(lag_s=bad))
