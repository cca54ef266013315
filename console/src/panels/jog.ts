import { towardsJoints, towardsPose } from "../approach.ts";
import type { Arm } from "../arm.ts";
import { Slider, button, choice, fixed, h, section, setText } from "../dom.ts";
import type { Axes } from "../frames.ts";
import { type Asks, whileHeld } from "../hold.ts";
import { t } from "../i18n.ts";
import type { Motion } from "../motion.ts";
import type { Scene } from "../scene.ts";
import type { Settings } from "../settings.ts";
import {
  DEGREE,
  NOWHERE,
  type Pose,
  type Vec3,
  add,
  fromRotationVector,
  rotate,
  scale,
  times,
} from "../spatial.ts";

/** A step of a turn for each mm of a step, degrees. */
const DEGREES_PER_MM = 0.2;

const AXIS_NAMES = ["X", "Y", "Z", "RX", "RY", "RZ"] as const;

type Mode = "continuous" | "step";

/** Six pairs that move while they are held, and one pair for each joint. */
export class JogPanel {
  readonly element: HTMLElement;
  private readonly joints = h("div", { class: "joint-jogs" });
  private axes: Axes = "base";
  private mode: Mode = "continuous";
  private readonly motion: Motion;
  private readonly arm: () => Arm | null;
  private readonly scene: () => Scene | null;
  private readonly settings: Settings;

  constructor(
    motion: Motion,
    arm: () => Arm | null,
    scene: () => Scene | null,
    settings: Settings,
    keep: () => void,
  ) {
    [this.motion, this.arm, this.scene, this.settings] = [motion, arm, scene, settings];
    const speed = new Slider({
      label: t("speed"),
      min: 1,
      max: 100,
      step: 1,
      value: settings.speed,
      unit: "%",
      digits: 0,
      class: "speed",
      says: (value) => {
        const speed = 1000 * motion.full.linear * (value / 100);
        return `${fixed(speed, speed < 10 ? 1 : 0)} mm/s`;
      },
      change: (value) => {
        settings.speed = value;
        motion.override = value / 100;
        keep();
      },
    });
    motion.override = settings.speed / 100;
    const step = new Slider({
      label: t("step"),
      min: 1,
      max: 50,
      step: 1,
      value: settings.stepMm,
      unit: `mm · ${DEGREES_PER_MM}°`,
      digits: 0,
      change: (value) => {
        settings.stepMm = value;
        keep();
      },
    });
    step.element.hidden = true;
    const axes = choice<Axes>(
      t("axes"),
      [
        ["base", t("base")],
        ["tool", t("tool")],
        ["mixed", t("mixed")],
      ],
      this.axes,
      (value) => {
        this.axes = value;
      },
    );
    const mode = choice<Mode>(
      t("jog"),
      [
        ["continuous", t("continuous")],
        ["step", t("step")],
      ],
      this.mode,
      (value) => {
        this.mode = value;
        step.element.hidden = value === "continuous";
      },
    );
    const pad = (from: number) =>
      h("div", { class: "pairs" }, ...[0, 1, 2].map((each) => this.pair(from + each)));
    this.element = h(
      "div",
      { class: "panel" },
      section(
        "jog",
        h("div", { class: "row" }, axes, mode),
        h("div", { class: "pads" }, pad(0), pad(3)),
        step.element,
        speed.element,
      ),
      section("joints", this.joints),
      this.gripper(),
    );
  }

  private gripper(): HTMLElement {
    const note = h("p", { class: "hint", role: "status" });
    const act = (label: string, code: string) =>
      button(label, () => {
        setText(note, "");
        this.arm()?.ask("act", code).catch((error: Error) => setText(note, error.message));
      });
    return section(
      "gripper",
      h("div", { class: "row" }, act(t("open"), "acog"), act(t("close"), "accg"), act(t("halt"), "acsg")),
      note,
    );
  }

  /** Another arm: other joints. */
  load(): void {
    const names = this.arm()?.joints?.names ?? [];
    this.joints.replaceChildren(
      ...names.map((name, index) => {
        const value = h("output", { class: "number" });
        value.dataset["joint"] = String(index);
        return h(
          "div",
          { class: "joint-jog" },
          this.jointButton(name, index, -1),
          h("div", { class: "joint-name" }, h("span", {}, shorter(name)), value),
          this.jointButton(name, index, 1),
        );
      }),
    );
  }

