"""The arm itself: rigid bodies, friction, drives, joint stops and contact, stepped in virtual time.

Joint accelerations are Pinocchio's articulated-body algorithm. The scheme is a drift-kick-drift
leapfrog; stiff terms (servo, friction) are taken at the end of the step by adding h·damping +
h²/2·stiffness to the rotor inertia the algorithm sees: no gain makes it unstable. Without
servo and friction it is of second order and keeps energy.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import replace

from cardan.common.arm_libraries import np, npt, pin
from cardan.robots import ArmModel, Capsule, JointKind
from cardan.robots.counterbalance import Counterbalance
from cardan.sim_peers.arm.options import PlantOptions
from cardan.types import Pose, Quaternion, Vector3, Wrench

Array = npt.NDArray[np.float64]

DEFAULT_MASSES_KG = (4.0, 4.0, 3.0, 2.0, 1.0, 0.5)
"""Masses of an arm whose file gives none, from the base; later bodies have the sixth's."""
DEFAULT_GYRATION_M = 0.05
"""Radius of gyration of such a body, in addition to that of a rod of its length."""
PAYLOAD_GYRATION_M = 0.02

_LOCK = 1e9
"""Rotor inertia that locks a joint at its stop, or jammed."""
_CONFIGURATIONS = 64
_PASSES = 4
"""Largest number of repetitions of a step because a drive saturates or a joint leaves its stop."""


class DriveMode(enum.Enum):
    """Control mode of the drives."""

    HOLD = "hold"
    """Brake the reference with the joints' acceleration, then keep it."""
    POSITION = "position"
    VELOCITY = "velocity"
    TORQUE = "torque"


