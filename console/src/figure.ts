import * as THREE from "three";
import URDFLoader, { type URDFCollider, type URDFRobot, type URDFVisual } from "urdf-loader";
import { type SceneDescription, solid } from "./scene_description.ts";
import { type Color, parseColor } from "./visuals.ts";

/** What something of a link is painted with; null: it has no color of its own. `flat`: it has no
 * normals. */
export type Paint = (link: string, color: Color | null, flat: boolean) => THREE.Material;

type Shown = { bodies: THREE.Object3D[]; visuals: URDFVisual[] };

/** The robot of a description, each link as it looks or by its bodies: where a part of what it looks
 * like is missing, by its bodies. */
export class Figure {
  readonly robot: URDFRobot;
  private readonly paint: Paint;
  private readonly links = new Map<string, Shown>();
  private readonly standIns: THREE.Object3D[] = [];

  constructor(description: string, paint: Paint) {
    this.paint = paint;
    this.robot = parse(description);
    for (const [name, link] of Object.entries(this.robot.links)) {
      const bodies = link.children.filter((each): each is URDFCollider => "isURDFCollider" in each);
      const visuals = link.children.filter((each): each is URDFVisual => "isURDFVisual" in each);
      const plain = paint(name, null, false);
      for (const each of bodies) cover(each, plain);
      for (const each of visuals) cover(each, paint(name, colorOf(each), false));
      this.links.set(name, { bodies, visuals });
    }
  }

  /** Give the visuals that the description has in a file their mesh. */
  give(file: string, geometry: THREE.BufferGeometry): void {
    for (const [name, { visuals }] of this.links) {
      for (const each of visuals) {
        if (fileOf(each) !== file || each.children.length) continue;
        each.add(new THREE.Mesh(geometry, this.paint(name, colorOf(each), true)));
      }
    }
  }

  /** Where a link's bodies are meshes, show what the session keeps apart in their place; whether there
   * is more to be seen than before. */
  standIn(shapes: SceneDescription["shapes"]): boolean {
    const before = this.standIns.length;
    for (const each of this.standIns) each.removeFromParent();
    for (const shown of this.links.values()) {
      shown.bodies = shown.bodies.filter((each) => !this.standIns.includes(each));
    }
    this.standIns.length = 0;
    for (const each of shapes) {
      const shown = this.links.get(each.name);
      const place = each.joint ? this.robot.joints[each.joint] : this.robot;
      const meshes = this.robot.links[each.name]?.urdfNode?.querySelector("collision > geometry > mesh");
      const mesh = shown && place && meshes ? solid(each, 0, 1) : null;
      if (!mesh) continue;
      mesh.material = this.paint(each.name, null, false);
      place?.add(mesh);
      shown?.bodies.push(mesh);
      this.standIns.push(mesh);
    }
    return this.standIns.length > before;
  }

  /** Show links as they look where `looks`, else all by their bodies; how many are as they look. */
  show(looks: boolean): number {
    let count = 0;
    for (const { bodies, visuals } of this.links.values()) {
      const whole = looks && visuals.length > 0 && visuals.every((each) => each.children.length > 0);
      for (const each of visuals) each.visible = whole;
      for (const each of bodies) each.visible = !whole;
      count += whole ? 1 : 0;
    }
    return count;
  }
}

/** Without the files that it names, meshes and pictures: nothing is asked for by a name of its own. */
function parse(description: string): URDFRobot {
  const read = new DOMParser().parseFromString(description, "text/xml");
  for (const each of read.querySelectorAll("texture, color:not([rgba])")) each.remove();
  for (const each of read.querySelectorAll("visual")) {
    if (!each.querySelector("geometry > *")) each.remove();
  }
  const loader = new URDFLoader();
  loader.parseVisual = true;
  loader.parseCollision = true;
  loader.loadMeshCb = () => {};
  return loader.parse(read);
}

function fileOf(visual: URDFVisual): string | null {
  return visual.urdfNode?.querySelector("geometry > mesh")?.getAttribute("filename") ?? null;
}

/** Its own, or that of the material of its name. */
function colorOf(visual: URDFVisual): Color | null {
  const material = visual.urdfNode?.querySelector("material");
  const name = material?.getAttribute("name");
  const all = [...(visual.urdfNode?.closest("robot")?.querySelectorAll("material") ?? [])];
  const named = name ? all.filter((each) => each.getAttribute("name") === name) : [];
  for (const each of material ? [material, ...named] : []) {
    const color = parseColor(each.querySelector("color")?.getAttribute("rgba"));
    if (color) return color;
  }
  return null;
}

function cover(object: THREE.Object3D, material: THREE.Material): void {
  object.traverse((each) => {
    if (each instanceof THREE.Mesh) each.material = material;
  });
}
