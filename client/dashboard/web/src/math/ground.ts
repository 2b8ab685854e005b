// SPDX-License-Identifier: Apache-2.0
// A ground that somebody points at: through three places, or level through one.
import { rotate, type Rigid, type Vec3 } from "./pose";

// normal . x + d = 0, unit normal, up.
export interface GroundPlane {
  readonly normal: Vec3;
  readonly d: number;
}

// Three places nearer to a line than this (the sine of the angle between two
// sides) leave the plane's tilt to how exactly they were clicked.
const LEAST_SINE = 0.1;
// Roll of cameras that people or gimbals hold level, as the server reckons with
// (docs/method.md, "The ground plane").
const ROLL_SIGMA = 0.05;

const dot = (a: Vec3, b: Vec3) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const minus = (a: Vec3, b: Vec3): Vec3 => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
const cross = (a: Vec3, b: Vec3): Vec3 => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];
const length = (a: Vec3) => Math.hypot(...a);
const scaled = (a: Vec3, s: number): Vec3 => [a[0] * s, a[1] * s, a[2] * s];

function through(point: Vec3, normal: Vec3): GroundPlane {
  return { normal, d: -dot(normal, point) };
}

// Up is the side on which most cameras are. null: the places lie on a line.
export function planeThrough(a: Vec3, b: Vec3, c: Vec3, centers: readonly Vec3[]): GroundPlane | null {
  const ab = minus(b, a);
  const ac = minus(c, a);
  const bc = minus(c, b);
  const normal = cross(ab, ac);
  const sides = [length(ab), length(ac), length(bc)].sort((p, q) => p - q);
  if (!(length(normal) > LEAST_SINE * sides[1]! * sides[2]!)) return null;
  const plane = through(a, scaled(normal, 1 / length(normal)));
  const above = centers.filter((p) => dot(plane.normal, p) + plane.d > 0).length;
  return 2 * above >= centers.length ? plane : { normal: scaled(plane.normal, -1), d: -plane.d };
}

// Level as the cameras were held: perpendicular to their axes to the right as
// far as these agree, else to their images' up. null without cameras.
export function levelPlane(point: Vec3, cameras: readonly Rigid[]): GroundPlane | null {
  let up: Vec3 = [0, 0, 0];
  // Sum of right right^T / sigma^2, and 1 for the pull to the images' up.
  const a = [1, 0, 0, 0, 1, 0, 0, 0, 1];
  for (const { rotation } of cameras) {
    const right = rotate(rotation, [1, 0, 0]);
    up = minus(up, rotate(rotation, [0, 1, 0]));
    for (let i = 0; i < 3; ++i) {
      for (let k = 0; k < 3; ++k) a[3 * i + k]! += (right[i]! * right[k]!) / (ROLL_SIGMA ** 2 * cameras.length);
    }
  }
  if (!(length(up) > 1e-6)) return null;
  up = scaled(up, 1 / length(up));
  // Cramer's rule.
  const column = (k: number): Vec3 => [a[k]!, a[3 + k]!, a[6 + k]!];
  const [x, y, z] = [column(0), column(1), column(2)];
  const solved: Vec3 = [dot(up, cross(y, z)), dot(x, cross(up, z)), dot(x, cross(y, up))];
  const size = length(solved);
  return size > 0 ? through(point, scaled(solved, 1 / size)) : null;
}
