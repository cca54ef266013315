"""Springs that carry an arm's weight, computed with Pinocchio."""

from __future__ import annotations

from typing import Any

from cardan.common.arm_libraries import np, npt, pin

Array = npt.NDArray[np.float64]


class Counterbalance:
    """Springs of an arm's first joints: `ArmModel.counterbalanced_joints` of `model`.

    Passive springs store the potential energy of the arm, so their torques derive from a potential
    of those joints alone: that of the arm with all later joints rigid at zero. It includes neither
    a tool nor a load, which `model` must not have.
    """

    def __init__(self, model: Any, joints: int) -> None:
        self._joints = joints
        self._torques = np.zeros(model.nv)
        data = model.createData()
        pin.forwardKinematics(model, data, np.zeros(model.nq))
        carried = self._model = pin.Model()
        carried.gravity = model.gravity
        for body in range(1, model.njoints):
            placement = pin.SE3.Identity()
            if body <= joints:
                joint, at = model.joints[body], model.jointPlacements[body]
                carried.addJoint(body - 1, joint, at, model.names[body])
            else:
                placement = data.oMi[joints].actInv(data.oMi[body])
            carried.appendBodyToJoint(min(body, joints), model.inertias[body], placement)
        self._data = carried.createData()

    def torques(self, q: Array) -> Array:
        """Return the springs' torques at joint positions `q`, N·m or N; 0 after the last spring.
        The array is reused by every call."""
        n = self._joints
        self._torques[:n] = pin.computeGeneralizedGravity(self._model, self._data, q[:n])
        return self._torques

    def energy_j(self, q: Array) -> float:
        """Return the energy stored at `q`, J; its zero is arbitrary."""
        weight_j: float = pin.computePotentialEnergy(self._model, self._data, q[: self._joints])
        return -weight_j
