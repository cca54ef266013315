import assert from "node:assert/strict";
import { test } from "node:test";
import type { Snapshot, Status } from "../src/arm.ts";
import { RoundTrips, quality } from "../src/latency.ts";
import { type Facts, why } from "../src/why.ts";

const STATUS: Status = {
  phase: "disarmed",
  message: "",
  authority: "",
  ready: true,
  moving: false,
  lead_used: 0,
  limits: [],
};
const ARM = {
  message: "",
  authority_s: null,
  stops: 0,
  stopped_by: "",
  at_workspace_limit: false,
  clearance_m: null,
  nearest_pair: [],
  limits_in_words: [],
  path_speed: null,
};
const SNAPSHOT: Snapshot = {
  finished: false,
  error: "",
  diagnosis: [],
  arm: ARM,
  robot: { hold_reason: "" },
};
const FACTS: Facts = {
  link: "live",
  hasToken: true,
  chosen: true,
  stateAgeMs: 20,
  roundTripMs: 5,
  role: "operator",
  source: "console 1",
  asked: "",
  armed: true,
  held: false,
  leftS: null,
  ended: "",
  stoppedBy: "",
  refused: "",
  snapshot: SNAPSHOT,
  status: STATUS,
};

const says = (facts: Partial<Facts>) => why({ ...FACTS, ...facts });
const status = (some: Partial<Status>) => ({ status: { ...STATUS, ...some } });

test("the nearest cause comes first", () => {
  assert.match(says({ link: "lost", stateAgeMs: 1e6 }).text, /connection to the server is lost/);
  assert.match(says({ stateAgeMs: 2000, refused: "no" }).text, /silent/);
  assert.match(says(status({ ready: false, message: "the brakes are on" })).text, /not ready: the brakes are on/);
  assert.equal(says({ refused: "twist: device has the authority" }).text, "twist: device has the authority");
  const late = "twst: select twist streaming first (parameter streamingCommand; ROS 2: preset_streaming_cmd): the stream was silent for 0.101 s";
  assert.match(says({ refused: late }).text, /came too late/);
  assert.match(says({ roundTripMs: 400 }).text, /too long.*400 ms/);
  assert.match(says({ ended: "hidden", armed: false }).text, /hidden: enable again/);
  const stopped = { ended: "stopped", armed: false } as const;
  assert.match(says({ ...stopped, stoppedBy: "console 2" }).text, /stopped: enable again \(console 2\)$/);
  assert.match(says({ ...stopped, stoppedBy: "" }).text, /stopped: enable again$/);
  assert.match(says(status({ authority: "device" })).text, /^device has the authority/);
  assert.match(says({ asked: "given", armed: false }).text, /handed to you: enable/);
  assert.equal(says({ held: true, ...status({ limits: ["collision"] }) }).text, "Limited by collision");
  assert.match(says({ role: "viewer" }).text, /watch only/);
  assert.match(says({ armed: false }).text, /Enable motion/);
  const told = { ...SNAPSHOT, diagnosis: ["the controller has begun 2 sessions"] };
  assert.equal(says({ armed: false, snapshot: told }).text, "At rest. Enable motion to move it.");
  assert.equal(says({}).level, "ok");
});

test("the end of a hold is announced before it comes", () => {
  const held = { held: true, status: { ...STATUS, moving: true } };
  assert.match(says({ ...held, leftS: 3.2 }).text, /Move the finger a little, .* ends in 4 s/);
  assert.doesNotMatch(says({ ...held, leftS: 8 }).text, /ends in/);
});

test("a motion says who moves and what limits it", () => {
  const moving = status({ moving: true, authority: "console 1", limits: ["elbow_joint"] });
  const told = says({ ...moving, snapshot: { ...SNAPSHOT, arm: { ...ARM, path_speed: 0.4 } } });
  assert.equal(told.level, "warn");
  assert.equal(told.text, "Moving (you) · Limited by elbow_joint · slowed to 40 %");
});

test("a session of another version, whose snapshot lacks parts, is shown as well", () => {
  const other = { phase: "holding", diagnosis: [], hold_reason: "" } as Snapshot;
  assert.equal(says({ armed: false, snapshot: other }).text, "At rest. Enable motion to move it.");
  assert.match(says({ ...status({ moving: true }), snapshot: other }).text, /^Moving/);
});

test("one late answer is none of a slow link", () => {
  const trips = new RoundTrips();
  for (const each of [4, 5, 900, 6, 4]) trips.add(each);
  assert.equal(trips.recent, 5);
  assert.equal(trips.worst, 900);
  for (let each = 0; each < 200; each += 1) trips.add(7);
  assert.equal(trips.all.length, 100);
  assert.equal(trips.worst, 7);
  assert.equal(quality(7, 10), "good");
  assert.equal(quality(7, 2000), "bad");
  assert.equal(quality(null, 10), "none");
});
