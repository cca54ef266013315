import assert from "node:assert/strict";
import { test } from "node:test";
import { Around, type Surroundings, nearness, walls } from "../src/surroundings.ts";

const AROUND: Surroundings = {
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

test("obstacles stand where they are, and what is near is coloured", () => {
  const around = new Around();
  around.load(AROUND, null, 1);
  const [table, pole, ball, floor] = around.obstacles.children;
  assert.deepEqual(table?.position.toArray(), [0.6, 0, -0.05]);
  assert.deepEqual(pole?.position.toArray(), [0.4, 0, 0.3]);
  assert.deepEqual(ball?.position.toArray(), [0, 0, 1]);
  assert.equal(floor?.position.z, -0.2);
  const colour = () => ({ ...(table as unknown as { material: { color: object } }).material.color });
  const far = colour();
  around.colour(0, ["table", "wrist"], false);
  assert.deepEqual(colour(), far);
  around.colour(0.7, ["forearm", "wrist"], true);
  assert.deepEqual(colour(), far);
  around.colour(0.7, ["table", "wrist"], false);
  assert.notDeepEqual(colour(), far);
  around.load({ ...AROUND, obstacles: [], workspace_m: [null, null, null] }, null, 1);
  assert.equal(around.obstacles.children.length + around.workspace.children.length, 0);
});
