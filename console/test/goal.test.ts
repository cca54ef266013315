import assert from "node:assert/strict";
import { test } from "node:test";
import type { Arm } from "../src/arm.ts";
import { Goal } from "../src/goal.ts";
import type { Scene } from "../src/scene.ts";
import type { Pose } from "../src/spatial.ts";

const POSE: Pose = { position: [0.4, 0, 0.3], orientation: [0, 0, 0, 1] };
const HERE = [0, 0, 0];

/** A goal of an arm that answers `refusal`, and what the arm was asked for. */
function goalOf(refusal: string, nearest: number[] | Error = HERE) {
  const asked: unknown[] = [];
  const arm = {
    joints: { names: ["a", "b", "c"], positions: HERE, velocities: HERE },
    measured: POSE,
    inverse: () => (nearest instanceof Error ? Promise.reject(nearest) : Promise.resolve(nearest)),
    rehearse: (way: unknown) => {
      asked.push(way);
      return Promise.resolve(refusal);
    },
  } as unknown as Arm;
  const scene = { forward: () => POSE, showGoal: () => {} } as unknown as Scene;
  return { goal: new Goal(arm, scene), asked };
}

/** Until the arm has answered. */
async function looked(goal: Goal): Promise<void> {
  while (goal.looking) await new Promise((resolve) => setTimeout(resolve, 5));
}

test("a line is rehearsed by its pose, a free way by its joints", async () => {
  const { goal, asked } = goalOf("");
  goal.setPose(POSE);
  assert.equal(goal.sendable, false);
  await looked(goal);
  assert.deepEqual([goal.sendable, goal.joints, asked.pop()], [true, HERE, POSE]);
  goal.setWay("free");
  await looked(goal);
  assert.deepEqual([goal.sendable, asked.pop()], [true, HERE]);
});

test("what stops it is told, and nothing is sent there", async () => {
  const { goal } = goalOf("the line passes a singularity");
  goal.setPose(POSE);
  await looked(goal);
  assert.deepEqual([goal.sendable, goal.refusal], [false, "the line passes a singularity"]);
  const far = goalOf("", new Error("inv: the pose is out of reach by 300.0 mm and 0.000 rad"));
  far.goal.setPose(POSE);
  await looked(far.goal);
  assert.equal(far.goal.refusal, "the pose is out of reach by 300.0 mm and 0.000 rad");
  assert.deepEqual([far.goal.sendable, far.asked.length], [false, 0]);
});

test("a line to joints of another branch is none", async () => {
  const { goal, asked } = goalOf("");
  goal.setJoints([0, 3, 0]);
  await looked(goal);
  assert.match(goal.refusal, /go free/);
  goal.setWay("free");
  await looked(goal);
  assert.deepEqual([goal.sendable, asked], [true, [[0, 3, 0]]]);
});

test("it is looked at anew when the arm has come to rest, and the newest question counts", async () => {
  const { goal, asked } = goalOf("");
  goal.rested();
  assert.equal(goal.looking, false);
  goal.setPose(POSE);
  await looked(goal);
  goal.rested();
  goal.rested();
  await looked(goal);
  assert.equal(asked.length, 2);
  goal.clear();
  assert.deepEqual([goal.pose, goal.sendable], [null, false]);
});