class ArmPlant:
    """A serial arm with its drives. All vectors are in kinematic order, rad and N·m.

    The same calls give the same motion. Modes change without a step of torque: the servo's
    reference is placed where it demands the present torque of the drives.
    """

    def __init__(self, arm: ArmModel, options: PlantOptions | None = None) -> None:
        self.arm = arm
        self.options = options = PlantOptions() if options is None else options
        self.joints = n = len(arm.joints)
        self.step_s = options.step_s
        self.ideal = options.drive == "ideal"
        self.model = build_model(arm, options)
        """For users (inverse dynamics in a test); the plant integrates a copy."""
        self._solver = pin.Model(self.model)
        self._data = self._solver.createData()
        self._armature: Array = self._solver.armature
        """A view: writing it changes the model that is integrated."""
        self._rotors = self._armature.copy()
        self._springs: Counterbalance | None = None
        if arm.counterbalanced_joints:
            bare = build_model(arm, replace(options, payload_kg=0.0))
            self._springs = Counterbalance(bare, arm.counterbalanced_joints)
        self._tcp = _placement(arm.tcp)
        self._lower = np.array(arm.lower)
        self._upper = np.array(arm.upper)
        self._effort = np.array([joint.effort for joint in arm.joints])
        self._effort_finite = bool(np.isfinite(self._effort).any())
        self._effort_over = self._effort * (1.0 + 1e-9)
        start = arm.home if options.start is None else options.start
        if len(start) != n or not all(map(math.isfinite, start)):
            raise ValueError(f"{start} is not a start pose of an arm with {n} joints")
        self._q = np.clip(np.array(start, float), self._lower, self._upper)
        self._v = np.zeros(n)
        self._a = np.zeros(n)
        self.inertia = inertia = self._largest_inertia()
        """Largest inertia of each joint, rotor included: gains and friction are its multiples."""
        h = self.step_s
        bandwidth = options.position_bandwidth_rad_s
        self.stiffness = inertia * bandwidth**2
        """Stiffness of the position servo, N·m/rad."""
        self.damping = inertia * (2.0 * options.damping_ratio * bandwidth)
        """Damping of the servo, N·m·s/rad."""
        self._servo_inertia = 0.5 * h * h * self.stiffness + h * self.damping
        self._viscous = inertia * options.viscous_friction_1_s
        self._coulomb = inertia * (options.coulomb_friction_rad_s2 / options.coulomb_speed_rad_s)
        self._has_coulomb = options.coulomb_friction_rad_s2 > 0.0
        self._has_friction = self._has_coulomb or options.viscous_friction_1_s > 0.0
        self._speed_step = np.array([joint.acceleration for joint in arm.joints]) * h
        self._speed_step_down = -self._speed_step
        self._speed_limit = np.array(arm.velocity)
        self.mode = DriveMode.HOLD
        self._reference = self._q.copy()
        """Reference of the servo for the joints, before `offset`."""
        self._speed = np.zeros(n)
        """Commanded joint speeds."""
        self._target = self._q.copy()
        self._wanted_speed = np.zeros(n)
        self._torque = np.zeros(n)
        """Joint torques of torque mode."""
        self._integral = np.zeros(n)
        self.offset = np.zeros(n)
        """Fault: offset of the joints from the reference at rest."""
        self.slow = 1.0
        """Fault: share of the joints' speeds that the drives reach."""
        self.jammed: int | None = None
        """Fault: joint that does not move (0: the first)."""
        self._stops: dict[int, float] = {}
        """Joints at their stops, with the sign of the blocked direction."""
        self._drive = np.zeros(n)
        self._planes = np.zeros((0, 4))
        if options.planes:
            normals = np.array([plane.normal for plane in options.planes], float)
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            points = np.array([plane.point for plane in options.planes], float)
            self._planes = np.column_stack((normals, (normals * points).sum(axis=1)))
        self._balls = [(np.array(ball.center, float), ball.radius_m) for ball in options.balls]
        self._touchable = bool(len(self._planes) or self._balls)
        self._probes = self._make_probes()
        self._contact = np.zeros(n)
        self._push = np.zeros(6)
        self._steps = 0
        # Kept in order that a step allocates only what Pinocchio returns.
        self._mid, self._mid_v = np.zeros(n), np.zeros(n)
        self._friction, self._work = np.zeros(n), np.zeros(n)
        self._no_inertia = np.zeros(n)
        if not self.ideal:
            self._settle()

    def _largest_inertia(self) -> Array:
        """Return the diagonal of the mass matrix, the largest over all configurations sampled."""
        lower = np.where(np.isfinite(self._lower), self._lower, -math.pi)
        upper = np.where(np.isfinite(self._upper), self._upper, math.pi)
        data = self.model.createData()
        draws = np.random.default_rng(0).uniform(lower, upper, (_CONFIGURATIONS, self.joints))
        masses = [np.diag(pin.crba(self.model, data, q)).copy() for q in draws]
        largest: Array = np.max(masses, axis=0)
        return largest

    # -- commands -------------------------------------------------------------------------------

    def hold(self) -> None:
        """Brake, then stay."""
        if self.mode is not DriveMode.HOLD:
            self._take_over()
            self.mode = DriveMode.HOLD

    def command_positions(
        self, positions: Sequence[float], speeds: Sequence[float] | None = None
    ) -> None:
        """Command `positions` with `speeds` (default: 0).

        The reference moves there at no more than the joints' speed limits.
        """
        if self.mode is not DriveMode.POSITION:
            self._take_over()
            self.mode = DriveMode.POSITION
        np.clip(positions, self._lower, self._upper, out=self._target)
        if speeds is None:
            self._speed[:] = 0.0
        else:
            np.clip(speeds, -self._speed_limit, self._speed_limit, out=self._speed)

    def go_on(self, dt_s: float) -> None:
        """Extrapolate commanded positions at their speeds for `dt_s`."""
        if self.mode is DriveMode.POSITION:
            self._target += self._speed * dt_s
            np.clip(self._target, self._lower, self._upper, out=self._target)

    def command_speeds(self, speeds: Sequence[float]) -> None:
        """Move at `speeds`, reached with the joints' acceleration."""
        if self.mode is not DriveMode.VELOCITY:
            self._take_over()
            self.mode = DriveMode.VELOCITY
        np.clip(speeds, -self._speed_limit, self._speed_limit, out=self._wanted_speed)

    def command_torques(self, torques: Sequence[float]) -> None:
        """Exert `torques`, no more than the joints' effort. ValueError for ideal drives."""
        if self.ideal:
            raise ValueError("ideal drives have no torque mode")
        self.mode = DriveMode.TORQUE
        np.clip(torques, -self._effort, self._effort, out=self._torque)

    def _take_over(self) -> None:
        """Place the servo's reference for a new mode."""
        if self.mode is DriveMode.TORQUE:
            self._speed[:] = self._v
            self._integral[:] = 0.0
            self._reference[:] = self._q - self.offset
            self._reference += (self._drive - self._feed_forward()) / self.stiffness
            np.clip(self._reference, self._lower, self._upper, out=self._reference)
        self._target[:] = self._reference
        self._wanted_speed[:] = 0.0

    def _settle(self) -> None:
        """Start in equilibrium: the servo already carries the arm."""
        np.clip(self._load(self._solver), -self._effort, self._effort, out=self._drive)
        self._reference += (self._drive - self._feed_forward()) / self.stiffness
        self._target[:] = self._reference

    def _load(self, model: pin.Model) -> Array:
        """Return the torques that hold the arm in its pose: its weight less the springs' share."""
        load: Array = pin.computeGeneralizedGravity(model, self._data, self._q)
        return load if self._springs is None else load - self._springs.torques(self._q)

    def _feed_forward(self) -> Array | float:
        return self._load(self.model) if self.options.gravity_feedforward else 0.0

    # -- time -----------------------------------------------------------------------------------

    @property
    def time_s(self) -> float:
        """Since the start; a whole number of steps."""
        return self._steps * self.step_s

    def advance(self, until_s: float) -> None:
        """Step until `time_s` is within half a step of `until_s`."""
        for _ in range(round(until_s / self.step_s) - self._steps):
            self.step()

    def step(self) -> None:
        """Run one integration step."""
        self._steps += 1
        servo = self.mode is not DriveMode.TORQUE
        if servo:
            self._move_reference()
        if self.ideal:
            self._follow()
            return
        h = self.step_s
        q, v, mid, mid_v = self._q, self._v, self._mid, self._mid_v
        np.multiply(v, 0.5 * h, out=mid)
        np.add(mid, q, out=mid)
        np.multiply(self._a, 0.5 * h, out=mid_v)
        np.add(mid_v, v, out=mid_v)
        work = self._work
        if servo:
            # Explicit part of stiffness·(reference - q) + damping·(speed - v) at the step's end.
            np.multiply(v, h, out=work)
            np.add(work, q, out=work)
            np.subtract(self._reference, work, out=work)
            np.add(work, self.offset, out=work)
            drive = work * self.stiffness
            np.subtract(self._speed, v, out=work)
            np.multiply(work, self.damping, out=work)
            np.add(drive, work, out=drive)
            if self.options.integral_1_s:
                np.add(drive, self._integral, out=drive)
            if self.options.gravity_feedforward:
                np.add(drive, self._feed_forward(), out=drive)
            servo_inertia = self._servo_inertia
        else:
            drive = self._torque.copy()
            servo_inertia = self._no_inertia
        if self._has_friction:
            self._friction_damping()
        if self._touchable:
            self._touch(mid, v)
        a = self._solve(drive, servo_inertia)
        np.multiply(a, h, out=work)
        np.add(v, work, out=v)
        np.multiply(v, 0.5 * h, out=q)
        np.add(q, mid, out=q)
        self._a = a
        np.maximum(q, self._lower, out=work)
        np.minimum(work, self._upper, out=work)
        if work.tolist() != q.tolist():  # Of a few numbers, lists are compared faster.
            self._hit_stops()

    def _solve(self, drive: Array, servo_inertia: Array) -> Array:
        """Return accelerations; leave the drives' torques in `_drive`."""
        armature, work, v = self._armature, self._work, self._v
        h = self.step_s
        locked = self._stops or self.jammed is not None
        if locked:
            for joint in (*self._stops, *(() if self.jammed is None else (self.jammed,))):
                v[joint] = self._mid_v[joint] = 0.0
        springs = None if self._springs is None else self._springs.torques(self._mid)
        for _ in range(_PASSES):
            np.add(self._rotors, servo_inertia, out=armature)
            np.copyto(work, drive)
            if springs is not None:
                np.add(work, springs, out=work)
            if self._has_friction:
                friction = self._friction
                np.subtract(work, friction * v, out=work)
                np.add(armature, friction * h, out=armature)
            if self._touchable:
                np.add(work, self._contact, out=work)
            if locked:
                for joint in self._stops:
                    armature[joint] += _LOCK
                if self.jammed is not None:
                    armature[self.jammed] += _LOCK
            a: Array = pin.aba(self._solver, self._data, self._mid, self._mid_v, work)
            again = False
            if self._effort_finite and servo_inertia is not self._no_inertia:
                applied = drive - servo_inertia * a
                over = np.abs(applied) > self._effort_over
                if True in over.tolist():
                    drive[over] = np.copysign(self._effort, applied)[over]
                    servo_inertia = np.where(over, 0.0, servo_inertia)
                    again = True
            for joint, blocked in tuple(self._stops.items()):
                if a[joint] * blocked < 0.0:
                    del self._stops[joint]
                    again = True
            if not again:
                break
        np.multiply(servo_inertia, a, out=self._drive)
        np.subtract(drive, self._drive, out=self._drive)
        if locked:
            for joint in self._stops:
                a[joint] = 0.0
            if self.jammed is not None:
                a[self.jammed] = 0.0
        return a

    def _move_reference(self) -> None:
        h, work, reference, mode = self.step_s, self._work, self._reference, self.mode
        if mode is DriveMode.POSITION:
            np.subtract(self._target, reference, out=work)
            most = self._speed_limit * (h * self.slow)
            if not (self.ideal and self.slow == 1.0):
                np.minimum(work, most, out=work)
                np.negative(most, out=most)
                np.maximum(work, most, out=work)
            np.add(reference, work, out=reference)
        else:
            if mode is DriveMode.VELOCITY and self.slow != 1.0:
                wanted = self._wanted_speed * self.slow
            else:
                wanted = self._wanted_speed
            np.subtract(wanted, self._speed, out=work)
            if not self.ideal:
                np.minimum(work, self._speed_step, out=work)
                np.maximum(work, self._speed_step_down, out=work)
            np.add(self._speed, work, out=self._speed)
            np.multiply(self._speed, h, out=work)
            np.add(reference, work, out=reference)
            leak = self.options.velocity_leak_1_s
            if leak and mode is DriveMode.VELOCITY and not self.ideal:
                np.subtract(reference, self._q, out=work)
                np.add(work, self.offset, out=work)
                np.multiply(work, h * leak, out=work)
                np.subtract(reference, work, out=reference)
            # A sagging arm's reference may be beyond its stop by the sag, never by more.
            np.maximum(reference, self._lower, out=work)
            np.minimum(work, self._upper, out=work)
            if work.tolist() != reference.tolist():
                reference[:] = work
                self._speed[(work == self._lower) | (work == self._upper)] = 0.0
        if self.options.integral_1_s and not self.ideal:
            np.subtract(reference, self._q, out=work)
            np.add(work, self.offset, out=work)
            self._integral += work * self.stiffness * (h * self.options.integral_1_s)

    def _follow(self) -> None:
        """Move ideal drives."""
        wanted = np.clip(self._reference + self.offset, self._lower, self._upper)
        self._v[:] = self._speed
        if self.jammed is not None:
            wanted[self.jammed] = self._q[self.jammed]
            self._v[self.jammed] = 0.0
        self._q[:] = wanted
        if self._touchable:
            self._touch(self._q, self._v)

    def _friction_damping(self) -> None:
        """Express friction as a damping: torque / speed, which is finite at zero speed."""
        friction = self._friction
        if not self._has_coulomb:
            np.copyto(friction, self._viscous)
            return
        ratio = self._work
        np.multiply(self._v, 1.0 / self.options.coulomb_speed_rad_s, out=ratio)
        np.abs(ratio, out=ratio)
        np.maximum(ratio, 1e-9, out=ratio)
        np.tanh(ratio, out=friction)
        np.divide(friction, ratio, out=friction)
        np.multiply(friction, self._coulomb, out=friction)
        np.add(friction, self._viscous, out=friction)

    def _hit_stops(self) -> None:
        q, lower, upper = self._q, self._lower, self._upper
        for joint in np.nonzero((q < lower) | (q > upper))[0].tolist():
            self._stops[joint] = 1.0 if q[joint] > upper[joint] else -1.0
            self._v[joint] = self._a[joint] = 0.0
        np.clip(q, lower, upper, out=q)

    # -- contact --------------------------------------------------------------------------------

    def _make_probes(self) -> list[tuple[int, Array, float]]:
        """Return the spheres for contact: body, center in that body, radius. The TCP's is first."""
        tcp = np.array(self.arm.tcp.position)
        probes = [(self.joints, tcp, self.options.contact_radius_m)]
        if not self.options.body_contact:
            return probes
        for shape in self.arm.shapes:
            if shape.body > 0 and isinstance(shape.shape, Capsule):
                start, end = np.array(shape.shape.start), np.array(shape.shape.end)
                radius = shape.shape.radius_m
                count = 1 + math.ceil(float(np.linalg.norm(end - start)) / radius)
                probes += [
                    (shape.body, start + share * (end - start), radius)
                    for share in np.linspace(0.0, 1.0, count)
                ]
        return probes

    def _touch(self, q: Array, v: Array) -> None:
        """Compute contact forces at `q`: as joint torques in `_contact`, at the TCP in `_push`."""
        solver, data = self._solver, self._data
        pin.forwardKinematics(solver, data, q)
        self._contact[:] = 0.0
        self._push[:] = 0.0
        jacobians = False
        planes = self._planes
        for index, (body, center, radius) in enumerate(self._probes):
            placement = data.oMi[body]
            at = placement.act(center)
            found = []
            if len(planes):
                depths = radius - (planes[:, :3] @ at - planes[:, 3])
                if depths.max() > 0.0:
                    found += [(planes[i, :3], depths[i]) for i in np.nonzero(depths > 0.0)[0]]
            for ball, ball_radius in self._balls:
                away = at - ball
                distance = math.sqrt(away @ away)
                if 0.0 < distance < radius + ball_radius:
                    found.append((away / distance, radius + ball_radius - distance))
            if not found:
                continue
            if not jacobians:
                pin.computeJointJacobians(solver, data, q)
                jacobians = True
            jacobian = pin.getJointJacobian(solver, data, body, pin.LOCAL_WORLD_ALIGNED)
            jacobian = jacobian.reshape(6, self.joints)  # Pinocchio returns one column as a vector.
            twist = jacobian @ v
            lever = at - placement.translation
            for normal, depth in found:
                arm = lever - radius * normal
                force = self._contact_force(normal, depth, twist[:3] + _cross(twist[3:], arm))
                self._contact += jacobian[:3].T @ force
                self._contact += jacobian[3:].T @ _cross(arm, force)
                if index == 0:
                    self._push[:3] -= force
                    self._push[3:] += _cross(radius * normal, force)

    def _contact_force(self, normal: Array, depth: float, speed: Array) -> Array:
        options = self.options
        along = float(normal @ speed)
        normal_n = options.contact_stiffness_n_m * depth - options.contact_damping_n_s_m * along
        if normal_n <= 0.0:
            return np.zeros(3)
        slip = speed - along * normal
        drag: Array = -options.contact_friction_n_s_m * slip
        most_n = options.contact_friction_coefficient * normal_n
        drag_n = math.sqrt(drag @ drag)
        if drag_n > most_n:
            drag *= most_n / drag_n
        force: Array = normal_n * normal + drag
        return force

    # -- measurements ---------------------------------------------------------------------------

    @property
    def positions(self) -> tuple[float, ...]:
        """Joint positions, rad or m."""
        return tuple(self._q.tolist())

    @property
    def velocities(self) -> tuple[float, ...]:
        """Joint velocities, rad/s or m/s."""
        return tuple(self._v.tolist())

    @property
    def torques(self) -> tuple[float, ...]:
        """Torques of the drives (before friction), N·m or N; zero for ideal drives."""
        return tuple(self._drive.tolist())

    @property
    def following_error(self) -> float:
        """Largest distance of a joint from the servo's reference, rad or m."""
        if self.ideal or self.mode is DriveMode.TORQUE:
            return 0.0
        np.add(self._reference, self.offset, out=self._work)
        np.subtract(self._work, self._q, out=self._work)
        np.abs(self._work, out=self._work)
        return float(self._work.max())

    @property
    def worst_joint(self) -> int:
        """Index from 0 of the joint with the largest `following_error`."""
        return int(np.argmax(np.abs(self._reference + self.offset - self._q)))

    def give_in(self) -> None:
        """Stop in place: discard the reference, and keep no more torque than gravity needs."""
        load = np.clip(self._load(self._solver), -self._effort, self._effort)
        self._integral[:] = 0.0
        self._speed[:] = self._v
        self._wanted_speed[:] = 0.0
        sag = 0.0 if self.ideal else (load - self._feed_forward()) / self.stiffness
        self._reference[:] = self._q - self.offset + sag
        self._target[:] = self._reference
        self.mode = DriveMode.HOLD

    @property
    def pose(self) -> Pose:
        """Pose of the TCP, base frame."""
        pin.forwardKinematics(self._solver, self._data, self._q)
        tcp = self._data.oMi[self.joints] * self._tcp
        x, y, z, w = pin.Quaternion(tcp.rotation).coeffs().tolist()
        return Pose(Vector3(*tcp.translation.tolist()), Quaternion(w, x, y, z))

    @property
    def wrench(self) -> Wrench:
        """Wrench that the TCP exerts on the world, base axes, about the TCP."""
        fx, fy, fz, tx, ty, tz = self._push.tolist()
        return Wrench(Vector3(fx, fy, fz), Vector3(tx, ty, tz))

    def set_state(
        self, positions: Sequence[float], velocities: Sequence[float] | None = None
    ) -> None:
        """Place the arm, for tests; the servo holds it there from now on."""
        self._q[:] = np.clip(positions, self._lower, self._upper)
        self._v[:] = 0.0 if velocities is None else velocities
        self._a[:] = 0.0
        self._stops.clear()
        self.give_in()

    def energy_j(self) -> float:
        """Kinetic (rotors included) and potential, that of springs included."""
        data = self.model.createData()
        mass = np.triu(pin.crba(self.model, data, self._q))
        mass = mass + np.triu(mass, 1).T
        potential: float = pin.computePotentialEnergy(self.model, data, self._q)
        if self._springs is not None:
            potential += self._springs.energy_j(self._q)
        return potential + 0.5 * float(self._v @ mass @ self._v)


