import assert from "node:assert/strict";
import { test } from "node:test";
import { parseNamed } from "../src/settings.ts";

test("poses of a file are those of an arm with as many joints, or none are taken", () => {
  const poses = [
    { name: "home", joints: [0, 1, 2] },
    { name: "above", joints: [0.5, -1, 2] },
  ];
  assert.deepEqual(parseNamed(JSON.stringify(poses), 3), poses);
  assert.deepEqual(parseNamed("[]", 3), []);
  const bad: unknown[] = [
    {},
    [null],
    [{ name: "", joints: [0, 1, 2] }],
    [{ name: "x".repeat(41), joints: [0, 1, 2] }],
    [{ name: "a", joints: [0, 1] }],
    [{ name: "a", joints: [0, 1, "2"] }],
    [{ name: "a", joints: [0, 1, null] }],
    [poses[0], { name: "b" }],
  ];
  for (const each of bad) assert.throws(() => parseNamed(JSON.stringify(each), 3), /no poses.* 3$/);
  assert.throws(() => parseNamed("no json", 3), /no poses/);
});
