import { NEAR, type Speeds, seconds } from "./approach.ts";
import type { Arm } from "./arm.ts";
import { t } from "./i18n.ts";
import type { Scene } from "./scene.ts";
import { type Pose, inverse, norm, rotationVector, subtract, times } from "./spatial.ts";

export type Way = "linear" | "free";

/** A joint that is farther from where a line ends is so on another branch: the arm turned over. */
const TURNED_OVER_RAD = 1.6;

/** Changes of the goal within so long are looked at once. */
const SETTLES_MS = 120;

/** Where the arm is wanted, and whether it can get there. Nothing of it moves the arm. */
export class Goal {
  pose: Pose | null = null;
  /** At the goal; null: not known yet, or not reachable. */
  joints: number[] | null = null;
  /** Why it cannot be reached; empty: it can, or that is being looked at. */
  refusal = "";
  looking = false;
  way: Way = "linear";
  onChange: () => void = () => {};
  private readonly arm: Arm;
  private readonly scene: Scene | null;
  private version = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;

  constructor(arm: Arm, scene: Scene | null) {
    this.arm = arm;
    this.scene = scene;
  }

  get sendable(): boolean {
    return this.pose !== null && this.joints !== null && !this.refusal && !this.looking;
  }

  clear(): void {
    this.pose = null;
    this.joints = null;
    this.refusal = "";
    this.looking = false;
    this.version += 1;
    this.changed();
  }

  setWay(way: Way): void {
    this.way = way;
    if (this.pose) this.look(this.joints);
  }

  /** Wanted by joints: the pose follows from them. */
  setJoints(joints: number[]): void {
    const pose = this.scene?.forward(this.arm, joints) ?? null;
    if (!pose) return;
    this.pose = pose;
    this.look(joints);
  }

  setPose(pose: Pose): void {
    this.pose = pose;
    this.look(null);
  }

  /** Look whether it can be reached; `joints` are those at the goal, where they are known. */
  private look(joints: number[] | null): void {
    this.looking = true;
    this.refusal = "";
    if (joints) this.joints = joints;
    const version = ++this.version;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.ask(version, joints), SETTLES_MS);
    this.changed();
  }

  private async ask(version: number, joints: number[] | null): Promise<void> {
    const { pose, arm } = this;
    if (!pose) return;
    let found: number[] | null = null;
    let refusal = "";
    try {
      const nearest = await arm.inverse(pose);
      found = joints ?? nearest;
      if (this.way === "free") refusal = await arm.rehearse(found);
      else if (turnedOver(nearest, found)) refusal = t("branch");
      else refusal = await arm.rehearse(pose);
    } catch (error) {
      refusal = (error as Error).message.replace(/^inv: /, "");
    }
    if (version !== this.version) return;
    this.looking = false;
    this.refusal = refusal;
    if (found) this.joints = found;
    else if (!joints) this.joints = null;
    this.changed();
  }

  /** The arm has come to rest: the way to the goal is another one. */
  rested(): void {
    if (this.pose) this.look(this.joints);
  }

  private changed(): void {
    const ok = this.refusal === "";
    this.scene?.showGoal(this.arm.joints?.names ?? [], this.joints, this.pose, ok);
    this.onChange();
  }
}

function turnedOver(a: readonly number[], b: readonly number[]): boolean {
  return a.some((each, index) => Math.abs((b[index] ?? each) - each) > TURNED_OVER_RAD);
}

/** How long a line takes, s. */
export function lineSeconds(from: Pose, to: Pose, speeds: Speeds): number {
  const turn = norm(rotationVector(times(to.orientation, inverse(from.orientation))));
  const way = norm(subtract(to.position, from.position));
  return Math.max(seconds(way, speeds.linear, NEAR.m), seconds(turn, speeds.angular, NEAR.rad));
}

/** How long a motion by joints takes, s, and the index of the joint that takes longest. */
export function jointSeconds(
  from: readonly number[],
  to: readonly number[],
  fastest: readonly number[],
): { seconds: number; slowest: number } {
  const each = to.map((goal, index) => {
    const way = Math.abs(goal - (from[index] ?? goal));
    return seconds(way, fastest[index] ?? 0, NEAR.rad);
  });
  const longest = Math.max(0, ...each);
  return { seconds: longest, slowest: each.indexOf(longest) };
}
