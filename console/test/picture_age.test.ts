import assert from "node:assert/strict";
import { test } from "node:test";
import { freshness, PictureAges } from "../src/picture_age.ts";

/** Announced by a server whose clock this page does not know: the page's word, sent at `askedMs`,
 * was heard `thereMs` later and held for `heldMs`, and the answer was `backMs` on its way. */
function age(ages: PictureAges, askedMs: number, thereMs: number, heldMs: number, backMs: number, ageMs = 0): number {
  const nowMs = askedMs + thereMs + heldMs + backMs;
  const announced = { picture: 1, age_us: 1000 * ageMs, page_us: 1000 * askedMs, held_us: 1000 * heldMs };
  return nowMs - ages.hadMs(announced, nowMs);
}

test("a picture is as old as it was when it was sent, and half of a round trip", () => {
  const ages = new PictureAges();
  assert.equal(age(ages, 1000, 20, 7, 20, 33), 53);
  assert.equal(age(ages, 2000, 20, 900, 20, 5), 25);
});

test("what stood still on its way is as old as that", () => {
  const ages = new PictureAges();
  age(ages, 0, 20, 0, 20);
  assert.equal(age(ages, 1000, 20, 0, 1020), 1020);
  // Nor is it younger where what stood still was this page's word.
  assert.equal(age(ages, 3000, 1020, 0, 20), 1020);
});

test("no clock makes a picture younger than when it was sent, nor one that is forgotten", () => {
  const ages = new PictureAges();
  assert.equal(age(ages, 1000, 0, 50, -70, 10), 10);
  for (let each = 0; each < 32; each++) age(ages, 2000 + each, 40, 0, 40);
  assert.equal(age(ages, 9000, 40, 0, 40), 40);
});

test("two are on their way where it is long, and the link is not slow", () => {
  const ages = new PictureAges();
  age(ages, 0, 60, 0, 60);
  assert.equal(ages.two(20), true);
  assert.equal(ages.two(200), false);
  age(ages, 1000, 10, 0, 10);
  assert.equal(ages.two(1), false);
});

test("an old picture is marked, and later counts as none", () => {
  const at = [0, 499, 500, 1999, 2000, Number.NaN];
  assert.deepEqual(at.map(freshness), ["fresh", "fresh", "old", "old", "gone", "gone"]);
});
