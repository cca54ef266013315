import assert from "node:assert/strict";
import { test } from "node:test";
import { Stops } from "../src/stops.ts";

test("what was counted before the page came is nobody's", () => {
  const stops = new Stops();
  assert.equal(stops.heard(7), "no");
  assert.equal(stops.heard(7), "no");
});

test("own stops are told from those of others", () => {
  const stops = new Stops();
  stops.heard(0);
  stops.asked();
  assert.equal(stops.heard(1), "own");
  assert.equal(stops.heard(2), "other");
  stops.asked();
  assert.equal(stops.heard(4), "other");
  assert.equal(stops.heard(5), "other");
});

test("a failed stop is taken back: the next foreign one is not shown as one's own", () => {
  const stops = new Stops();
  stops.heard(0);
  stops.asked();
  stops.failed();
  assert.equal(stops.heard(1), "other");
});

test("a stop that failed and yet is counted disarms", () => {
  const stops = new Stops();
  stops.heard(0);
  stops.asked();
  assert.equal(stops.heard(1), "own");
  stops.failed();
  stops.asked();
  stops.failed();
  assert.equal(stops.heard(2), "other");
});

test("a session that was started anew disarms", () => {
  const stops = new Stops();
  stops.heard(3);
  assert.equal(stops.heard(0), "other");
  assert.equal(stops.heard(0), "no");
});
