import { towardsJoints, towardsPose } from "../approach.ts";
import type { Arm } from "../arm.ts";
import { Slider, button, choice, fixed, h, section, setText } from "../dom.ts";
import { type Goal, type Way, jointSeconds, lineSeconds } from "../goal.ts";
import { whileHeld } from "../hold.ts";
import { t } from "../i18n.ts";
import type { Motion } from "../motion.ts";
import type { Scene } from "../scene.ts";
import { LONGEST_NAME, type Named, type Settings, parseNamed } from "../settings.ts";
import { DEGREE, type Pose, type Vec3, fromRpy, toRpy } from "../spatial.ts";
import { shorter } from "./jog.ts";
import { save } from "../chart.ts";

const AXES = ["X", "Y", "Z", "Roll", "Pitch", "Yaw"] as const;

/** Of the sliders where neither the arm's range nor walls are known. */
const UNKNOWN_M = [-1.5, 1.5];

/** A goal by sliders, gizmo or name; what is known of the way; and the control that goes there. */
export class GoalPanel {
  readonly element: HTMLElement;
  private goal: Goal | null = null;
  private arm: Arm | null = null;
  private joints: Slider[] = [];
  private cartesian: Slider[] = [];
  private readonly jointsPlace = h("div");
  private readonly cartesianPlace = h("div");
  private readonly verdict = h("p", { class: "verdict", role: "status" });
  private readonly send = h("button", { type: "button", class: "send" }, t("send"));
  private readonly homeButton = button(t("home"), () => this.home(), { title: t("homeHelp") });
  private readonly namedPlace = h("ul", { class: "named" });
  private readonly motion: Motion;
  private readonly scene: () => Scene | null;
  private readonly settings: Settings;
  private readonly keep: () => void;

  constructor(motion: Motion, scene: () => Scene | null, settings: Settings, keep: () => void) {
    [this.motion, this.scene, this.settings, this.keep] = [motion, scene, settings, keep];
    const way = choice<Way>(
      t("way"),
      [
        ["linear", t("linear")],
        ["free", t("free")],
      ],
      "linear",
      (value) => this.goal?.setWay(value),
    );
    whileHeld(
      this.send,
      () => this.begin(),
      (why) => motion.holding.end(why),
      () => motion.renew(),
    );
    const file = h("input", { type: "file", accept: ".json,application/json", hidden: true });
    file.addEventListener("change", () => void this.importNamed(file, note));
    const name = h("input", { type: "text", maxlength: LONGEST_NAME, placeholder: t("name"), "aria-label": t("name") });
    const note = h("span", { class: "hint", role: "status" });
    this.element = h(
      "div",
      { class: "panel" },
      section(
        "goal",
        way,
        this.verdict,
        this.send,
        h(
          "div",
          { class: "row" },
          button(t("toMeasured"), () => this.fromRobot()),
          this.homeButton,
          button(t("clear"), () => this.goal?.clear()),
        ),
      ),
      section("pose", this.cartesianPlace),
      section("joints", this.jointsPlace),
      section(
        "named",
        h(
          "div",
          { class: "row" },
          name,
          button(t("save"), () => {
            this.saveNamed(name.value.trim());
            name.value = "";
          }),
          button(t("copy"), () => void this.copy(note)),
        ),
        note,
        this.namedPlace,
        h(
          "div",
          { class: "row" },
          button(t("exportPoses"), () => this.exportNamed(), { class: "quiet" }),
          button(t("importPoses"), () => file.click(), { class: "quiet" }),
          file,
        ),
      ),
    );
  }

