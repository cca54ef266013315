import * as THREE from "three";

/** Of a URDF's <color>, 0 to 1. */
export type Color = { rgb: readonly [number, number, number]; alpha: number };

/** The color of an attribute rgba; null: that is none. */
export function parseColor(rgba: string | null | undefined): Color | null {
  const numbers = (rgba ?? "").trim().split(/\s+/).map(Number);
  const [r, g, b, alpha] = numbers;
  if (numbers.length !== 4 || !numbers.every((each) => each >= 0 && each <= 1)) return null;
  return { rgb: [r ?? 0, g ?? 0, b ?? 0], alpha: alpha ?? 1 };
}

/** A mesh as the server has it: the numbers of corners and of triangles, the corners' coordinates, and
 * the corners of each triangle. It has no normals: it is shaded flat. Raises an Error where the bytes
 * are no such mesh. */
export function parseMesh(data: ArrayBuffer): THREE.BufferGeometry {
  const [corners = 0, triangles = 0] = data.byteLength < 8 ? [] : new Uint32Array(data, 0, 2);
  if (!corners || data.byteLength !== 8 + 12 * (corners + triangles)) throw new Error("no mesh");
  const positions = new Float32Array(data, 8, 3 * corners);
  const indices = new Uint32Array(data, 8 + 12 * corners, 3 * triangles);
  if (indices.some((each) => each >= corners)) throw new Error("a triangle without a corner");
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
  geometry.setIndex(new THREE.BufferAttribute(indices, 1));
  return geometry;
}

/** Gets meshes from the server, which has them for who has its token. */
export class Meshes {
  private readonly headers: Record<string, string>;
  private readonly known = new Map<string, Promise<THREE.BufferGeometry | null>>();

  constructor(token: string) {
    this.headers = token ? { Authorization: `Bearer ${token}` } : {};
  }

  /** The mesh of a key; null: the server has it not, or what came is none. */
  get(key: string): Promise<THREE.BufferGeometry | null> {
    let found = this.known.get(key);
    if (!found) {
      found = this.fetch(key).catch(() => null);
      this.known.set(key, found);
    }
    return found;
  }

  /** Draw none of them any more. */
  clear(): void {
    for (const each of this.known.values()) void each.then((geometry) => geometry?.dispose());
    this.known.clear();
  }

  private async fetch(key: string): Promise<THREE.BufferGeometry> {
    const answer = await fetch(`/visuals/${encodeURIComponent(key)}`, { headers: this.headers });
    if (!answer.ok) throw new Error(answer.statusText);
    return parseMesh(await answer.arrayBuffer());
  }
}
