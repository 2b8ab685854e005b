// SPDX-License-Identifier: Apache-2.0
// Rotations and rigid transforms, in plain numbers so that they can be tested
// without a browser. Frames and units as in proto/groundlock/v1/geometry.proto.

export type Vec2 = readonly [number, number];
export type Vec3 = readonly [number, number, number];
// w, x, y, z; unit length.
export type Quat = readonly [number, number, number, number];
// Row by row.
export type Mat3 = readonly [
  number, number, number,
  number, number, number,
  number, number, number,
];

// target_from_source: x_target = rotation * x_source + translation.
export interface Rigid {
  readonly rotation: Quat;
  readonly translation: Vec3;
}

export const IDENTITY_QUAT: Quat = [1, 0, 0, 0];

export function normalize(q: Quat): Quat {
  const n = Math.hypot(...q);
  return n > 0 ? [q[0] / n, q[1] / n, q[2] / n, q[3] / n] : IDENTITY_QUAT;
}

export function conjugate(q: Quat): Quat {
  return [q[0], -q[1], -q[2], -q[3]];
}

export function multiply(a: Quat, b: Quat): Quat {
  return [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
    a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
  ];
}

export function rotate(q: Quat, v: Vec3): Vec3 {
  const [w, x, y, z] = q;
  // t = 2 q_v x v; v + w t + q_v x t
  const tx = 2 * (y * v[2] - z * v[1]);
  const ty = 2 * (z * v[0] - x * v[2]);
  const tz = 2 * (x * v[1] - y * v[0]);
  return [
    v[0] + w * tx + y * tz - z * ty,
    v[1] + w * ty + z * tx - x * tz,
    v[2] + w * tz + x * ty - y * tx,
  ];
}

export function transform(t: Rigid, p: Vec3): Vec3 {
  const r = rotate(t.rotation, p);
  return [
    r[0] + t.translation[0],
    r[1] + t.translation[1],
    r[2] + t.translation[2],
  ];
}

export function inverse(t: Rigid): Rigid {
  const rotation = conjugate(t.rotation);
  const p = rotate(rotation, t.translation);
  return { rotation, translation: [-p[0], -p[1], -p[2]] };
}

// From a to b, t in [0, 1], along the shorter arc.
export function slerp(a: Quat, b: Quat, t: number): Quat {
  let dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
  const sign = dot < 0 ? -1 : 1;
  dot = Math.min(1, Math.abs(dot));
  const angle = Math.acos(dot);
  const s = Math.sin(angle);
  // Below 1e-6 rad the quotients lose digits, and the chord is the arc.
  const wa = s > 1e-6 ? Math.sin((1 - t) * angle) / s : 1 - t;
  const wb = sign * (s > 1e-6 ? Math.sin(t * angle) / s : t);
  return normalize([
    wa * a[0] + wb * b[0],
    wa * a[1] + wb * b[1],
    wa * a[2] + wb * b[2],
    wa * a[3] + wb * b[3],
  ]);
}

export function matrixFromQuat(q: Quat): Mat3 {
  const [w, x, y, z] = q;
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

export function multiply3(a: Mat3, b: Mat3): Mat3 {
  const c: number[] = [];
  for (let row = 0; row < 3; ++row) {
    for (let col = 0; col < 3; ++col) {
      let sum = 0;
      for (let k = 0; k < 3; ++k) sum += a[3 * row + k]! * b[3 * k + col]!;
      c.push(sum);
    }
  }
  return c as unknown as Mat3;
}

export function distance(a: Vec3, b: Vec3): number {
  return Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
}

// Angle between two rotations, rad.
export function angleBetween(a: Quat, b: Quat): number {
  const d = multiply(conjugate(a), b);
  return 2 * Math.atan2(Math.hypot(d[1], d[2], d[3]), Math.abs(d[0]));
}
