import assert from "node:assert/strict";
import { test } from "node:test";
import { ASKED_MS, GRACE_MS, Lease } from "../src/lease.ts";

const [US, THEM] = ["console us", "console them"];

test("who is asked sees who asks, until it has answered or has it no more", () => {
  const lease = new Lease();
  const asks = { source: THEM, owner: US, answer: "" };
  lease.heard({ ...asks, owner: "console third" }, US, 0);
  assert.equal(lease.requester, "");
  lease.heard(asks, US, 0);
  lease.look(US, US, 100);
  assert.equal(lease.requester, THEM);
  lease.answered();
  assert.equal(lease.requester, "");
  lease.heard(asks, US, 200);
  lease.look(THEM, US, 300);
  assert.equal(lease.requester, "");
  lease.heard(asks, US, 400);
  lease.look(US, US, 401 + ASKED_MS);
  assert.equal(lease.requester, "");
});

test("who asks learns what became of it", () => {
  const lease = new Lease();
  lease.heard({ source: US, owner: THEM, answer: "refused" }, US, 0);
  assert.equal(lease.asked, "");
  lease.ask(0);
  lease.look(THEM, US, 10);
  assert.equal(lease.asked, "waiting");
  lease.heard({ source: "console third", owner: THEM, answer: "refused" }, US, 15);
  assert.equal(lease.asked, "waiting");
  lease.heard({ source: US, owner: THEM, answer: "refused" }, US, 20);
  assert.equal(lease.asked, "refused");
  lease.look(THEM, US, 21 + ASKED_MS);
  assert.equal(lease.asked, "");
  lease.ask(100_000);
  lease.look(THEM, US, 100_001 + ASKED_MS);
  assert.equal(lease.asked, "silent");
});

test("who was handed it has it for a while, and not longer", () => {
  const lease = new Lease();
  lease.look(US, US, 0);
  assert.equal(lease.isNew(0), false);
  lease.ask(0);
  lease.look(US, US, 50);
  assert.equal(lease.asked, "given");
  assert.equal(lease.isNew(51), true);
  assert.equal(lease.isNew(51 + GRACE_MS), false);
  lease.settle();
  assert.equal(lease.isNew(52), false);
});
