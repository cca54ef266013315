import * as THREE from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
import type { URDFRobot } from "urdf-loader";
import type { Arm } from "./arm.ts";
import { Figure } from "./figure.ts";
import { t } from "./i18n.ts";
import type { Part } from "./settings.ts";
import { type Pose, type Vec3, norm, subtract } from "./spatial.ts";
import { Around, isOld, nearness, warning } from "./scene_description.ts";
import type { Color, Meshes } from "./visuals.ts";

const TRAIL_POINTS = 1200;
/** A point of the trail each so many meters. */
const TRAIL_STEP_M = 0.002;

/** Where the processor draws: it has to be left to the hold, whose frames come first. */
const SOFTWARE_SPACING_MS = 250;
const SOFTWARE_PIXEL_RATIO = 0.35;
const RESTS_MS = 700;

const FORCE_M_PER_N = 0.01;
const LONGEST_FORCE_M = 0.4;

const COLORS = {
  even: 0xe4e8ee,
  odd: 0x9fb0c3,
  ghost: 0x3b82f6,
  unreachable: 0xe5484d,
  measured: 0x12a594,
  commanded: 0xf59e0b,
  trail: 0x12a594,
  force: 0xd946ef,
};

export type View = "iso" | "front" | "side" | "top";
const VIEWS: Record<View, Vec3> = {
  iso: [1.25, -1.15, 0.85],
  front: [1.9, 0, 0.25],
  side: [0, -1.9, 0.25],
  top: [0.001, 0, 2.1],
};

/** The picture of an arm: the robot as measured, and a ghost at the goal. Axes are the base's: x
 * forward, y left, z up, m. It is drawn when something in it has changed. */
export class Scene {
  /** Something is about to be drawn: time to say what. */
  beforeDraw: () => void = () => {};
  /** Something may be held: where the processor draws, nothing of it waits for a fine picture. */
  hurried = false;
  /** The gizmo was dragged to a pose. */
  onDrag: (pose: Pose) => void = () => {};
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera(40, 1, 0.02, 50);
  private readonly orbit: OrbitControls;
  private readonly gizmo: TransformControls;
  private readonly handle = new THREE.Object3D();
  private readonly measured = axes(0.12);
  private readonly base = axes(0.25);
  private readonly around = new Around();
  private readonly hides = new Set<Part>();
  private readonly commanded: THREE.Mesh;
  private readonly force: THREE.ArrowHelper;
  private readonly trail: THREE.Line;
  private readonly trailPoints = new Float32Array(3 * TRAIL_POINTS);
  private trailCount = 0;
  private robot: URDFRobot | null = null;
  private ghost: URDFRobot | null = null;
  /** Of the robot and the ghost. */
  private figures: Figure[] = [];
  private readonly meshes: Meshes;
  private readonly linkMaterials = new Map<string, THREE.MeshLambertMaterial[]>();
  private readonly ghostMaterials = { round: translucent(COLORS.ghost), flat: translucent(COLORS.ghost) };
  private readonly slow: boolean;
  private readonly label: string;
  private drawnMs = -Infinity;
  private changedMs = -Infinity;
  private fine = false;
  private warm = false;
  private drawn: number[] = [];
  private dirty = true;
  private dragging = false;
  private hasGoal = false;
  /** Whether the goal can be dragged. */
  private edits = false;
  private readonly place: HTMLElement;
  private hasGhost = false;
  private reach = 1;
  /** Whether the reach is that of the robot. */
  private measures = false;

