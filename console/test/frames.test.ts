import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { AXES, type Axes, type Body, type XrPart, encodeFrame } from "../src/frames.ts";
import type { Quat, Vec3 } from "../src/spatial.ts";

// The same table judges the server's codec.
const VECTORS = JSON.parse(
  readFileSync("../tests/protocols/handheld_vectors.json", "utf8"),
) as Vectors;

type Xyzw = { w: number; x: number; y: number; z: number };
type Vectors = {
  frames: { name: string; bytes: string; frame: Record<string, unknown> & { body: TheirBody } }[];
};
type TheirBody = Record<string, never> & { linear?: Vec3 };

const quat = ({ x, y, z, w }: Xyzw): Quat => [x, y, z, w];

function bodyOf(kind: string, theirs: Record<string, unknown>): Body {
  const number = (key: string) => Number(theirs[key] ?? 0);
  const triple = (key: string) => (theirs[key] as Vec3 | null) ?? null;
  if (kind === "jog twist") {
    const frame = theirs["frame"] as Axes;
    assert.ok(AXES.includes(frame));
    return { kind, linear: theirs["linear"] as Vec3, angular: theirs["angular"] as Vec3, frame };
  }
  if (kind === "jog joints") return { kind, rates: theirs["rates"] as number[] };
  if (kind === "phone") {
    return {
      kind,
      anglesDeg: triple("angles_deg"),
      dragRight: number("drag_right"),
      dragUp: number("drag_up"),
      ratesRadS: triple("rates_rad_s"),
      accelerationMS2: triple("acceleration_m_s2"),
      buttons: number("buttons"),
      screenQuarters: number("screen_quarters"),
      reference: number("reference"),
    };
  }
  if (kind === "xr") {
    return {
      kind,
      part: String(theirs["part"]) as XrPart,
      positionM: theirs["position_m"] as Vec3,
      orientation: quat(theirs["orientation"] as Xyzw),
      buttons: number("buttons"),
      stickRight: number("stick_right"),
      stickDown: number("stick_down"),
      trigger: number("trigger"),
      squeeze: number("squeeze"),
      reference: number("reference"),
    };
  }
  assert.equal(kind, "gamepad");
  return {
    kind: "gamepad",
    sticks: [number("left_right"), number("left_down"), number("right_right"), number("right_down")],
    leftTrigger: number("left_trigger"),
    rightTrigger: number("right_trigger"),
    buttons: number("buttons"),
  };
}

test("frames are the bytes that the server reads", () => {
  assert.ok(VECTORS.frames.length > 5);
  for (const { name, bytes, frame } of VECTORS.frames) {
    const made = encodeFrame({
      body: bodyOf(String(frame["kind"]), frame.body),
      hold: Boolean(frame["hold"]),
      tracking: Boolean(frame["tracking"]),
      visible: Boolean(frame["visible"]),
      channel: Number(frame["channel"]),
      sequence: Number(frame["sequence"]),
      timeUs: Number(frame["time_us"]),
    });
    assert.equal(Buffer.from(made).toString("hex"), bytes, name);
  }
});
