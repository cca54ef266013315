"""Construction of an arm's model from a URDF, by Pinocchio."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from cardan.common.arm_libraries import coal, np, pin
from cardan.common.options import suggestion
from cardan.errors import ConfigurationError
from cardan.robots.arm_chain import Chain, chain_of, no_link, unit_of
from cardan.robots.arm_choices import bent_home, touching_shapes
from cardan.robots.arm_file import ArmFile, CollisionTable
from cardan.robots.arm_limits import limited_by, limits_of
from cardan.robots.arm_model import (
    ArmJoint,
    ArmModel,
    BodyInertia,
    BodyShape,
    Capsule,
    JointKind,
    OrientedBox,
    Shape,
)
from cardan.robots.fit_cache import fit_mesh
from cardan.robots.mesh_files import FoundMesh
from cardan.robots.telescope import swept
from cardan.robots.urdf import LOOSE, Limits, Origin, Tree, arm_form, normal_form
from cardan.spatial import compose, norm, rotate, scale, subtract, transform
from cardan.types import IDENTITY_POSE, ZERO3, Pose, Quaternion, Vector3

_END_CAP_TOLERANCE_M = 1e-4
"""Largest protrusion of a sphere from a cylinder's rounded end that still forms a capsule, m."""

_HOME_TOLERANCE = 1e-3
"""Tolerance of the file's home against its limits, which may be rounded elsewhere, rad or m."""


class _Link(NamedTuple):
    """Place of a link: the body that it belongs to, and its frame in that body's."""

    body: int
    pose: Pose


class _Links(dict[str, _Link]):
    """Links by name, parents before children."""

    def get_link(self, name: str, key: str) -> _Link:
        """Return a link. Raises ConfigurationError of the setting `key` if there is none of that
        name."""
        if name not in self:
            raise no_link(key, name, self)
        return self[name]


def build_arm(
    tree: Tree,
    file: ArmFile,
    meshes: Mapping[ET.Element, FoundMesh],
    disabled: frozenset[tuple[str, str]] | None = None,
) -> ArmModel:
    """Build the arm.

    `meshes` are those of the tree's collision elements, `disabled` the pairs of links that an SRDF
    excludes; None: there is no SRDF. Raises ConfigurationError: with a key for errors of the arm's
    file, without one for errors of the URDF.
    """
    chain = chain_of(tree, file)
    tree = chain.tree
    limits = limits_of(chain.joints, file)
    # Pinocchio has not placed them yet.
    joints = [
        ArmJoint(joint.name, JointKind(joint.kind), IDENTITY_POSE, ZERO3, *each)
        for joint, each in zip(chain.joints, limits, strict=True)
    ]
    if file.acceleration_deg_s2 is not None:
        joints = _accelerated(joints, file.acceleration_deg_s2)
    covers = {
        each: fit_mesh(found.path, file.collision.fit, found.mesh.scale).shapes
        for each, found in meshes.items()
        if found.path is not None
    }
    left_out = meshes.keys() - covers.keys()
    given = {shape.link for shape in file.collision.shape}
    overridden = limited_by(file)
    ours = {
        joint.name: each
        for joint, each in zip(chain.joints, limits, strict=True)
        if joint.name in overridden
    }
    model, geometry, urdf = _reduced(tree, chain, normal_form(tree, given, left_out), ours)
    # Pinocchio's frame of body 0 is the root's.
    base = _link(model, list(tree.links).index(chain.base)).placement.inverse()
    joints = [
        _placed_joint(model, number, joint, base) for number, joint in enumerate(joints, start=1)
    ]
    links = _Links()
    for number, name in enumerate(tree.links):
        frame = _link(model, number)
        body = frame.parentJoint
        links[name] = _Link(body, _pose(frame.placement if body else base * frame.placement))
    frames = {}
    for key, name in (("tcp", chain.tcp), ("flange", file.flange or chain.tcp)):
        body, frames[key] = links.get_link(name, key)
        if body != len(joints):
            raise ConfigurationError(key, f"link {name!r} is not moved by the last joint")
    covers_by_name = _by_name(tree, covers, left_out)
    shapes, solid = _shapes(links, geometry, base, covers_by_name), _solid_links(tree, links)
    missing = {found.link: found.missing for found in meshes.values() if found.missing}
    with_body = ({shape.name for shape in shapes} | given) - missing.keys()
    own_shapes, owners = _own_shapes(chain, links, file.collision)
    owners = [*(shape.name for shape in shapes), *owners]
    shapes += own_shapes
    shapes = _swept_shapes(shapes, owners, chain, joints)
    home = _home(joints, file.home_deg, tree)
    arm = ArmModel(
        name=tree.robot.get("name", ""),
        joints=tuple(joints),
        flange=frames["flange"],
        tcp=frames["tcp"],
        inertias=tuple(_inertia(each) for each in list(model.inertias)[1:]),
        shapes=tuple(shapes),
        ignored_pairs=_pairs(links, shapes, file.collision),
        home=home,
        task=file.task,
        urdf=urdf,
        counterbalanced_joints=_counterbalanced(joints, file.counterbalance),
        solid_links=solid,
        bare_links=tuple(link for link in solid if link not in with_body),
        missing_meshes=tuple(missing[link] for link in solid if link in missing),
        disabled_shapes=_disabled_shapes(owners, disabled or ()),
        held_rows=chain.held_rows(),
    )
    if disabled is None:
        arm = arm._replace(touching_shapes=touching_shapes(arm))
    return arm if home else arm._replace(home=bent_home(arm))


