import type { Body } from "./frames.ts";
import { FRAME_MS } from "./hold.ts";
import { DEGREE, type Vec3 } from "./spatial.ts";

/** Longest wait for the first angles after they were allowed. */
const FIRST_ANGLES_MS = 1500;

/** Sensors that said nothing for so long are lost: browsers tell of them 50 to 60 times a second,
 * also where the values are equal. */
const SILENT_MS = 150;

/** Bits of a phone's buttons. */
export const BUTTONS = { a: 1, b: 2, align: 4 } as const;

type Permitted = { requestPermission?: () => Promise<string> };

/** The phone's sensors, from a person's tap on. */
export class PhoneSensors {
  private angles: Vec3 | null = null;
  private rates: Vec3 | null = null;
  private acceleration: Vec3 | null = null;
  private turnedMs = -Infinity;
  private movedMs = -Infinity;
  private dragRight = 0;
  private dragUp = 0;
  /** Browsers may begin the heading anew with each listener. */
  private reference = 0;
  buttons = 0;

  /** Whether the sensors have spoken. */
  get speaks(): boolean {
    return this.angles !== null;
  }

  /** Ask for the permission and listen; called in a click. False: no sensor, or not allowed. */
  async start(): Promise<boolean> {
    for (const kind of ["DeviceOrientationEvent", "DeviceMotionEvent"] as const) {
      const event = (window as unknown as Record<string, Permitted | undefined>)[kind];
      if (!event) return false;
      if (event.requestPermission && (await event.requestPermission()) !== "granted") return false;
    }
    this.reference += 1;
    window.addEventListener("deviceorientation", this.turned);
    window.addEventListener("devicemotion", this.moved);
    const until = performance.now() + FIRST_ANGLES_MS;
    while (!this.speaks && performance.now() < until) {
      await new Promise((resolve) => setTimeout(resolve, FRAME_MS));
    }
    return this.speaks;
  }

  stop(): void {
    window.removeEventListener("deviceorientation", this.turned);
    window.removeEventListener("devicemotion", this.moved);
    this.angles = this.rates = this.acceleration = null;
    this.letGo();
  }

  /** The second finger, in thirds of the screen's shorter side from where it was put down. */
  drag(right: number, up: number): void {
    [this.dragRight, this.dragUp] = [right, up];
  }

  letGo(): void {
    this.drag(0, 0);
    this.buttons = 0;
  }

  /** The phone's state at `nowMs` of `performance.now()`; null in it: not measured, or silent. */
  body(nowMs = performance.now()): Body {
    const moves = nowMs - this.movedMs <= SILENT_MS;
    return {
      kind: "phone",
      anglesDeg: nowMs - this.turnedMs <= SILENT_MS ? this.angles : null,
      dragRight: this.dragRight,
      dragUp: this.dragUp,
      ratesRadS: moves ? this.rates : null,
      accelerationMS2: moves ? this.acceleration : null,
      buttons: this.buttons,
      screenQuarters: Math.round((screen.orientation?.angle ?? 0) / 90) % 4,
      reference: this.reference,
    };
  }

  private readonly turned = (event: DeviceOrientationEvent): void => {
    const { alpha, beta, gamma } = event;
    this.turnedMs = performance.now();
    // Null is "no sensor, or not allowed", never zero.
    this.angles = alpha === null || beta === null || gamma === null ? null : [alpha, beta, gamma];
  };

  private readonly moved = (event: DeviceMotionEvent): void => {
    const turning = event.rotationRate;
    this.movedMs = performance.now();
    // Of this event alpha is about x, beta about y, gamma about z.
    this.rates =
      turning && turning.alpha !== null && turning.beta !== null && turning.gamma !== null
        ? [turning.alpha * DEGREE, turning.beta * DEGREE, turning.gamma * DEGREE]
        : null;
    const force = event.accelerationIncludingGravity;
    this.acceleration =
      force && force.x !== null && force.y !== null && force.z !== null
        ? [force.x, force.y, force.z]
        : null;
  };
}