  refresh(): void {
    const arm = this.arm();
    this.joints.querySelectorAll<HTMLOutputElement>("output").forEach((output) => {
      const index = Number(output.dataset["joint"]);
      const name = arm?.joints?.names[index] ?? "";
      const value = arm?.joints?.positions[index] ?? 0;
      const slides = this.scene()?.limits(name)?.slides;
      output.value = slides ? `${fixed(1000 * value, 1)} mm` : `${fixed(value / DEGREE, 1)}°`;
    });
  }

  private pair(axis: number): HTMLElement {
    const name = AXIS_NAMES[axis] ?? "";
    return h(
      "div",
      { class: "pair", "data-axis": axis % 3 },
      this.button(`${name}−`, (nowMs) => this.asks(axis, -1, nowMs)),
      h("span", { class: "axis", "aria-hidden": "true" }, name),
      this.button(`${name}+`, (nowMs) => this.asks(axis, 1, nowMs)),
    );
  }

  private button(label: string, make: (nowMs: number) => Asks | null): HTMLElement {
    const element = h("button", { type: "button", class: "jog", "aria-label": label });
    element.append(label.endsWith("+") ? "+" : "−");
    whileHeld(
      element,
      () => {
        const asks = make(performance.now());
        return asks !== null && this.motion.press(asks);
      },
      (why) => this.motion.holding.end(why),
      () => this.motion.renew(),
    );
    return element;
  }

  private asks(axis: number, sign: number, _nowMs: number): Asks | null {
    const unit: [number, number, number] = [0, 0, 0];
    unit[axis % 3] = sign;
    const turns = axis >= 3;
    if (this.mode === "step") return this.step(unit, turns);
    return () => {
      const { linear, angular } = this.motion.speeds;
      return {
        kind: "jog twist",
        linear: turns ? NOWHERE : scale(unit, linear),
        angular: turns ? scale(unit, angular) : NOWHERE,
        frame: this.axes,
      };
    };
  }

  /** One step from where the arm is now, along the chosen axes. */
  private step(unit: Vec3, turns: boolean): Asks | null {
    const from = this.arm()?.measured;
    if (!from) return null;
    const inTool = this.axes === "tool" || (this.axes === "mixed" && turns);
    const along = inTool ? rotate(from.orientation, unit) : unit;
    const { stepMm } = this.settings;
    const to: Pose = turns
      ? {
          position: from.position,
          orientation: times(
            fromRotationVector(scale(along, stepMm * DEGREES_PER_MM * DEGREE)),
            from.orientation,
          ),
        }
      : {
          position: add(from.position, scale(along, stepMm / 1000)),
          orientation: from.orientation,
        };
    return () => {
      const here = this.arm()?.measured;
      return here ? towardsPose(here, to, this.motion.speeds) : null;
    };
  }

  private jointButton(name: string, index: number, sign: number): HTMLElement {
    const label = `${shorter(name)} ${sign > 0 ? "+" : "−"}`;
    return this.button(label.trim(), () => {
      const arm = this.arm();
      const joints = arm?.joints;
      if (!joints) return null;
      const speed = this.speed(name);
      if (this.mode === "step") {
        const to = [...joints.positions];
        const slides = this.scene()?.limits(name)?.slides;
        const step = slides
          ? this.settings.stepMm / 1000
          : this.settings.stepMm * DEGREES_PER_MM * DEGREE;
        to[index] = (to[index] ?? 0) + sign * step;
        return () => towardsJoints(arm.joints?.positions ?? to, to, to.map(() => speed()));
      }
      return () => ({
        kind: "jog joints",
        rates: joints.positions.map((_, each) => (each === index ? sign * speed() : 0)),
      });
    });
  }

  private speed(name: string): () => number {
    return () => this.motion.jointSpeed(this.scene()?.limits(name)?.velocity ?? 1);
  }
}

/** A joint's name without the words that all of them have. */
export function shorter(name: string): string {
  return name.replace(/_?joint_?/, " ").replaceAll("_", " ").trim() || name;
}
