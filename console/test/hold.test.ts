import assert from "node:assert/strict";
import { test } from "node:test";
import type { Body } from "../src/frames.ts";
import { type End, FRAME_MS, Holding, IDLE_MS, STALL_MS } from "../src/hold.ts";

const JOG: Body = { kind: "jog twist", linear: [0.1, 0, 0], angular: [0, 0, 0], frame: "tool" };
const asks = () => JOG;

function armed(): Holding {
  const holding = new Holding();
  holding.arm(0);
  assert.equal(holding.tick(0)?.hold, false);
  return holding;
}

function held(): Holding {
  const holding = armed();
  assert.ok(holding.press(asks, 1));
  return holding;
}

test("nothing is sent before re-arming", () => {
  const holding = new Holding();
  assert.equal(holding.press(asks, 0), false);
  for (let now = 0; now < 1000; now += FRAME_MS) assert.equal(holding.tick(now), null);
});

test("who goes away leaves the arm to others", () => {
  const holding = held();
  let now = FRAME_MS;
  for (; now < IDLE_MS + 1000; now += 100) assert.equal(holding.tick(now)?.hold, true);
  holding.end("released");
  for (const end = now + IDLE_MS; now < end; now += 100) holding.tick(now);
  assert.equal(holding.armed, true);
  holding.tick(now + 200);
  assert.equal(holding.armed, false);
  assert.equal(holding.ended, "idle");
});

test("every frame of a hold says so again", () => {
  const holding = held();
  for (let now = FRAME_MS; now < 1000; now += FRAME_MS) {
    assert.deepEqual(holding.tick(now), { body: JOG, hold: true });
  }
});

test("every end of a hold sends zero at once, and nothing begins it but a press", () => {
  const ends: End[] = ["released", "canceled", "left", "chord", "moved", "blur", "refused"];
  for (const why of ends) {
    const holding = held();
    holding.tick(FRAME_MS);
    holding.end(why);
    const last = holding.tick(2 * FRAME_MS);
    assert.equal(last?.hold, false, why);
    assert.deepEqual(last?.body, { ...JOG, linear: [0, 0, 0] });
    for (let now = 3 * FRAME_MS; now < 1000; now += FRAME_MS) {
      assert.notEqual(holding.tick(now)?.hold, true);
    }
    assert.equal(holding.ended, why);
    assert.ok(holding.armed, why);
    assert.ok(holding.press(asks, 1000));
  }
});

test("a loss disarms: re-arm to go on", () => {
  const ends: End[] = ["hidden", "closed", "slow", "stopped", "stalled"];
  for (const why of ends) {
    const holding = held();
    holding.end(why);
    assert.equal(holding.armed, false, why);
    assert.equal(holding.press(asks, 100), false, why);
    holding.arm(200);
    assert.ok(holding.press(asks, 220), why);
  }
});

test("a page that stood still does not go on with what was held", () => {
  const holding = held();
  holding.tick(FRAME_MS);
  const late = holding.tick(FRAME_MS + STALL_MS + 1);
  assert.equal(late?.hold, false);
  assert.equal(holding.ended, "stalled");
  assert.equal(holding.armed, false);
});

test("one control moves at a time", () => {
  const holding = held();
  assert.equal(holding.press(() => null, 5), false);
  assert.deepEqual(holding.tick(FRAME_MS)?.body, JOG);
});

test("a control that has arrived holds no more", () => {
  const holding = armed();
  let left = 3;
  holding.press(() => (left-- > 0 ? JOG : null), 0);
  const sent = [1, 2, 3, 4].map((frame) => holding.tick(frame * FRAME_MS)?.hold);
  assert.deepEqual(sent, [true, true, true, false]);
  assert.equal(holding.ended, "arrived");
  assert.ok(holding.armed);
});

test("an armed page at rest says now and then that the hand is free", () => {
  const holding = armed();
  let count = 0;
  for (let now = FRAME_MS; now <= 1000; now += FRAME_MS) count += holding.tick(now) ? 1 : 0;
  assert.ok(count >= 4 && count <= 6, `${count}`);
});
