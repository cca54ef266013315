import assert from "node:assert/strict";
import { test } from "node:test";
import { type Unit, about, span } from "../src/panels/programs.ts";

const SESSION: Unit = {
  name: "gofa",
  kind: "session",
  state: "running",
  since_s: 40,
  reason: "",
  why: "no state was heard",
  phase: "no robot",
  authority: "device",
};

test("a session says what it does and why not", () => {
  assert.equal(about(SESSION), "session · running 40 s · no robot · Authority: device · no state was heard");
  const failed = { ...SESSION, state: "failed", reason: "it ended with status 3", since_s: 400 };
  assert.equal(about(failed), "session · failed 7 min · it ended with status 3");
});

test("a server says where it serves", () => {
  const server = { name: "page", kind: "server", state: "running", since_s: 9000, reason: "" };
  assert.equal(
    about({ ...server, server: "console", endpoint: "https://a:8443" }),
    "server console · running 3 h · https://a:8443",
  );
  assert.equal(span(0.4), "0 s");
});
