export type Vec3 = readonly [number, number, number];
/** x y z w, as three.js has it. */
export type Quat = readonly [number, number, number, number];

export const NOWHERE: Vec3 = [0, 0, 0];

/** Position, m, and orientation, in the base. */
export type Pose = { readonly position: Vec3; readonly orientation: Quat };

export const add = (a: Vec3, b: Vec3): Vec3 => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const subtract = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const scale = (a: Vec3, by: number): Vec3 => [a[0] * by, a[1] * by, a[2] * by];
export const norm = (a: readonly number[]): number => Math.hypot(...a);

/** Product a·b: first b, then a. */
export function times(a: Quat, b: Quat): Quat {
  const [ax, ay, az, aw] = a;
  const [bx, by, bz, bw] = b;
  return [
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
    aw * bw - ax * bx - ay * by - az * bz,
  ];
}

export const inverse = ([x, y, z, w]: Quat): Quat => [-x, -y, -z, w];

export function rotate(q: Quat, v: Vec3): Vec3 {
  const [x, y, z] = times(times(q, [v[0], v[1], v[2], 0]), inverse(q));
  return [x, y, z];
}

/** Axis times angle, rad, of the shorter way. */
export function rotationVector(q: Quat): Vec3 {
  const sign = q[3] < 0 ? -1 : 1;
  const axis: Vec3 = [sign * q[0], sign * q[1], sign * q[2]];
  const sine = norm(axis);
  if (sine < 1e-12) return scale(axis, 2);
  return scale(axis, (2 * Math.atan2(sine, sign * q[3])) / sine);
}

export function fromRotationVector(v: Vec3): Quat {
  const angle = norm(v);
  const share = angle < 1e-12 ? 0.5 : Math.sin(angle / 2) / angle;
  return [v[0] * share, v[1] * share, v[2] * share, Math.cos(angle / 2)];
}

/** Roll, pitch and yaw, rad: R = Rz(yaw)·Ry(pitch)·Rx(roll). */
export function toRpy([x, y, z, w]: Quat): Vec3 {
  return [
    Math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
    Math.asin(Math.max(-1, Math.min(1, 2 * (w * y - z * x)))),
    Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
  ];
}

export function fromRpy([roll, pitch, yaw]: Vec3): Quat {
  const about = (axis: 0 | 1 | 2, angle: number): Quat => {
    const q: [number, number, number, number] = [0, 0, 0, Math.cos(angle / 2)];
    q[axis] = Math.sin(angle / 2);
    return q;
  };
  return times(times(about(2, yaw), about(1, pitch)), about(0, roll));
}

export const DEGREE = Math.PI / 180;
