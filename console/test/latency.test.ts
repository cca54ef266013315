import assert from "node:assert/strict";
import { test } from "node:test";
import { deviceWay } from "../src/latency.ts";

test("a device on another computer has the figures of its way, others have none", () => {
  const metrics = { delay_s: 0.045, jitter_s: 0.04, loss: 0.012, age_s: 0.0814, late: 0 };
  assert.equal(deviceWay(metrics), "45 ms · 40 ms · 1.2 % · 81 ms");
  assert.equal(deviceWay({ ...metrics, delay_s: null }), "");
  assert.equal(deviceWay({ age_s: 0.01 }), "");
  assert.equal(deviceWay({}), "");
});
