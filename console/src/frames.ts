import type { Quat, Vec3 } from "./spatial.ts";

/** Operator frames: docs/phone.md. */
export const VERSION = 0xc1;
export const MAX_JOINTS = 16;

export const AXES = ["base", "tool", "mixed"] as const;
/** Whose axes a twist is along; mixed: linear those of the base, angular those of the tool. */
export type Axes = (typeof AXES)[number];

export type Body =
  | { kind: "jog twist"; linear: Vec3; angular: Vec3; frame: Axes }
  | { kind: "jog joints"; rates: readonly number[] }
  | {
      kind: "phone";
      /** alpha, beta, gamma; null: no sensor, or not allowed. */
      anglesDeg: Vec3 | null;
      dragRight: number;
      dragUp: number;
      ratesRadS: Vec3 | null;
      accelerationMS2: Vec3 | null;
      buttons: number;
      screenQuarters: number;
      /** Which reference the angles are in: all that the page has had are counted. */
      reference: number;
    }
  | {
      kind: "xr";
      part: XrPart;
      positionM: Vec3;
      orientation: Quat;
      buttons: number;
      stickRight: number;
      stickDown: number;
      trigger: number;
      squeeze: number;
      /** Which reference the pose is in: sessions and resets of them are counted. */
      reference: number;
    }
  | {
      kind: "gamepad";
      /** Left stick right and down, right stick right and down. */
      sticks: readonly [number, number, number, number];
      leftTrigger: number;
      rightTrigger: number;
      buttons: number;
    };

const XR_KINDS = { left: 4, right: 5, viewer: 6 } as const;
export type XrPart = keyof typeof XR_KINDS;

export type Frame = {
  body: Body;
  hold: boolean;
  tracking: boolean;
  visible: boolean;
  channel: number;
  sequence: number;
  timeUs: number;
};

const HEADER = 16;

/** A frame as bytes. */
export function encodeFrame(frame: Frame): Uint8Array<ArrayBuffer> {
  const { body } = frame;
  const view = new DataView(new ArrayBuffer(HEADER + sizeOf(body)));
  view.setUint8(0, VERSION);
  view.setUint8(1, kindOf(body));
  view.setUint8(2, (frame.hold ? 1 : 0) | (frame.tracking ? 2 : 0) | (frame.visible ? 4 : 0));
  view.setUint8(3, frame.channel);
  view.setUint32(4, frame.sequence >>> 0, true);
  view.setBigUint64(8, BigInt(Math.max(0, Math.floor(frame.timeUs))), true);
  write(view, body);
  return new Uint8Array(view.buffer);
}

function kindOf(body: Body): number {
  if (body.kind === "xr") return XR_KINDS[body.part];
  return { "jog twist": 1, "jog joints": 2, phone: 3, gamepad: 7 }[body.kind];
}

function sizeOf(body: Body): number {
  if (body.kind === "jog joints") return 4 + 4 * body.rates.length;
  return { "jog twist": 28, phone: 48, xr: 48, gamepad: 28 }[body.kind];
}

const MISSING = [NaN, NaN, NaN];

function write(view: DataView, body: Body): void {
  const floats = (at: number, ...values: readonly number[]) =>
    values.forEach((value, index) => view.setFloat32(at + 4 * index, value, true));
  switch (body.kind) {
    case "jog twist":
      view.setUint8(HEADER, AXES.indexOf(body.frame));
      floats(HEADER + 4, ...body.linear, ...body.angular);
      break;
    case "jog joints":
      view.setUint8(HEADER, body.rates.length);
      floats(HEADER + 4, ...body.rates);
      break;
    case "phone":
      floats(HEADER, ...(body.anglesDeg ?? MISSING), body.dragRight, body.dragUp);
      floats(HEADER + 20, ...(body.ratesRadS ?? MISSING), ...(body.accelerationMS2 ?? MISSING));
      view.setUint16(HEADER + 44, body.buttons, true);
      view.setUint8(HEADER + 46, body.screenQuarters);
      view.setUint8(HEADER + 47, body.reference & 0xff);
      break;
    case "xr":
      floats(HEADER, ...body.positionM, ...body.orientation);
      view.setUint16(HEADER + 28, body.buttons, true);
      view.setUint8(HEADER + 30, body.reference & 0xff);
      floats(HEADER + 32, body.stickRight, body.stickDown, body.trigger, body.squeeze);
      break;
    case "gamepad":
      floats(HEADER, ...body.sticks, body.leftTrigger, body.rightTrigger);
      view.setUint32(HEADER + 24, body.buttons, true);
  }
}
