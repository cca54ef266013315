import assert from "node:assert/strict";
import { test } from "node:test";
import { between, shortened, spread } from "../src/histogram.ts";
import { HISTORY_S, Recording } from "../src/recording.ts";
import { Span } from "../src/span.ts";

test("a recording keeps the last minutes, and is a table", () => {
  const recording = new Recording(["a", 'b "c"']);
  for (let second = 0; second < 1000; second += 1) recording.add(second, [second, null]);
  assert.equal(recording.newest, 999);
  const oldest = recording.oldest ?? NaN;
  assert.ok(oldest <= 999 - HISTORY_S && oldest >= 999 - HISTORY_S - 11, String(oldest));
  const [times, first] = recording.data();
  assert.equal(times.length, first?.length);
  assert.equal(first?.at(-1), 999);
  const [head, row] = recording.csv().split("\n");
  assert.equal(head, 'time_s,"a","b ""c"""');
  assert.equal(row, `${oldest}.000,${oldest},`);
});

test("a recording stands while its time does, and begins anew where it goes back", () => {
  const recording = new Recording(["a"]);
  for (const time of [1, 2, 2, 3]) recording.add(time, [time]);
  assert.deepEqual(recording.data()[0], [1, 2, 3]);
  recording.add(1.5, [7]);
  assert.deepEqual(recording.data(), [[1.5], [7]]);
});

test("a plot follows the newest, or stands where it was put", () => {
  const span = new Span(60, 1, 300);
  assert.deepEqual(span.range(100), [40, 100]);
  span.zoom(0.5, 70);
  assert.deepEqual(span.range(100), [70, 100]);
  assert.equal(span.stands, false);
  span.hold(100);
  assert.deepEqual(span.range(500), [70, 100]);
  span.zoom(2, 85);
  assert.deepEqual(span.range(500), [55, 115]);
  span.show(80, 80.1);
  assert.deepEqual(span.range(500), [79.55, 80.55]);
  span.show(0, 1000);
  assert.equal(span.lengthS, 300);
  span.follow();
  assert.deepEqual(span.range(500), [440, 500]);
  span.shift(-1000, 300, 500);
  assert.deepEqual(span.range(500), [300, 360]);
  span.shift(1000, 300, 500);
  assert.deepEqual(span.range(600), [440, 500]);
});

test("counts are between neighbors, and what is beyond the last bound is seen", () => {
  assert.deepEqual(between([3, 5, 5], 9), [3, 2, 0, 4]);
  assert.deepEqual(between([], 0), [0]);
  assert.deepEqual(spread([1, 5, 7, 400], [2, 6, 10]), [1, 1, 1, 1]);
  assert.equal(shortened(9999), "9999");
  assert.equal(shortened(123456), "123k");
  assert.equal(shortened(2_500_000), "2.5M");
});