  load(arm: Arm, goal: Goal): void {
    [this.arm, this.goal] = [arm, goal];
    goal.onChange = () => this.refresh(true);
    this.joints = (arm.joints?.names ?? []).map((name, index) => {
      const limits = this.scene()?.limits(name);
      const unit = limits?.slides ? 0.001 : DEGREE;
      return new Slider({
        label: shorter(name),
        min: Math.ceil((limits?.lower ?? -Math.PI) / unit),
        max: Math.floor((limits?.upper ?? Math.PI) / unit),
        step: 0.1,
        value: (arm.joints?.positions[index] ?? 0) / unit,
        unit: limits?.slides ? "mm" : "°",
        digits: 1,
        ends: true,
        change: (value) => {
          const joints = [...(goal.joints ?? arm.joints?.positions ?? [])];
          joints[index] = value * unit;
          goal.setJoints(joints);
        },
      });
    });
    this.jointsPlace.replaceChildren(...this.joints.map((each) => each.element));
    this.surround();
  }

  /** What is around the arm is known, or another: walls of the workspace, home. */
  surround(): void {
    this.cartesian = AXES.map((label, index) => {
      const turns = index >= 3;
      const around = this.arm?.sceneDescription;
      const range = around?.workspace_m[index] ?? around?.reach_m?.[index] ?? UNKNOWN_M;
      const [low, high] = turns ? [-180, 180] : range.map((each) => 1000 * each);
      return new Slider({
        label,
        min: Math.ceil(low ?? 0),
        max: Math.floor(high ?? 0),
        step: turns ? 0.1 : 1,
        value: 0,
        unit: turns ? "°" : "mm",
        digits: 1,
        ends: true,
        change: (value) => this.setAxis(index, value),
      });
    });
    this.cartesianPlace.replaceChildren(...this.cartesian.map((each) => each.element));
    this.showNamed();
    this.refresh(true);
  }

  /** Show what is measured, and where a goal is set, the goal. */
  refresh(goalChanged = false): void {
    const { arm, goal } = this;
    if (!arm || !goal) return;
    const measured = arm.joints?.positions ?? [];
    this.joints.forEach((slider, index) => {
      const unit = this.scene()?.limits(arm.joints?.names[index] ?? "")?.slides ? 0.001 : DEGREE;
      slider.setMeasured((measured[index] ?? 0) / unit);
      if (goalChanged || !goal.pose) {
        slider.set(((goal.joints ?? measured)[index] ?? 0) / unit);
      }
    });
    const here = shown(arm.measured);
    const wanted = shown(goal.pose ?? arm.measured);
    this.cartesian.forEach((slider, index) => {
      slider.setMeasured(here[index] ?? 0);
      if (goalChanged || !goal.pose) slider.set(wanted[index] ?? 0);
    });
    this.showVerdict();
  }

  private showVerdict(): void {
    const { goal } = this;
    if (!goal) return;
    const [kind, text] = this.judged(goal);
    setText(this.verdict, text);
    this.verdict.dataset["kind"] = kind;
    this.send.disabled = !goal.sendable || !this.motion.holding.armed;
  }

  private judged(goal: Goal): [string, string] {
    if (!goal.pose) return ["none", t("noGoal")];
    if (goal.refusal) return ["bad", `${t("unreachable")}: ${goal.refusal}`];
    if (goal.looking) return ["none", t("looking")];
    return ["ok", `${t("reachable")} · ${t("takes")} ${this.duration(goal)}`];
  }

  private duration(goal: Goal): string {
    const { arm } = this;
    if (!arm?.joints || !arm.measured || !goal.joints || !goal.pose) return "";
    if (goal.way === "linear") {
      return `${lineSeconds(arm.measured, goal.pose, this.motion.speeds).toFixed(1)} s`;
    }
    const found = jointSeconds(arm.joints.positions, goal.joints, this.jointSpeeds(arm));
    const slowest = shorter(arm.joints.names[found.slowest] ?? "");
    return `${found.seconds.toFixed(1)} s (${t("slowest")}: ${slowest})`;
  }

  private jointSpeeds(arm: Arm): number[] {
    return (arm.joints?.names ?? []).map((name) =>
      this.motion.jointSpeed(this.scene()?.limits(name)?.velocity ?? 1),
    );
  }

  private begin(): boolean {
    const { arm, goal } = this;
    if (!arm || !goal?.sendable || !goal.pose || !goal.joints) return false;
    const [pose, joints] = [goal.pose, [...goal.joints]];
    if (goal.way === "linear") {
      return this.motion.press(() =>
        arm.measured ? towardsPose(arm.measured, pose, this.motion.speeds) : null,
      );
    }
    return this.motion.press(() =>
      arm.joints ? towardsJoints(arm.joints.positions, joints, this.jointSpeeds(arm)) : null,
    );
  }

