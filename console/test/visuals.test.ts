import assert from "node:assert/strict";
import { test } from "node:test";
import { Meshes, parseColor, parseMesh } from "../src/visuals.ts";

/** One triangle more than corners allow where `last` says so. */
function bytes(last = 2): ArrayBuffer {
  const data = new ArrayBuffer(8 + 36 + 12);
  new Uint32Array(data, 0, 2).set([3, 1]);
  new Float32Array(data, 8, 9).set([0, 0, 0, 1, 0, 0, 0, 2, 0]);
  new Uint32Array(data, 44, 3).set([0, 1, last]);
  return data;
}

test("a mesh is what came, without a copy", () => {
  const data = bytes();
  const geometry = parseMesh(data);
  const positions = geometry.getAttribute("position");
  assert.deepEqual([...positions.array], [0, 0, 0, 1, 0, 0, 0, 2, 0]);
  assert.equal(positions.array.buffer, data);
  assert.deepEqual([...(geometry.getIndex()?.array ?? [])], [0, 1, 2]);
});

test("what is no mesh is none", () => {
  for (const size of [0, 4, 8, 44, 55]) assert.throws(() => parseMesh(bytes().slice(0, size)));
  assert.throws(() => parseMesh(bytes(3)));
  const many = bytes();
  new Uint32Array(many, 0, 2).set([0xffffffff, 0xffffffff]);
  assert.throws(() => parseMesh(many));
});

test("a color is one of four shares", () => {
  assert.deepEqual(parseColor(" 0.5  0 1 0.25\n"), { rgb: [0.5, 0, 1], alpha: 0.25 });
  for (const none of [null, undefined, "", "1 1 1", "1 1 1 1 1", "1 x 1 1", "2 0 0 1", "-1 0 0 1"]) {
    assert.equal(parseColor(none), null);
  }
});

test("a mesh is asked for once, with the token, until none is drawn any more", async (context) => {
  const asked: unknown[][] = [];
  context.mock.method(globalThis, "fetch", async (...given: unknown[]) => {
    asked.push(given);
    return new Response(bytes());
  });
  const meshes = new Meshes("secret");
  assert.equal(await meshes.get("a/b"), await meshes.get("a/b"));
  assert.deepEqual(asked, [["/visuals/a%2Fb", { headers: { Authorization: "Bearer secret" } }]]);
  meshes.clear();
  assert.ok(await meshes.get("a/b"));
  assert.equal(asked.length, 2);
});

test("one that the server has not is none", async (context) => {
  context.mock.method(globalThis, "fetch", async () => new Response("", { status: 404 }));
  assert.equal(await new Meshes("").get("a"), null);
  context.mock.method(globalThis, "fetch", () => Promise.reject(new Error("gone")));
  assert.equal(await new Meshes("").get("a"), null);
});
