import assert from "node:assert/strict";
import { test } from "node:test";
import { towardsJoints, towardsPose } from "../src/approach.ts";
import { jointSeconds, lineSeconds } from "../src/goal.ts";
import {
  type Pose,
  type Vec3,
  add,
  fromRotationVector,
  fromRpy,
  inverse,
  norm,
  rotationVector,
  scale,
  subtract,
  times,
  toRpy,
} from "../src/spatial.ts";

const FROM: Pose = { position: [0.4, 0.1, 0.3], orientation: fromRpy([3, 0.2, -1]) };
const TO: Pose = { position: [0.5, -0.1, 0.25], orientation: fromRpy([2.6, 0.1, -0.4]) };

/** The pose so far along the straight line, turning about one axis. */
function between(from: Pose, to: Pose, share: number): Pose {
  const turn = rotationVector(times(to.orientation, inverse(from.orientation)));
  return {
    position: add(from.position, scale(subtract(to.position, from.position), share)),
    orientation: times(fromRotationVector(scale(turn, share)), from.orientation),
  };
}

const SPEEDS = { linear: 0.1, angular: 0.4 };
const STEP_S = 0.02;

test("a held line goes straight, slows down, arrives, and takes as long as was said", () => {
  let here = FROM;
  let seconds = 0;
  let largest = 0;
  const way = norm(subtract(TO.position, FROM.position));
  for (;;) {
    const body = towardsPose(here, TO, SPEEDS);
    if (!body) break;
    assert.ok(body.kind === "jog twist" && seconds < 30);
    assert.ok(norm(body.linear) <= SPEEDS.linear + 1e-9 && norm(body.angular) <= SPEEDS.angular + 1e-9);
    const turn = fromRotationVector(scale(body.angular, STEP_S));
    here = {
      position: add(here.position, scale(body.linear, STEP_S)),
      orientation: times(turn, here.orientation),
    };
    const share = norm(subtract(here.position, FROM.position)) / way;
    largest = Math.max(largest, norm(subtract(here.position, between(FROM, TO, share).position)));
    seconds += STEP_S;
  }
  assert.ok(largest < 1e-6, `${largest} m beside the line`);
  const angle = norm(rotationVector(times(TO.orientation, inverse(here.orientation))));
  assert.ok(angle < 0.0011);
  const said = lineSeconds(FROM, TO, SPEEDS);
  assert.ok(Math.abs(said - seconds) < 0.35 * seconds, `said ${said} s, took ${seconds} s`);
});

test("joints arrive together, none faster than it may", () => {
  const [from, to, fastest] = [[0, -1, 2, 0.5], [0.5, -1.2, 2, -0.4], [0.3, 0.3, 0.3, 0.2]];
  let here = [...from];
  let seconds = 0;
  for (;;) {
    const body = towardsJoints(here, to, fastest);
    if (!body) break;
    assert.ok(body.kind === "jog joints" && seconds < 30);
    body.rates.forEach((rate, index) => assert.ok(Math.abs(rate) <= (fastest[index] ?? 0) + 1e-9));
    const shares = here.map((each, index) => (each - (from[index] ?? 0)) / ((to[index] ?? 0) - (from[index] ?? 0)));
    assert.ok(Math.abs((shares[0] ?? 0) - (shares[3] ?? 0)) < 1e-6);
    here = here.map((each, index) => each + (body.rates[index] ?? 0) * STEP_S);
    seconds += STEP_S;
  }
  const said = jointSeconds(from, to, fastest);
  assert.equal(said.slowest, 3);
  assert.ok(Math.abs(said.seconds - seconds) < 0.2 * seconds, `said ${said.seconds}, took ${seconds}`);
});

test("a page that stands still for as long as an arm goes on does not lead it past its goal", () => {
  for (const far of [0.001, 0.005, 0.0125, 0.02, 0.04, 0.2]) {
    const from: Pose = { position: [0.4, 0.1, 0.3 - far], orientation: TO.orientation };
    const to: Pose = { position: [0.4, 0.1, 0.3], orientation: TO.orientation };
    const body = towardsPose(from, to, SPEEDS);
    assert.ok(body?.kind === "jog twist" && norm(body.linear) * 0.4 <= far + 1e-9);
    const joints = towardsJoints([0], [10 * far], [0.4]);
    assert.ok(joints?.kind === "jog joints" && (joints.rates[0] ?? 0) * 0.4 <= 10 * far + 1e-9);
  }
});

test("who is there asks for nothing", () => {
  assert.equal(towardsPose(TO, TO, SPEEDS), null);
  assert.equal(towardsJoints([1, 2], [1, 2], [1, 1]), null);
});

test("roll, pitch and yaw go both ways", () => {
  const angles: Vec3 = [0.3, -0.7, 2.1];
  toRpy(fromRpy(angles)).forEach((each, index) => assert.ok(Math.abs(each - (angles[index] ?? 0)) < 1e-12));
});