  private setAxis(index: number, value: number): void {
    const from = this.goal?.pose ?? this.arm?.measured;
    if (!from || !this.goal) return;
    const numbers = shown(from);
    numbers[index] = value;
    const [x = 0, y = 0, z = 0, roll = 0, pitch = 0, yaw = 0] = numbers;
    const turned = index >= 3;
    this.goal.setPose({
      position: [x / 1000, y / 1000, z / 1000],
      orientation: turned
        ? fromRpy([roll * DEGREE, pitch * DEGREE, yaw * DEGREE])
        : from.orientation,
    });
  }

  private fromRobot(): void {
    if (this.arm?.joints) this.goal?.setJoints([...this.arm.joints.positions]);
  }

  /** A pose that is saved by that name, or the arm's own. */
  private homeJoints(): readonly number[] | null {
    const own = this.named().find((each) => each.name === HOME);
    return own?.joints ?? this.arm?.sceneDescription?.home ?? null;
  }

  private home(): void {
    const joints = this.homeJoints();
    if (joints) this.goal?.setJoints([...joints]);
  }

  private async copy(note: HTMLElement): Promise<void> {
    const numbers = shown(this.goal?.pose ?? this.arm?.measured ?? null);
    const text = numbers.map((each) => fixed(each, 2)).join(", ");
    try {
      await navigator.clipboard.writeText(text);
      setText(note, `${t("copied")}: ${text}`);
    } catch {
      setText(note, text);
    }
  }

  private named(): Named[] {
    return this.settings.named[this.arm?.name ?? ""] ?? [];
  }

  private saveNamed(name: string): void {
    const joints = this.goal?.joints ?? this.arm?.joints?.positions;
    if (!name || !joints || !this.arm) return;
    const others = this.named().filter((each) => each.name !== name);
    this.settings.named[this.arm.name] = [...others, { name, joints: [...joints] }];
    this.keep();
    this.showNamed();
  }

  private exportNamed(): void {
    const text = JSON.stringify(this.named(), null, 1);
    save(new Blob([text], { type: "application/json" }), "cardan-poses.json");
  }

  private async importNamed(file: HTMLInputElement, note: HTMLElement): Promise<void> {
    const text = await file.files?.[0]?.text();
    file.value = "";
    const { arm } = this;
    if (text === undefined || !arm?.joints) return;
    try {
      const found = parseNamed(text, arm.joints.names.length);
      const names = new Set(found.map((each) => each.name));
      const others = this.named().filter((each) => !names.has(each.name));
      this.settings.named[arm.name] = [...others, ...found];
      this.keep();
      this.showNamed();
      setText(note, "");
    } catch (error) {
      setText(note, (error as Error).message);
    }
  }

  private showNamed(): void {
    this.homeButton.disabled = this.homeJoints() === null;
    this.namedPlace.replaceChildren(
      ...this.named().map((each) =>
        h(
          "li",
          {},
          button(each.name, () => this.goal?.setJoints([...each.joints])),
          button("×", () => this.removeNamed(each.name), {
            "aria-label": `${t("remove")} ${each.name}`,
            class: "quiet",
          }),
        ),
      ),
    );
  }

  private removeNamed(name: string): void {
    if (!this.arm) return;
    this.settings.named[this.arm.name] = this.named().filter((each) => each.name !== name);
    this.keep();
    this.showNamed();
  }
}

/** The named pose that the button for home means. */
const HOME = "home";

/** A pose as people read it: mm, and roll, pitch and yaw in degrees. */
export function shown(pose: Pose | null): number[] {
  if (!pose) return [0, 0, 0, 0, 0, 0];
  const turn: Vec3 = toRpy(pose.orientation);
  return [...pose.position.map((each) => 1000 * each), ...turn.map((each) => each / DEGREE)];
}