def _reduced(
    tree: Tree, chain: Chain, text: str, limits: Mapping[str, Limits]
) -> tuple[Any, Any, str]:
    """Return Pinocchio's model of the chain in the normal form `text` with all other joints held,
    its shapes, and the same as a URDF with `limits`."""
    numbers = {name: number for number, name in enumerate(tree.joints)}
    try:
        model = pin.buildModelFromXML(text)
        geometry = pin.buildGeomFromUrdfString(model, text, pin.GeometryType.COLLISION)
        q, locked = np.zeros(model.nq), []
        for name, value in chain.held.items():
            joint = model.getJointId(f"joint_{numbers[name]}")
            q[model.joints[joint].idx_q] = value
            locked.append(joint)
        reduced, geometry = pin.buildReducedModel(model, geometry, locked, q)
    except (ValueError, RuntimeError, IndexError) as error:
        raise ConfigurationError("", f"Pinocchio cannot read the arm's URDF: {error}") from None
    return reduced, geometry, _urdf_of(tree, chain, limits, model, q)


def _urdf_of(tree: Tree, chain: Chain, limits: Mapping[str, Limits], model: Any, q: Any) -> str:
    """Return the URDF of the arm alone: only its joints move, and its base is the root. This is the
    file's URDF if that is so already."""
    held = [joint for joint in tree.joints.values() if joint.kind in LOOSE]
    held += [tree.joints[name] for name in chain.held]
    if not held and not limits and chain.base == tree.root:
        return tree.text
    data, numbers = model.createData(), {name: number for number, name in enumerate(tree.links)}
    pin.framesForwardKinematics(model, data, q)

    def place(outer: str, inner: str) -> Origin:
        frames = [model.getFrameId(f"link_{numbers[name]}") for name in (outer, inner)]
        there = data.oMf[frames[0]].actInv(data.oMf[frames[1]])
        turned = pin.rpy.matrixToRpy(there.rotation)
        return Origin(tuple(there.translation.tolist()), tuple(turned.tolist()))

    return arm_form(
        tree,
        {joint.name: place(joint.parent, joint.child) for joint in held},
        None if chain.base == tree.root else place(chain.base, tree.root),
        limits,
    )


def _link(model: Any, number: int) -> Any:
    return model.frames[model.getFrameId(f"link_{number}")]


def _vector(values: Any) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x + 0.0, y + 0.0, z + 0.0)  # Without the sign of a zero.


def _pose(placement: Any) -> Pose:
    x, y, z, w = pin.Quaternion(placement.rotation).normalized().coeffs().tolist()
    sign = math.copysign(1.0, w)
    turned = (sign * each + 0.0 for each in (w, x, y, z))
    return Pose(_vector(placement.translation), Quaternion(*turned))


# ---------------------------------------------------------------------------------------------
# Joints


def _placed_joint(model: Any, number: int, joint: ArmJoint, base: Any) -> ArmJoint:
    placement = model.jointPlacements[number]
    if number == 1:
        placement = base * placement
    motion = pin.computeJointJacobian(model, model.createData(), np.zeros(model.nq), number)
    linear, angular = np.split(motion.reshape(6, -1)[:, number - 1], 2)
    axis = linear if joint.kind is JointKind.PRISMATIC else angular
    return joint._replace(placement=_pose(placement), axis=_vector(axis))


