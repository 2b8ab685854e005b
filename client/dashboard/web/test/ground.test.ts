// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { levelPlane, planeThrough } from "../src/math/ground";
import { multiply, normalize, type Quat, type Rigid, type Vec3 } from "../src/math/pose";

// Looks north, level: x east, y down, z north.
const NORTH: Quat = normalize([1, -1, 0, 0]);
const about = (axis: Vec3, angle: number): Quat => {
  const s = Math.sin(angle / 2);
  return [Math.cos(angle / 2), axis[0] * s, axis[1] * s, axis[2] * s];
};
const camera = (heading: number, pitch: number, roll = 0): Rigid => ({
  rotation: multiply(about([0, 0, 1], heading), multiply(NORTH, multiply(about([1, 0, 0], pitch), about([0, 0, 1], roll)))),
  translation: [0, 0, 10],
});

describe("a ground that somebody points at", () => {
  const above: Vec3[] = [[0, 0, 10], [3, 0, 12], [5, 5, 9]];

  it("goes through three places, up towards the cameras", () => {
    for (const order of [[0, 1, 2], [2, 1, 0]] as const) {
      const places: Vec3[] = [[0, 0, 1], [10, 0, 2], [0, 10, 1]];
      const plane = planeThrough(places[order[0]]!, places[order[1]]!, places[order[2]]!, above)!;
      expect(plane.normal[2]).toBeCloseTo(Math.cos(Math.atan(0.1)), 12);
      expect(plane.normal[0]).toBeCloseTo(-Math.sin(Math.atan(0.1)), 12);
      for (const p of places) {
        expect(plane.normal[0] * p[0] + plane.normal[1] * p[1] + plane.normal[2] * p[2] + plane.d).toBeCloseTo(0, 12);
      }
    }
  });

  it("is none where the places lie on a line", () => {
    expect(planeThrough([0, 0, 0], [5, 0.1, 0], [10, 0, 0], above)).toBeNull();
    expect(planeThrough([0, 0, 0], [0, 0, 0], [10, 0, 0], above)).toBeNull();
  });

  it("is level as the cameras were held, however far they look down", () => {
    const turned = [camera(0, -0.6), camera(1.2, -0.3), camera(-0.8, -0.9)];
    const plane = levelPlane([2, 3, 4], turned)!;
    expect(plane.normal[2]).toBeGreaterThan(Math.cos(0.01));
    expect(plane.d).toBeCloseTo(-4, 1);
    // One that was held askew pulls by its share.
    const askew = levelPlane([2, 3, 4], [...turned, camera(0.4, -0.5, 0.1)])!;
    expect(askew.normal[2]).toBeGreaterThan(Math.cos(0.08));
    expect(askew.normal[2]).toBeLessThan(plane.normal[2]);
  });

  it("knows no level without cameras", () => {
    expect(levelPlane([0, 0, 0], [])).toBeNull();
  });
});
