// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { Camera, ModelId } from "../src/math/camera";
import { angleBetween, conjugate, rotate, type Quat } from "../src/math/pose";
import {
  applyHomography, invert3, smoothingFactor, stabilizingHomography, Stabilizer,
} from "../src/math/stabilizer";

const yaw = (angle: number): Quat => [Math.cos(angle / 2), 0, Math.sin(angle / 2), 0];
const camera = new Camera({ model: ModelId.SimplePinhole, width: 1280, height: 720, params: [1000, 640, 360] });

describe("the filter", () => {
  it("takes 0.2 of a step at 24 frames/s, and as much over time at others", () => {
    expect(smoothingFactor(1 / 24)).toBeCloseTo(0.2, 12);
    expect(1 - (1 - smoothingFactor(1 / 48)) ** 2).toBeCloseTo(0.2, 12);
  });

  it("follows a step as a first-order low pass does", () => {
    const filter = new Stabilizer();
    filter.update(yaw(0), 0);
    let smooth = yaw(0);
    for (let k = 1; k <= 5; ++k) smooth = filter.update(yaw(0.1), k / 24)!;
    expect(angleBetween(smooth, yaw(0.1))).toBeCloseTo(0.1 * 0.8 ** 5, 9);
  });

  it("takes shaking out", () => {
    const filter = new Stabilizer();
    let raw = 0;
    let left = 0;
    for (let k = 0; k < 240; ++k) {
      const angle = 0.01 * Math.sin((2 * Math.PI * 8 * k) / 24); // 8 Hz
      const smooth = filter.update(yaw(angle), k / 24)!;
      if (k > 48) {
        raw = Math.max(raw, Math.abs(angle));
        left = Math.max(left, angleBetween(smooth, yaw(0)));
      }
    }
    expect(left).toBeLessThan(0.3 * raw);
  });

  it("starts anew after a cut, a pause and a jump back", () => {
    const filter = new Stabilizer();
    filter.update(yaw(0), 10);
    expect(angleBetween(filter.update(yaw(1), 10.04)!, yaw(1))).toBeCloseTo(0, 7);
    expect(angleBetween(filter.update(yaw(1.1), 13)!, yaw(1.1))).toBeCloseTo(0, 7);
    expect(angleBetween(filter.update(yaw(1.2), 2)!, yaw(1.2))).toBeCloseTo(0, 7);
  });

  it("stays where it is while there is no pose", () => {
    const filter = new Stabilizer();
    expect(filter.update(null, 0)).toBeNull();
    filter.update(yaw(0.3), 0.1);
    expect(filter.update(null, 0.2)).toEqual(yaw(0.3));
  });
});

describe("the warp", () => {
  it("moves what is far away to where the steady camera sees it", () => {
    const raw = yaw(0.03);
    const smooth = yaw(0.01);
    const h = stabilizingHomography(camera, raw, smooth);
    const far = [0.2, -0.1, 1] as const; // a direction in world
    const from = camera.project(rotate(conjugate(raw), far))!;
    const to = camera.project(rotate(conjugate(smooth), far))!;
    const [u, v] = applyHomography(h, ...from);
    expect(u).toBeCloseTo(to[0], 9);
    expect(v).toBeCloseTo(to[1], 9);
  });

  it("is undone by its inverse", () => {
    const h = stabilizingHomography(camera, yaw(0.2), yaw(0.05));
    const [u, v] = applyHomography(h, 100, 200);
    const [x, y] = applyHomography(invert3(h), u, v);
    expect(x).toBeCloseTo(100, 8);
    expect(y).toBeCloseTo(200, 8);
  });
});