  /** Raises where the browser has no WebGL. */
  constructor(place: HTMLElement, label: string, meshes: Meshes) {
    this.place = place;
    this.meshes = meshes;
    this.ghostMaterials.flat.flatShading = true;
    this.slow = drawsBySoftware();
    this.renderer = new THREE.WebGLRenderer({ antialias: !this.slow, alpha: true });
    // Shaders are three's own; asking whether they are right waits for the compiler.
    this.renderer.debug.checkShaderErrors = false;
    const canvas = this.renderer.domElement;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", label);
    this.label = label;
    place.append(canvas);

    this.camera.up.set(0, 0, 1);
    this.orbit = new OrbitControls(this.camera, canvas);
    this.orbit.addEventListener("change", () => this.redraw());
    this.look("iso");

    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8893a5, 1.6));
    const sun = new THREE.DirectionalLight(0xffffff, 2.2);
    sun.position.set(1.5, -2, 3);
    this.scene.add(sun);
    const fill = new THREE.DirectionalLight(0xbfd4ff, 0.7);
    fill.position.set(-2, 1.5, 1);
    this.scene.add(fill);

    const grid = new THREE.GridHelper(4, 40, 0x6b7a90, 0x6b7a90);
    grid.rotation.x = Math.PI / 2;
    const lines = grid.material as THREE.LineBasicMaterial;
    lines.transparent = true;
    lines.opacity = 0.22;
    this.scene.add(grid, this.base, this.measured);
    this.scene.add(this.around.workspace, this.around.obstacles, this.around.neighbors);

    this.commanded = new THREE.Mesh(
      new THREE.TorusGeometry(0.02, 0.0025, 8, 40),
      new THREE.MeshBasicMaterial({ color: COLORS.commanded }),
    );
    this.commanded.visible = false;
    this.force = new THREE.ArrowHelper(
      new THREE.Vector3(0, 0, 1),
      new THREE.Vector3(),
      0.1,
      COLORS.force,
    );
    this.force.visible = false;
    const path = new THREE.BufferGeometry();
    path.setAttribute("position", new THREE.BufferAttribute(this.trailPoints, 3));
    path.setDrawRange(0, 0);
    this.trail = new THREE.Line(path, new THREE.LineBasicMaterial({ color: COLORS.trail }));
    this.trail.frustumCulled = false;
    this.scene.add(this.commanded, this.force, this.trail, this.handle);

    this.gizmo = new TransformControls(this.camera, canvas);
    this.gizmo.setSize(0.75);
    this.gizmo.attach(this.handle);
    this.gizmo.addEventListener("dragging-changed", (event) => {
      this.dragging = Boolean(event.value);
      this.orbit.enabled = !this.dragging;
    });
    this.gizmo.addEventListener("objectChange", () => this.onDrag(poseOf(this.handle)));
    this.gizmo.addEventListener("change", () => this.redraw());
    this.scene.add(this.gizmo.getHelper());
    this.edit(false);

    new ResizeObserver(() => this.resize(place)).observe(place);
    this.resize(place);
    requestAnimationFrame(this.draw);
  }

  /** Show no robot, and nothing around it. */
  empty(): void {
    for (const old of [this.robot, this.ghost]) old?.removeFromParent();
    [this.robot, this.ghost, this.figures] = [null, null, []];
    this.meshes.clear();
    this.linkMaterials.clear();
    this.around.clear();
    this.clearTrail();
  }

  /** Show the robot of an arm's description; the movable joints' names in its order. */
  load(description: string): void {
    this.empty();
    this.figures = [
      new Figure(description, (link, color, flat) => this.material(link, color, flat)),
      new Figure(description, (_link, _color, flat) => this.ghostMaterials[flat ? "flat" : "round"]),
    ];
    const [robot, ghost] = this.figures.map((each) => each.robot) as [URDFRobot, URDFRobot];
    [this.robot, this.ghost] = [robot, ghost];
    this.ghost.visible = false;
    this.hasGoal = this.hasGhost = false;
    this.scene.add(this.robot, this.ghost);
    this.warm = this.measures = false;
    this.showLooks();
  }

  /** Show an arm as it looks, as far as its session knows that, once its robot is loaded. */
  async dress(arm: Arm): Promise<void> {
    const { figures } = this;
    if (!arm.sceneDescription) return;
    for (const each of figures) {
      if (each.standIn(arm.sceneDescription.shapes)) this.measures = false;
    }
    this.showLooks();
    // One after the other: what moves the arm comes first.
    for (const [file, key] of Object.entries(arm.sceneDescription.visuals ?? {})) {
      const geometry = await this.meshes.get(key);
      if (this.figures !== figures) return;
      if (geometry) for (const each of figures) each.give(file, geometry);
      this.showLooks();
    }
  }

  private showLooks(): void {
    const counts = this.figures.map((each) => each.show(this.shows("visuals")));
    this.place.dataset["looks"] = String(counts[0] ?? 0);
    if (!this.measures && this.measure()) this.look("iso");
    this.warm = false;
    this.redraw();
  }

  /** Of something of a link of the robot. */
  private material(link: string, color: Color | null, flat: boolean): THREE.Material {
    const materials = this.linkMaterials.get(link) ?? [];
    if (!materials.length) this.linkMaterials.set(link, materials);
    const name = JSON.stringify([color, flat]);
    const known = materials.find((each) => each.name === name);
    if (known) return known;
    const number = [...this.linkMaterials.keys()].indexOf(link);
    const own = new THREE.Color(number % 2 ? COLORS.odd : COLORS.even);
    if (color) own.setRGB(...color.rgb, THREE.SRGBColorSpace);
    const { alpha } = color ?? { alpha: 1 };
    const material = new THREE.MeshLambertMaterial({
      name,
      color: own,
      flatShading: flat,
      side: flat ? THREE.DoubleSide : THREE.FrontSide,
      transparent: alpha < 1,
      opacity: alpha,
    });
    material.userData["color"] = own;
    materials.push(material);
    return material;
  }

  /** Show what is around an arm, once its robot is loaded. */
  surround(arm: Arm): void {
    if (!arm.sceneDescription) return;
    void this.dress(arm);
    this.around.load(arm.sceneDescription, this.robot, this.reach);
    this.around.showShells(this.shows("capsules"));
    const { obstacles, neighbors } = arm.sceneDescription;
    const names = [...obstacles, ...(neighbors ?? [])].map((each) => each.name).join(", ");
    const words = names ? `${this.label}. ${t("shown_obstacles")}: ${names}.` : this.label;
    this.renderer.domElement.setAttribute("aria-label", words);
    this.warm = false;
    this.redraw();
  }

  /** Show a part of the picture, or hide it. */
  show(part: Part, on: boolean): void {
    if (on) this.hides.delete(part);
    else this.hides.add(part);
    this.base.visible = this.shows("axes");
    this.measured.visible = this.shows("tcp");
    this.trail.visible = this.shows("trail");
    this.around.workspace.visible = this.shows("workspace");
    this.around.obstacles.visible = this.around.neighbors.visible = this.shows("obstacles");
    this.around.showShells(this.shows("capsules"));
    if (this.ghost) this.ghost.visible = this.hasGhost && this.shows("ghost");
    this.showLooks();
  }

  private shows(part: Part): boolean {
    return !this.hides.has(part);
  }

  /** Take what the arm has published; called from beforeDraw. */
  follow(arm: Arm): void {
    if (this.robot && arm.joints) setJoints(this.robot, arm.joints.names, arm.joints.positions);
    if (arm.measured) {
      place(this.measured, arm.measured);
      this.extendTrail(arm.measured.position);
      if (!this.hasGoal && !this.dragging) place(this.handle, arm.measured);
      this.gizmo.getHelper().visible = this.edits;
    }
    const moves = arm.commanded !== null && Boolean(arm.status?.moving);
    this.commanded.visible = moves && this.shows("commanded");
    if (arm.commanded) place(this.commanded, arm.commanded);
    this.showForce(arm);
    this.around.follow(arm.neighbors, performance.now());
    this.showClearance(arm);
  }

  /** Show the ghost; null: take it away. */
  showGoal(names: readonly string[], joints: readonly number[] | null, pose: Pose | null, reachable: boolean): void {
    if (!this.ghost) return;
    this.hasGoal = pose !== null;
    this.hasGhost = pose !== null && joints !== null;
    this.ghost.visible = this.hasGhost && this.shows("ghost");
    if (joints) setJoints(this.ghost, names, joints);
    for (const each of Object.values(this.ghostMaterials)) {
      each.color.setHex(reachable ? COLORS.ghost : COLORS.unreachable);
    }
    if (pose && !this.dragging) place(this.handle, pose);
    this.redraw();
  }

  /** The pose of the TCP with the joints so, in the base; null before there is a robot. */
  forward(arm: Arm, joints: readonly number[]): Pose | null {
    if (!this.ghost || !arm.joints) return null;
    setJoints(this.ghost, arm.joints.names, joints);
    this.ghost.updateMatrixWorld(true);
    const flange = arm.tcp ? this.ghost.links[arm.tcp.parent] : undefined;
    if (!flange || !arm.tcp) return null;
    const tcp = new THREE.Object3D();
    place(tcp, arm.tcp.pose);
    tcp.updateMatrix();
    const whole = flange.matrixWorld.clone().multiply(tcp.matrix);
    whole.decompose(tcp.position, tcp.quaternion, tcp.scale);
    return poseOf(tcp);
  }

  /** Range and speed of a joint, rad or m; null: it has none. */
  limits(name: string): { lower: number; upper: number; velocity: number; slides: boolean } | null {
    const joint = this.robot?.joints[name];
    if (!joint) return null;
    const slides = joint.jointType === "prismatic";
    const unlimited = joint.jointType === "continuous";
    return {
      lower: unlimited ? -Math.PI : joint.limit.lower,
      upper: unlimited ? Math.PI : joint.limit.upper,
      velocity: joint.limit.velocity || 1,
      slides,
    };
  }

  /** Let the goal be dragged by its arrows; otherwise they are not there. */
  edit(on: boolean): void {
    this.edits = on;
    this.gizmo.enabled = on;
    this.gizmo.getHelper().visible = on && this.robot !== null;
    this.place.dataset["gizmo"] = String(on);
    this.redraw();
  }

  setGizmo(mode: "translate" | "rotate", space: "world" | "local"): void {
    this.gizmo.setMode(mode);
    this.gizmo.setSpace(space);
    this.redraw();
  }

  look(from: View): void {
    const [x, y, z] = VIEWS[from];
    const center = new THREE.Vector3(0.15, 0, 0.33).multiplyScalar(this.reach);
    this.orbit.target.copy(center);
    this.camera.position.set(x, y, z).multiplyScalar(this.reach).add(center);
    this.orbit.update();
    this.redraw();
  }

  clearTrail(): void {
    this.trailCount = 0;
    this.trail.geometry.setDrawRange(0, 0);
    this.redraw();
  }

  redraw(): void {
    this.dirty = true;
    this.changedMs = performance.now();
  }

  /** Draw anew where what the arm publishes looks different. */
  news(arm: Arm): void {
    const now = [
      ...(arm.joints?.positions ?? []),
      ...(arm.measured?.position ?? []),
      ...(arm.wrench ? arm.wrench.force.map((each) => each / 1000) : []),
      arm.status?.moving ? 1 : 0,
      arm.snapshot?.arm?.clearance_m ?? 1,
      arm.snapshot?.arm?.at_workspace_limit ? 1 : 0,
      ...(arm.sceneDescription?.neighbors ?? []).flatMap((each) => {
        const heard = arm.neighbors.get(each.name);
        if (!heard) return [];
        return [...heard.joints.values(), isOld(each, heard, performance.now()) ? 1 : 0];
      }),
    ];
    if (now.length === this.drawn.length && now.every((each, at) => same(each, this.drawn[at]))) return;
    this.drawn = now;
    this.redraw();
  }

  /** Where the processor draws, a picture that changes is coarse and drawn seldom: the frames of the
   * hold come first. One that rests is drawn once more, as fine as the screen. */
  private readonly draw = (nowMs: number): void => {
    requestAnimationFrame(this.draw);
    const rests = nowMs - this.changedMs > RESTS_MS;
    const fine = !this.slow || (rests && !this.hurried);
    if (!this.dirty && fine === this.fine) return;
    if (this.slow && nowMs - this.drawnMs < SOFTWARE_SPACING_MS) return;
    if (fine !== this.fine || this.drawnMs === -Infinity) {
      this.renderer.setPixelRatio(fine ? Math.min(2, devicePixelRatio) : SOFTWARE_PIXEL_RATIO);
    }
    [this.fine, this.drawnMs, this.dirty] = [fine, nowMs, false];
    this.beforeDraw();
    if (this.robot && !this.warm) this.warmUp();
    this.renderer.render(this.scene, this.camera);
  };

  /** Draw once all that may appear: its shaders are made now, and not when the arm begins to move. */
  private warmUp(): void {
    this.warm = true;
    const hidden = [this.ghost, this.commanded, this.force].filter((each) => each && !each.visible);
    for (const each of hidden) if (each) each.visible = true;
    this.renderer.render(this.scene, this.camera);
    for (const each of hidden) if (each) each.visible = false;
  }

  /** Whether there is anything of a robot to measure. */
  private measure(): boolean {
    if (!this.robot) return false;
    const box = new THREE.Box3().setFromObject(this.robot);
    if (box.isEmpty()) return false;
    const size = box.getSize(new THREE.Vector3());
    this.reach = Math.max(0.4, Math.min(4, Math.max(size.x, size.y, size.z) / 0.9));
    this.measures = true;
    return true;
  }

  private extendTrail(position: Vec3): void {
    const points = this.trailPoints;
    if (this.trailCount) {
      const at = 3 * (this.trailCount - 1);
      const last: Vec3 = [points[at] ?? 0, points[at + 1] ?? 0, points[at + 2] ?? 0];
      if (norm(subtract(position, last)) < TRAIL_STEP_M) return;
    }
    if (this.trailCount === TRAIL_POINTS) {
      points.copyWithin(0, 3);
      this.trailCount -= 1;
    }
    points.set(position, 3 * this.trailCount);
    this.trailCount += 1;
    this.trail.geometry.setDrawRange(0, this.trailCount);
    const attribute = this.trail.geometry.getAttribute("position");
    attribute.needsUpdate = true;
  }

  private showForce(arm: Arm): void {
    const newtons = arm.wrench ? norm(arm.wrench.force) : 0;
    this.force.visible = newtons > 0.5 && arm.measured !== null && this.shows("force");
    if (!this.force.visible || !arm.wrench || !arm.measured) return;
    this.force.position.set(...arm.measured.position);
    this.force.setDirection(new THREE.Vector3(...arm.wrench.force).normalize());
    this.force.setLength(Math.min(LONGEST_FORCE_M, newtons * FORCE_M_PER_N), 0.04, 0.025);
  }

  private showClearance(arm: Arm): void {
    const clearance = arm.snapshot?.arm?.clearance_m ?? null;
    const pair = arm.snapshot?.arm?.nearest_pair ?? [];
    const near = nearness(clearance, pair, arm.sceneDescription);
    for (const [name, materials] of this.linkMaterials) {
      for (const material of materials) {
        material.color.copy(material.userData["color"] as THREE.Color);
        if (near > 0 && pair.includes(name)) material.color.lerp(warning(near), 0.35 + 0.45 * near);
      }
    }
    this.around.color(near, pair, Boolean(arm.snapshot?.arm?.at_workspace_limit));
  }

  private resize(place: HTMLElement): void {
    const { clientWidth: width, clientHeight: height } = place;
    if (!width || !height) return;
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    // The whole arm stays in narrow pictures, too.
    this.camera.fov = width < height ? 40 * Math.min(1.6, height / width) : 40;
    this.camera.updateProjectionMatrix();
    this.redraw();
  }
}

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** Whether no graphics card draws here. Raises nothing: a browser without WebGL says so later. */
function drawsBySoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const about = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl?.getParameter(about ? about.UNMASKED_RENDERER_WEBGL : gl.RENDERER) as unknown;
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(String(name));
}

