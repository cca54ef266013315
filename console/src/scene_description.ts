import * as THREE from "three";
import type { URDFRobot } from "urdf-loader";
import type { Quat, Vec3 } from "./spatial.ts";

type Range = readonly [number, number];

type Solid = {
  name: string;
  box?: { position: Vec3; orientation: Quat; size_m: Vec3 };
  capsule?: { start: Vec3; end: Vec3; radius_m: number };
  plane?: { normal: Vec3; offset_m: number };
};

type Placed = { position: Vec3; orientation: Quat };

/** Another arm, that moves by itself: its base in this one's, and its joints from there on, each where
 * it is in the body before at zero. */
export type Neighbor = {
  name: string;
  topic: string;
  max_age_s: number;
  base: Placed;
  joints: (Placed & { name: string; axis: Vec3; slides: boolean })[];
  shapes: (Solid & { joint: string })[];
};

/** Joint positions of a neighbor by name, and when they came, ms of the page. */
export type Heard = { joints: ReadonlyMap<string, number>; ms: number };

/** What an arm's session tells of what is around it: base axes, m and rad. */
export type SceneDescription = {
  workspace_m: readonly (Range | null)[];
  /** Of the TCP, for x, y and z; null: no arm is known. */
  reach_m?: readonly Range[] | null;
  obstacles: Solid[];
  /** Of the arm, each in the frame of the link after its joint; "" is the base. */
  shapes: (Solid & { joint: string })[];
  neighbors?: Neighbor[];
  /** How many links have no body, and which; empty or absent: all have one. */
  links_without_body?: string;
  /** The keys of visual meshes, by what the description calls them. */
  visuals?: Record<string, string>;
  /** Which of them are not there; empty or absent: none. */
  visuals_left_out?: string;
  /** The distance that is kept to obstacles; null: collisions are not avoided. */
  obstacle_m: number | null;
  own_body_m: number | null;
  home: number[] | null;
};

/** What comes nearer than is kept and so much more is colored. The arm's own bodies pass each other
 * closely in any posture. */
const WARNS_M = { obstacle: 0.04, ownBody: 0.01 };

/** What is kept where the session does not say. */
const CLEARANCE_M = { obstacle: 0.01, ownBody: 0.005 };

const COLORS = {
  obstacle: new THREE.Color(0x8b7355),
  neighbor: new THREE.Color(0x8e7cc3),
  /** Of a neighbor that nothing was heard of for long. */
  old: new THREE.Color(0x9aa0a6),
  shell: new THREE.Color(0x30a46c),
  near: new THREE.Color(0xf59e0b),
  touching: new THREE.Color(0xe5484d),
  edge: new THREE.Color(0x3b82f6),
};

/** How near the nearest pair is: 0 far, 1 as near as is allowed. */
export function nearness(
  clearance: number | null,
  pair: readonly string[],
  told: SceneDescription | null,
): number {
  if (clearance === null) return 0;
  const solids = [told?.obstacles, ...(told?.neighbors ?? []).map((each) => each.shapes)];
  const obstacle = solids.flat().some((each) => each && pair.includes(each.name));
  const kind = obstacle ? "obstacle" : "ownBody";
  const kept = (obstacle ? told?.obstacle_m : told?.own_body_m) ?? CLEARANCE_M[kind];
  return Math.max(0, Math.min(1, 1 + (kept - clearance) / WARNS_M[kind]));
}

/** The color of a warning for how near it is, 0 to 1. */
export function warning(near: number): THREE.Color {
  return COLORS.near.clone().lerp(COLORS.touching, near);
}

/** Corners of the workspace, where its open sides are `open` m away; null: it has no walls. */
export function walls(
  ranges: readonly (Range | null)[],
  open: number,
): { low: Vec3; high: Vec3 } | null {
  if (!ranges.some((each) => each !== null)) return null;
  const side = (axis: number): Range => ranges[axis] ?? [-open, open];
  const [x, y, z] = [side(0), side(1), side(2)];
  return { low: [x[0], y[0], z[0]], high: [x[1], y[1], z[1]] };
}

/** A neighbor's bodies, and what moves them. */
class Other {
  readonly root = new THREE.Group();
  readonly told: Neighbor;
  readonly materials: THREE.MeshLambertMaterial[] = [];
  private readonly moved: THREE.Group[] = [];

  constructor(told: Neighbor) {
    this.told = told;
    this.root.visible = false;
    put(this.root, told.base);
    let before = this.root;
    for (const joint of told.joints) {
      const [fixed, moved] = [new THREE.Group(), new THREE.Group()];
      put(fixed, joint);
      before.add(fixed);
      fixed.add(moved);
      this.moved.push(moved);
      before = moved;
    }
  }

  /** The body after a joint; "" is the base. */
  after(joint: string): THREE.Group | undefined {
    return joint ? this.moved[this.told.joints.findIndex((each) => each.name === joint)] : this.root;
  }

  /** Take what was heard last; before that it is not shown, and once that is old it is gray. */
  follow(heard: Heard | undefined, nowMs: number): void {
    this.root.visible = heard !== undefined;
    const old = !heard || isOld(this.told, heard, nowMs);
    for (const each of this.materials) each.userData["own"] = old ? COLORS.old : COLORS.neighbor;
    this.told.joints.forEach((joint, index) => {
      const [moved, value] = [this.moved[index], heard?.joints.get(joint.name)];
      if (!moved || value === undefined) return;
      const axis = new THREE.Vector3(...joint.axis);
      if (joint.slides) moved.position.copy(axis.multiplyScalar(value));
      else moved.quaternion.setFromAxisAngle(axis, value);
    });
  }
}

