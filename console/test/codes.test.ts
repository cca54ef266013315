import assert from "node:assert/strict";
import { test } from "node:test";
import { Codes } from "../src/codes.ts";

const settled = () => new Promise((resolve) => setImmediate(resolve));

test("a message is shown with its codes once the server has said them", async () => {
  const asked: string[] = [];
  const codes = new Codes((text) => {
    asked.push(text);
    return Promise.resolve(text === "well" ? [] : ["R018", "M002"]);
  });
  assert.equal(codes.shown("stopped"), "stopped");
  assert.equal(codes.shown("stopped"), "stopped");
  await settled();
  assert.equal(codes.shown("stopped"), "stopped [R018, M002]");
  assert.equal(codes.shown("well"), "well");
  await settled();
  assert.equal(codes.shown("well"), "well");
  assert.deepEqual(asked, ["stopped", "well"]);
});

test("a server that does not answer is asked again", async () => {
  let there = false;
  const codes = new Codes(() => (there ? Promise.resolve(["N001"]) : Promise.reject(new Error("lost"))));
  assert.equal(codes.shown("silent"), "silent");
  await settled();
  there = true;
  assert.equal(codes.shown("silent"), "silent");
  await settled();
  assert.equal(codes.shown("silent"), "silent [N001]");
});

test("messages whose numbers change do not fill the memory", async () => {
  let asked = 0;
  const codes = new Codes(() => Promise.resolve([`S${++asked}`]));
  for (let each = 0; each < 101; each += 1) {
    codes.shown(`${each} s`);
    await settled();
  }
  codes.shown("0 s");
  await settled();
  assert.equal(codes.shown("0 s"), "0 s [S102]");
});
