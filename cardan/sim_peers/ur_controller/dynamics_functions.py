"""URScript's functions of the arm's dynamics, with the present payload."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cardan.sim_peers.ur_controller import checks
from cardan.sim_peers.ur_controller.dynamics import Dynamics
from cardan.sim_peers.ur_controller.language import (
    KINEMATICS_STEPS,
    MASS_STEPS,
    Function,
    costing,
)
from cardan.sim_peers.ur_controller.motion import ArmMotion


def dynamics_functions(motion: ArmMotion, dynamics: Dynamics) -> Mapping[str, Function]:
    """Return the functions by name. Defaults: measured joints and speeds, and the active TCP."""

    def joints(q: Any) -> tuple[float, ...]:
        return tuple(motion.actual_q) if q is None else checks.joints("q", q)

    def speeds(qd: Any) -> tuple[float, ...]:
        return tuple(motion.actual_qd) if qd is None else checks.vector("qd", qd)

    def mass_matrix(q: Any, rotors: Any) -> list[list[float]]:
        if checks.truth("include_rotors_inertia", rotors):
            raise ValueError("include_rotors_inertia is True, and the model has no rotors")
        return [list(row) for row in dynamics.mass_matrix(joints(q), motion.load)]

    def coriolis(q: Any, qd: Any) -> list[float]:
        return list(dynamics.coriolis(joints(q), speeds(qd), motion.load))

    def jacobian_rate(q: Any, qd: Any, tcp: Any) -> list[list[float]]:
        tool = motion.tcp if tcp is None else checks.frame("tcp", tcp)
        columns = motion.kinematics.jacobian_rate(joints(q), speeds(qd), tool)
        return [list(row) for row in zip(*columns, strict=True)]

    given = {"q": None, "qd": None}
    functions = {
        "get_coriolis_and_centrifugal_torques": Function(("q", "qd"), given, coriolis),
        "get_jacobian_time_derivative": Function(
            ("q", "qd", "tcp"), {**given, "tcp": None}, jacobian_rate
        ),
    }
    masses = Function(
        ("q", "include_rotors_inertia"),
        {"q": None, "include_rotors_inertia": False},
        mass_matrix,
        steps=MASS_STEPS,
    )
    return {**costing(KINEMATICS_STEPS, functions), "get_mass_matrix": masses}
