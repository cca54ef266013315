import assert from "node:assert/strict";
import { test } from "node:test";
import type { Link } from "../src/link.ts";
import { clock, size } from "../src/panels/records.ts";
import { type About, RecordSource, Replay, armsOf } from "../src/replay.ts";
import type { Message } from "../src/rosbridge.ts";

const ABOUT: About = {
  duration_s: 12,
  began_s: 0,
  cut_off: "",
  topics: {
    "/left/arm/state/pose": ["geometry_msgs/msg/PoseStamped", 9],
    "/left/arm/state/snapshot": ["std_msgs/msg/String", 9],
    "/right/arm/state/status": ["cardan_msgs/msg/ArmStatus", 9],
    "/tf_static": ["tf2_msgs/msg/TFMessage", 1],
  },
};

/** A link that keeps what is told to it. */
function fakeLink() {
  const told: Message[] = [];
  const link = {
    told,
    onReplay: (_said: Message) => {},
    tell: (op: string, fields: Message) => told.push({ op, ...fields }) > 0,
  };
  return link as typeof link & Link;
}

test("the arms of a record are those that published a state", () => {
  assert.deepEqual(armsOf(ABOUT), ["/left/arm", "/right/arm"]);
});

test("an arm hears a record as it hears the bus, and cannot be asked for anything", async () => {
  const source = new RecordSource();
  const heard: Message[] = [];
  const end = source.bridge.subscribe("/a", "x", (message) => heard.push(message));
  source.deliver([["/a", { data: 1 }], ["/b", { data: 2 }]]);
  assert.deepEqual(source.topics, ["/a"]);
  end();
  source.deliver([["/a", { data: 3 }]]);
  assert.deepEqual(heard, [{ data: 1 }]);
  assert.deepEqual(source.topics, []);
  const older: Message[] = [];
  source.bridge.subscribe("/a/scene", "x", (message) => older.push(message));
  assert.deepEqual(source.topics, ["/a/scene", "/a/surroundings"]);
  source.deliver([["/a/surroundings", { data: 2 }]]);
  assert.deepEqual(older, [{ data: 2 }]);
  await assert.rejects(source.bridge.call(), /nothing moves/);
});

test("a record is opened, followed, and ends with words", () => {
  const link = fakeLink();
  const replay = new Replay(link);
  replay.show("one.mcap");
  assert.deepEqual(link.told.at(-1), { op: "cardan.replay", do: "open", name: "one.mcap" });
  link.onReplay({ about: ABOUT });
  assert.equal(replay.arm?.name, "/left/arm");
  const order = link.told.find((each) => each["do"] === "order") ?? {};
  assert.ok((order["topics"] as string[]).includes("/left/arm/state/snapshot"));
  const joints = { name: ["j1"], position: [0.5], velocity: [0] };
  link.onReplay({ at_s: 3, playing: true, rate: 2, messages: [["/left/joint_states", joints]] });
  assert.deepEqual([replay.atS, replay.playing, replay.rate], [3, true, 2]);
  assert.deepEqual(replay.arm?.joints?.positions, [0.5]);
  link.onReplay({ over: "the connection was lost" });
  assert.equal(replay.open, false);
  assert.equal(replay.over, "the connection was lost");
  replay.close();
  assert.equal(replay.over, "");
});

test("a bar that is dragged gives few orders, of which the newest counts", async () => {
  const link = fakeLink();
  const replay = new Replay(link);
  replay.show("one.mcap");
  const before = link.told.length;
  for (let at = 0; at < 100; at += 1) replay.seek(at / 10);
  assert.equal(link.told.length, before + 1);
  await new Promise((resolve) => setTimeout(resolve, 200));
  assert.equal(link.told.length, before + 2);
  assert.equal(link.told.at(-1)?.["at_s"], 9.9);
});

test("sizes and times are told as people read them", () => {
  assert.deepEqual([0, 999, 1500, 25_000_000].map(size), ["0 B", "999 B", "1.5 kB", "25 MB"]);
  assert.deepEqual([0, 59.96, 61.23].map(clock), ["0:00.0", "1:00.0", "1:01.2"]);
});