def _unit(joint: ArmJoint) -> float:
    return unit_of(joint.kind.value)


def _each(key: str, values: Sequence[float], joints: list[ArmJoint]) -> list[float]:
    if len(values) != len(joints):
        names = ", ".join(joint.name for joint in joints)
        raise ConfigurationError(key, f"has {len(values)} values for {len(joints)} joints: {names}")
    return [value * _unit(joint) for value, joint in zip(values, joints, strict=True)]


def _accelerated(joints: list[ArmJoint], given: float | tuple[float, ...]) -> list[ArmJoint]:
    values = given if isinstance(given, tuple) else [given] * len(joints)
    accelerations = _each("acceleration_deg_s2", values, joints)
    return [j._replace(acceleration=a) for j, a in zip(joints, accelerations, strict=True)]


def _counterbalanced(joints: list[ArmJoint], last: str) -> int:
    if not last:
        return 0
    names = [joint.name for joint in joints]
    if last not in names:
        raise ConfigurationError(
            "counterbalance",
            f"there is no joint {last!r}; allowed: {', '.join(names)}{suggestion(last, names)}",
        )
    return names.index(last) + 1


def published_home(joints: Sequence[ArmJoint], tree: Tree) -> tuple[float, ...]:
    """Return the file's own home, clipped to rounded limits; empty if it has none within them."""
    there, home = tree.home(), []
    for joint in joints:
        value = there.get(joint.name, math.nan)
        home.append(max(joint.lower, min(joint.upper, value)))
        if not abs(home[-1] - value) <= _HOME_TOLERANCE:
            return ()
    return tuple(home)


def _home(joints: list[ArmJoint], given: tuple[float, ...] | None, tree: Tree) -> tuple[float, ...]:
    """Return the configured or the file's home; empty if there is none: a choice needs the arm."""
    if given is None:
        return published_home(joints, tree)
    home = _each("home_deg", given, joints)
    for joint, value in zip(joints, home, strict=True):
        if not joint.lower <= value <= joint.upper:
            raise ConfigurationError(
                "home_deg",
                f"{joint.name} at {value / _unit(joint):g} is outside "
                f"{joint.lower / _unit(joint):g} to {joint.upper / _unit(joint):g}",
            )
    return tuple(home)


# ---------------------------------------------------------------------------------------------
# Bodies


def _inertia(inertia: Any) -> BodyInertia:
    if inertia.mass == 0.0:
        return BodyInertia(0.0, ZERO3, (0.0,) * 6)
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.inertia.tolist()
    return BodyInertia(inertia.mass, _vector(inertia.lever), (xx, xy, xz, yy, yz, zz))


def _placed(shape: Shape, pose: Pose) -> Shape:
    """Return `shape` in the frame that `pose` is in."""
    if isinstance(shape, OrientedBox):
        return OrientedBox(compose(pose, shape.pose), shape.size_m)
    return Capsule(transform(pose, shape.start), transform(pose, shape.end), shape.radius_m)


def _shape(geometry: Any, pose: Pose) -> Shape:
    """Convert a shape. A cylinder becomes the capsule around it: 500 times cheaper than a mesh, and
    safe."""
    if isinstance(geometry, coal.Box):
        return OrientedBox(pose, _vector(2.0 * geometry.halfSide))
    half = 0.0 if isinstance(geometry, coal.Sphere) else geometry.halfLength
    end = Vector3(0.0, 0.0, half)
    return _placed(Capsule(scale(end, -1.0), end, geometry.radius), pose)


def _by_name(
    tree: Tree, covers: Mapping[ET.Element, tuple[Shape, ...]], left_out: Collection[ET.Element]
) -> dict[str, tuple[Shape, ...]]:
    """Return the shapes that replace meshes, by Pinocchio's name of the mesh: "link_3_0" is the
    first of link 3."""
    found = {}
    for number, element in enumerate(tree.links.values()):
        there = [each for each in element.iterfind("collision") if each not in left_out]
        for index, each in enumerate(there):
            if each in covers:
                found[f"link_{number}_{index}"] = covers[each]
    return found


