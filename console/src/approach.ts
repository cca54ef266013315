import type { Body } from "./frames.ts";
import { type Pose, type Vec3, inverse, norm, rotationVector, scale, subtract, times } from "./spatial.ts";

/** Speeds with which a held control goes to a goal: it slows down before it, and arrives. */
export type Speeds = { linear: number; angular: number };

/** Where it counts as arrived: below what the speeds of a few cycles can resolve. */
const NEAR_M = 0.0003;
const NEAR_RAD = 0.001;

/** The longest that an arm goes on by what was asked for: age of the command, silence until it
 * brakes, and braking. */
const LATEST_S = 0.4;

/** Of the remaining way per second, near the goal: a page that stands still, or whose arm is seen
 * late, leads it up to its goal at most, never past it. */
const GAIN_1_S = 1 / LATEST_S;

/** The speed at a distance from the goal, at most `fastest`. */
function slowing(distance: number, fastest: number): number {
  return Math.min(fastest, GAIN_1_S * distance);
}

/** Twist along the base's axes that goes straight from one pose to another, both parts arriving
 * together; null: it is there. */
export function towardsPose(from: Pose, to: Pose, speeds: Speeds): Body | null {
  const way = subtract(to.position, from.position);
  const turn = rotationVector(times(to.orientation, inverse(from.orientation)));
  const [distance, angle] = [norm(way), norm(turn)];
  if (distance < NEAR_M && angle < NEAR_RAD) return null;
  const takes = Math.max(
    distance / Math.max(1e-9, slowing(distance, speeds.linear)),
    angle / Math.max(1e-9, slowing(angle, speeds.angular)),
  );
  const linear: Vec3 = scale(way, 1 / takes);
  return { kind: "jog twist", linear, angular: scale(turn, 1 / takes), frame: "base" };
}

/** Joint speeds from some joints to others, all arriving together; null: they are there. */
export function towardsJoints(
  from: readonly number[],
  to: readonly number[],
  fastest: readonly number[],
): Body | null {
  const ways = to.map((each, index) => each - (from[index] ?? each));
  if (ways.every((way) => Math.abs(way) < NEAR_RAD)) return null;
  const takes = Math.max(
    ...ways.map((way, index) => {
      const speed = slowing(Math.abs(way), fastest[index] ?? 0);
      return way === 0 ? 0 : Math.abs(way) / Math.max(1e-9, speed);
    }),
  );
  return { kind: "jog joints", rates: ways.map((way) => way / takes) };
}

/** How long a way takes that slows down as `slowing` does, s. */
export function seconds(distance: number, fastest: number, near: number): number {
  if (distance <= near || fastest <= 0) return 0;
  const slow = fastest / GAIN_1_S;
  const last = Math.min(distance, slow);
  return (distance - last) / fastest + Math.log(last / Math.min(near, last)) / GAIN_1_S;
}

export const NEAR = { m: NEAR_M, rad: NEAR_RAD };