def build_model(arm: ArmModel, options: PlantOptions) -> pin.Model:
    """The rigid bodies of `arm` for Pinocchio; joint positions are plain angles and lengths.

    An arm without any mass gets DEFAULT_MASSES_KG, each half-way to the next joint. A massless body
    in an arm with masses stays massless: it joins two joints at one point.
    """
    unknown = not any(inertia.mass_kg for inertia in arm.inertias)
    model = pin.Model()
    model.name = arm.name
    ends = [joint.placement.position for joint in arm.joints[1:]] + [arm.flange.position]
    for index, (joint, inertia, end) in enumerate(zip(arm.joints, arm.inertias, ends, strict=True)):
        axis = np.array(joint.axis)
        kind = (
            pin.JointModelPrismaticUnaligned
            if joint.kind is JointKind.PRISMATIC
            else pin.JointModelRevoluteUnaligned
        )
        number = model.addJoint(index, kind(axis), _placement(joint.placement), joint.name)
        if not unknown:
            xx, xy, xz, yy, yz, zz = inertia.moments
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            mass_kg, center = inertia.mass_kg, np.array(inertia.center_m)
        else:
            mass_kg = DEFAULT_MASSES_KG[min(index, len(DEFAULT_MASSES_KG) - 1)]
            center = 0.5 * np.array(end)
            square_m2 = DEFAULT_GYRATION_M**2 + float(np.dot(end, end)) / 12.0
            tensor = mass_kg * square_m2 * np.eye(3)
        body = pin.Inertia(mass_kg, center, tensor)
        model.appendBodyToJoint(number, body, pin.SE3.Identity())
    if options.payload_kg > 0.0:
        tensor = options.payload_kg * PAYLOAD_GYRATION_M**2 * np.eye(3)
        payload = pin.Inertia(options.payload_kg, np.zeros(3), tensor)
        model.appendBodyToJoint(len(arm.joints), payload, _placement(arm.tcp))
    model.armature = np.full(len(arm.joints), options.rotor_inertia)
    model.gravity.linear = np.array(options.gravity_m_s2)
    return model


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product, in a tenth of numpy's time."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array((ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx))


def _placement(pose: Pose) -> pin.SE3:
    w, x, y, z = pose.orientation
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), np.array(pose.position))