def _shapes(
    links: _Links, geometry: Any, base: Any, covers: Mapping[str, tuple[Shape, ...]]
) -> list[BodyShape]:
    by_link: dict[str, list[Shape]] = {name: [] for name in links}
    names = list(links)
    for each in geometry.geometryObjects:
        placement = each.placement if each.parentJoint else base * each.placement
        shapes, pose = by_link[names[int(each.name.split("_")[1])]], _pose(placement)
        if each.name in covers:
            shapes += (_placed(shape, pose) for shape in covers[each.name])
        else:
            shapes.append(_shape(each.geometry, pose))
    return [
        BodyShape(name, links[name].body, shape)
        for name, shapes in by_link.items()
        for shape in _without_end_caps(shapes)
    ]


def _swept_shapes(
    shapes: Sequence[BodyShape], owners: Sequence[str], chain: Chain, joints: Sequence[ArmJoint]
) -> list[BodyShape]:
    """Extend shapes by their sweep; `owners` are the links of the shapes."""
    found = []
    for each, owner in zip(shapes, owners, strict=True):
        shape = each.shape
        if sweep := chain.sweeps.get(owner):
            number = [joint.name for joint in joints].index(sweep.joint)
            joint, direction = joints[number], joints[number].axis
            if each.body == number:  # The body that carries the joint.
                direction = rotate(joint.placement.orientation, direction)
            shape = swept(shape, direction, sweep)
        found.append(each._replace(shape=shape))
    return found


def _solid_links(tree: Tree, links: _Links) -> tuple[str, ...]:
    """Return `ArmModel.solid_links`."""
    solid: dict[int, list[str]] = {}
    first: dict[int, str] = {}
    for name, link in links.items():
        first.setdefault(link.body, name)
        element = tree.links[name]
        if element.find("collision") is not None or element.find("visual") is not None:
            solid.setdefault(link.body, []).append(name)
    bodies = sorted(first.keys() - {0})
    return tuple(name for body in bodies for name in solid.get(body, [first[body]]))


def _own_shapes(
    chain: Chain, links: _Links, table: CollisionTable
) -> tuple[list[BodyShape], list[str]]:
    """Return the URDF's own shapes, and the link of each."""
    found, owners = [], []
    for each in table.shape:
        link = each.link or chain.base
        body, pose = links.get_link(link, "collision.shape.link")
        if (shape := each.shape()) is not None:
            found.append(BodyShape(each.name or link, body, _placed(shape, pose)))
            owners.append(link)
    return found, owners


def _without_end_caps(shapes: list[Shape]) -> list[Shape]:
    """Remove spheres at a cylinder's ends, a common form of a capsule: the cylinder's capsule
    covers them."""
    long = [c for c in shapes if isinstance(c, Capsule) and c.start != c.end]

    def swallowed(sphere: Capsule) -> bool:
        return any(
            _segment_distance(c, sphere.start) + sphere.radius_m
            <= c.radius_m + _END_CAP_TOLERANCE_M
            for c in long
        )

    return [c for c in shapes if isinstance(c, OrientedBox) or c.start != c.end or not swallowed(c)]


def _segment_distance(capsule: Capsule, point: Vector3) -> float:
    along, to = subtract(capsule.end, capsule.start), subtract(point, capsule.start)
    share = (along.x * to.x + along.y * to.y + along.z * to.z) / norm(along) ** 2
    return norm(subtract(to, scale(along, max(0.0, min(1.0, share)))))


def _pairs(
    links: _Links, shapes: Iterable[BodyShape], table: CollisionTable
) -> frozenset[tuple[int, int]]:
    named = {shape.name: shape.body for shape in shapes}
    pairs = set()
    for pair in table.ignore:
        bodies = [
            named[name]
            if name in named and name not in links
            else links.get_link(name, "collision.ignore").body
            for name in pair
        ]
        pairs.add((min(bodies), max(bodies)))
    return frozenset(pairs)


def _disabled_shapes(
    owners: Sequence[str], disabled: Iterable[tuple[str, str]]
) -> frozenset[tuple[int, int]]:
    """Return the pairs of shapes, by number, of pairs of links."""
    of_link: dict[str, list[int]] = {}
    for number, link in enumerate(owners):
        of_link.setdefault(link, []).append(number)
    return frozenset(
        (min(one, other), max(one, other))
        for first, second in disabled
        for one in of_link.get(first, ())
        for other in of_link.get(second, ())
    )
