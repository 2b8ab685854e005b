// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import {
  angleBetween, conjugate, inverse, matrixFromQuat, multiply, normalize, rotate, slerp, transform,
  type Quat, type Rigid, type Vec3,
} from "../src/math/pose";

const about = (axis: Vec3, angle: number): Quat => {
  const n = Math.hypot(...axis);
  const s = Math.sin(angle / 2) / n;
  return [Math.cos(angle / 2), axis[0] * s, axis[1] * s, axis[2] * s];
};

describe("rotations", () => {
  it("turn x to y about z", () => {
    const p = rotate(about([0, 0, 1], Math.PI / 2), [1, 0, 0]);
    expect(p[0]).toBeCloseTo(0, 12);
    expect(p[1]).toBeCloseTo(1, 12);
  });

  it("agree with their matrices and compose from right to left", () => {
    const a = about([1, 2, 3], 0.7);
    const b = about([-1, 0.5, 2], -1.9);
    const v: Vec3 = [0.3, -1.2, 2.5];
    const m = matrixFromQuat(a);
    const byMatrix = [0, 1, 2].map((r) => m[3 * r]! * v[0] + m[3 * r + 1]! * v[1] + m[3 * r + 2]! * v[2]);
    rotate(a, v).forEach((x, i) => expect(x).toBeCloseTo(byMatrix[i]!, 12));
    const once = rotate(multiply(a, b), v);
    rotate(a, rotate(b, v)).forEach((x, i) => expect(x).toBeCloseTo(once[i]!, 12));
  });

  it("a transform's inverse undoes it", () => {
    const t: Rigid = { rotation: about([1, -1, 0.2], 2.1), translation: [4, -5, 6] };
    const p: Vec3 = [0.1, 0.2, 0.3];
    transform(inverse(t), transform(t, p)).forEach((x, i) => expect(x).toBeCloseTo(p[i]!, 12));
  });
});

describe("slerp", () => {
  const a = about([0, 0, 1], 0.2);
  const b = about([0, 0, 1], 1.4);

  it("goes the share of the angle", () => {
    expect(angleBetween(a, slerp(a, b, 0.25))).toBeCloseTo(0.3, 12);
    expect(angleBetween(slerp(a, b, 1), b)).toBeCloseTo(0, 7);
  });

  it("takes the shorter arc whatever the signs", () => {
    const minus: Quat = [-b[0], -b[1], -b[2], -b[3]];
    expect(angleBetween(a, slerp(a, minus, 0.5))).toBeCloseTo(0.6, 12);
  });

  it("holds for equal and nearly equal rotations", () => {
    expect(angleBetween(slerp(a, a, 0.3), a)).toBeCloseTo(0, 7);
    const near = normalize([a[0], a[1], a[2], a[3] + 1e-9]);
    slerp(a, near, 0.5).forEach((x) => expect(Number.isFinite(x)).toBe(true));
  });

  it("measures angles without regard to sign", () => {
    expect(angleBetween(a, conjugate(conjugate(a)))).toBeCloseTo(0, 7);
    expect(angleBetween(a, [-a[0], -a[1], -a[2], -a[3]])).toBeCloseTo(0, 7);
  });
});
