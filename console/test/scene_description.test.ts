import assert from "node:assert/strict";
import { test } from "node:test";
import * as THREE from "three";
import { Around, type Heard, type SceneDescription, nearness, walls } from "../src/scene_description.ts";

const AROUND: SceneDescription = {
  workspace_m: [[-0.5, 0.5], null, [0, 0.8]],
  obstacles: [
    { name: "table", box: { position: [0.6, 0, -0.05], orientation: [0, 0, 0, 1], size_m: [0.8, 1, 0.1] } },
    { name: "pole", capsule: { start: [0.4, 0, 0], end: [0.4, 0, 0.6], radius_m: 0.05 } },
    { name: "ball", capsule: { start: [0, 0, 1], end: [0, 0, 1], radius_m: 0.1 } },
    { name: "floor", plane: { normal: [0, 0, 1], offset_m: -0.2 } },
  ],
  shapes: [],
  obstacle_m: 0.02,
  own_body_m: 0.005,
  home: null,
};

test("how near something is counts from the distance that is kept", () => {
  const near = (clearance: number | null) => nearness(clearance, ["table", "wrist"], AROUND);
  assert.equal(near(null), 0);
  assert.equal(near(0.2), 0);
  assert.equal(near(0.02), 1);
  assert.equal(near(-0.1), 1);
  assert.ok(Math.abs(near(0.04) - 0.5) < 1e-9);
  // Its own bodies may be nearer.
  assert.equal(nearness(0.02, ["forearm", "wrist"], AROUND), 0);
  assert.equal(nearness(0.005, ["forearm", "wrist"], AROUND), 1);
});

test("a workspace without walls is none, and open sides are far away", () => {
  assert.equal(walls([null, null, null], 1), null);
  assert.deepEqual(walls(AROUND.workspace_m, 2), { low: [-0.5, -2, 0], high: [0.5, 2, 0.8] });
});

test("obstacles stand where they are, and what is near is colored", () => {
  const around = new Around();
  around.load(AROUND, null, 1);
  const [table, pole, ball, floor] = around.obstacles.children;
  assert.deepEqual(table?.position.toArray(), [0.6, 0, -0.05]);
  assert.deepEqual(pole?.position.toArray(), [0.4, 0, 0.3]);
  assert.deepEqual(ball?.position.toArray(), [0, 0, 1]);
  assert.equal(floor?.position.z, -0.2);
  const color = () => ({ ...(table as unknown as { material: { color: object } }).material.color });
  const far = color();
  around.color(0, ["table", "wrist"], false);
  assert.deepEqual(color(), far);
  around.color(0.7, ["forearm", "wrist"], true);
  assert.deepEqual(color(), far);
  around.color(0.7, ["table", "wrist"], false);
  assert.notDeepEqual(color(), far);
  around.load({ ...AROUND, obstacles: [], workspace_m: [null, null, null] }, null, 1);
  assert.equal(around.obstacles.children.length + around.workspace.children.length, 0);
});

const FLAT = [0, 0, 0, 1] as const;

const NEIGHBOR: SceneDescription = {
  ...AROUND,
  neighbors: [
    {
      name: "right",
      topic: "/right/joint_states",
      max_age_s: 0.15,
      base: { position: [1, 0, 0], orientation: [0, 0, 1, 0] },
      joints: [
        { name: "lift", position: [0, 0, 0.2], orientation: [...FLAT], axis: [0, 0, 1], slides: true },
        { name: "pan", position: [0.1, 0, 0], orientation: [...FLAT], axis: [0, 0, 1], slides: false },
      ],
      shapes: [
        { name: "right's foot", joint: "", capsule: { start: [0, 0, 0], end: [0, 0, 0], radius_m: 0.1 } },
        { name: "right's hand", joint: "pan", capsule: { start: [0.3, 0, 0], end: [0.3, 0, 0], radius_m: 0.05 } },
      ],
    },
  ],
};

test("a neighbor is where its joints have it, and gray once that is old", () => {
  const around = new Around();
  around.load(NEIGHBOR, null, 1);
  const heard = new Map<string, Heard>();
  const [root] = around.neighbors.children;
  assert.ok(root);
  around.follow(heard, 0);
  assert.equal(root.visible, false);
  heard.set("right", { joints: new Map([["pan", Math.PI / 2], ["lift", 0.5], ["other", 3]]), ms: 1000 });
  const meshes: THREE.Mesh[] = [];
  around.neighbors.traverse((each) => { if (each instanceof THREE.Mesh) meshes.push(each); });
  const colors = () => {
    around.color(0, [], false);
    return meshes.map((each) => (each.material as THREE.MeshLambertMaterial).color.getHex());
  };
  around.follow(heard, 1100);
  const young = colors();
  assert.equal(root.visible, true);
  around.neighbors.updateMatrixWorld(true);
  const places = meshes.map((each) => each.getWorldPosition(new THREE.Vector3()).toArray());
  const expected = [[0.9, -0.3, 0.7], [1, 0, 0]]; // The hand, the foot.
  expected.forEach((at, index) => {
    at.forEach((value, axis) => assert.ok(Math.abs((places[index]?.[axis] ?? NaN) - value) < 1e-9));
  });
  around.follow(heard, 1151);
  const old = colors();
  old.forEach((each, index) => assert.notEqual(each, young[index]));
  around.follow(heard, 1150);
  assert.deepEqual(colors(), young);
  // It is kept as far away as obstacles are.
  const pair = ["right's hand", "wrist"];
  assert.equal(nearness(0.02, pair, NEIGHBOR), 1);
  assert.equal(nearness(0.02, pair, AROUND), 0);
  around.load(AROUND, null, 1);
  assert.equal(around.neighbors.children.length, 0);
});