function put(group: THREE.Group, at: Placed): void {
  group.position.set(...at.position);
  group.quaternion.set(...at.orientation);
}

/** Whether a neighbor may be elsewhere by now. */
export function isOld(neighbor: Neighbor, heard: Heard, nowMs: number): boolean {
  return nowMs - heard.ms > 1e3 * neighbor.max_age_s;
}

/** Workspace, obstacles, neighbors, and the collision shapes of the arm with the distance that is kept. */
export class Around {
  readonly workspace = new THREE.Group();
  readonly obstacles = new THREE.Group();
  readonly neighbors = new THREE.Group();
  private readonly others: Other[] = [];
  private readonly shells: THREE.Mesh[] = [];
  private readonly materials = new Map<string, THREE.MeshLambertMaterial[]>();
  private readonly edge = new THREE.LineBasicMaterial({ color: COLORS.edge });

  /** Make all of it anew; `reach`: about how far the arm reaches, m. */
  load(told: SceneDescription, robot: URDFRobot | null, reach: number): void {
    this.clear();
    for (const each of told.obstacles) {
      const mesh = solid(each, 0, 3 * reach);
      if (mesh) this.obstacles.add(this.painted(mesh, each.name, COLORS.obstacle, 0.55));
    }
    for (const each of told.neighbors ?? []) {
      const other = new Other(each);
      for (const shape of each.shapes) {
        const mesh = solid(shape, 0, reach);
        if (!mesh) continue;
        other.after(shape.joint)?.add(this.painted(mesh, shape.name, COLORS.old, 0.55));
        other.materials.push(mesh.material as THREE.MeshLambertMaterial);
      }
      this.others.push(other);
      this.neighbors.add(other.root);
    }
    for (const each of robot ? told.shapes : []) {
      const mesh = solid(each, told.obstacle_m ?? 0, reach);
      const place = each.joint ? robot?.joints[each.joint] : robot;
      if (!mesh || !place) continue;
      place.add(this.painted(mesh, each.name, COLORS.shell, 0.22));
      this.shells.push(mesh);
    }
    const box = walls(told.workspace_m, 1.5 * reach);
    if (box) this.workspace.add(this.wireBox(box.low, box.high));
  }

  showShells(on: boolean): void {
    for (const each of this.shells) each.visible = on;
  }

  /** Put the neighbors where they were heard to be, by their names; `color` then colors them. */
  follow(heard: ReadonlyMap<string, Heard>, nowMs: number): void {
    for (const each of this.others) each.follow(heard.get(each.told.name), nowMs);
  }

  /** Color the pair that is near, 0 to 1, and the wall that is met. */
  color(near: number, pair: readonly string[], atWall: boolean): void {
    for (const [name, materials] of this.materials) {
      for (const material of materials) {
        const { own, opacity } = material.userData as { own: THREE.Color; opacity: number };
        const warns = near > 0 && pair.includes(name);
        material.color.copy(own);
        if (warns) material.color.lerp(warning(near), 0.4 + 0.6 * near);
        material.opacity = warns ? opacity + 0.25 * near : opacity;
      }
    }
    this.edge.color.copy(atWall ? COLORS.touching : COLORS.edge);
  }

  /** Show none of it. */
  clear(): void {
    for (const each of this.shells) each.removeFromParent();
    this.shells.length = 0;
    this.materials.clear();
    this.obstacles.clear();
    this.neighbors.clear();
    this.others.length = 0;
    this.workspace.clear();
  }

  private painted(mesh: THREE.Mesh, name: string, own: THREE.Color, opacity: number): THREE.Mesh {
    const material = new THREE.MeshLambertMaterial({
      color: own,
      transparent: true,
      opacity,
      depthWrite: false,
      side: THREE.DoubleSide,
    });
    Object.assign(material.userData, { own, opacity });
    mesh.material = material;
    this.materials.set(name, [...(this.materials.get(name) ?? []), material]);
    return mesh;
  }

  private wireBox(low: Vec3, high: Vec3): THREE.LineSegments {
    const size: Vec3 = [high[0] - low[0], high[1] - low[1], high[2] - low[2]];
    const edges = new THREE.EdgesGeometry(new THREE.BoxGeometry(...size));
    const lines = new THREE.LineSegments(edges, this.edge);
    lines.position.set(low[0] + size[0] / 2, low[1] + size[1] / 2, low[2] + size[2] / 2);
    return lines;
  }
}

/** A mesh of it, larger by `more` on all sides; planes are as wide as `wide`. */
export function solid(of: Solid, more: number, wide: number): THREE.Mesh | null {
  if (of.capsule) {
    const { start, end, radius_m } = of.capsule;
    const [from, to] = [new THREE.Vector3(...start), new THREE.Vector3(...end)];
    const along = to.clone().sub(from);
    const mesh = new THREE.Mesh(new THREE.CapsuleGeometry(radius_m + more, along.length(), 6, 14));
    mesh.position.copy(from).addScaledVector(along, 0.5);
    if (along.length() > 1e-9) {
      mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along.normalize());
    }
    return mesh;
  }
  if (of.box) {
    const { position, orientation, size_m } = of.box;
    const [x, y, z] = size_m;
    const mesh = new THREE.Mesh(new THREE.BoxGeometry(x + 2 * more, y + 2 * more, z + 2 * more));
    mesh.position.set(...position);
    mesh.quaternion.set(...orientation);
    return mesh;
  }
  if (of.plane) {
    const normal = new THREE.Vector3(...of.plane.normal);
    const mesh = new THREE.Mesh(new THREE.PlaneGeometry(wide, wide));
    mesh.position.copy(normal).multiplyScalar(of.plane.offset_m);
    mesh.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), normal);
    return mesh;
  }
  return null;
}