/** Below what can be seen: 0.01 mm, 0.0006°. */
function same(a: number, b: number | undefined): boolean {
  return b !== undefined && Math.abs(a - b) < 1e-5;
}

function setJoints(robot: URDFRobot, names: readonly string[], values: readonly number[]): void {
  names.forEach((name, index) => {
    const joint = robot.joints[name];
    if (!joint) return;
    joint.ignoreLimits = true;
    joint.setJointValue(values[index] ?? 0);
  });
}

function translucent(color: number): THREE.MeshLambertMaterial {
  return new THREE.MeshLambertMaterial({
    color: color,
    transparent: true,
    opacity: 0.28,
    depthWrite: false,
    // Where the ghost is as the robot is, the robot is seen.
    polygonOffset: true,
    polygonOffsetFactor: 1,
    polygonOffsetUnits: 1,
  });
}

function axes(length: number): THREE.AxesHelper {
  const helper = new THREE.AxesHelper(length);
  helper.setColors(new THREE.Color(0xe5484d), new THREE.Color(0x30a46c), new THREE.Color(0x3b82f6));
  return helper;
}

function place(object: THREE.Object3D, pose: Pose): void {
  object.position.set(...pose.position);
  object.quaternion.set(...pose.orientation);
}

function poseOf(object: THREE.Object3D): Pose {
  const { x, y, z } = object.position;
  const { x: i, y: j, z: k, w } = object.quaternion;
  return { position: [x, y, z], orientation: [i, j, k, w] };
}
