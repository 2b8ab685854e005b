// SPDX-License-Identifier: Apache-2.0
// What is drawn of a million points, by where one looks from.
import { PerspectiveCamera } from "three";
import { describe, expect, it } from "vitest";
import { buildOctree } from "../src/math/octree";
import { PointCloud } from "../src/scene/point_cloud";

const COUNT = 1_000_000;
const HEIGHT_PX = 800;

// Hills of 200 m by 200 m, the seed fixed.
function hills(): Float32Array {
  const positions = new Float32Array(3 * COUNT);
  let seed = 1;
  const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
  for (let i = 0; i < COUNT; ++i) {
    const x = 200 * random() - 100;
    const y = 200 * random() - 100;
    positions.set([x, y, 3 * Math.sin(x / 9) * Math.cos(y / 7)], 3 * i);
  }
  return positions;
}

function cameraAt(x: number, y: number, z: number): PerspectiveCamera {
  const camera = new PerspectiveCamera(50, 1.5, 0.1, 2000);
  camera.up.set(0, 0, 1);
  camera.position.set(x, y, z);
  camera.lookAt(0, 0, 0);
  camera.updateMatrixWorld();
  return camera;
}

describe("a million points", () => {
  const positions = hills();
  const { order, nodes } = buildOctree(positions);
  const cloud = new PointCloud();
  cloud.set({ positions, colors: new Uint8Array(3 * COUNT), nodes, bounds: null }, 0.2);
  const whole = cameraAt(0, -200, 120);
  const near = cameraAt(60, 0, 8);

  it("are all in the octree, once", () => {
    expect(order.length).toBe(COUNT);
    expect(nodes.reduce((sum, node) => sum + node.count, 0)).toBe(COUNT);
  });

  it.each([40_000, 300_000, COUNT])("fill a budget of %i, but do not exceed it", (budget) => {
    cloud.budget = budget;
    for (const camera of [whole, near]) {
      cloud.update(camera, HEIGHT_PX, 1);
      expect(cloud.drawn).toBeLessThanOrEqual(budget);
      expect(cloud.drawn).toBeGreaterThan(0.05 * budget);
    }
    cloud.update(whole, HEIGHT_PX, 1);
    // What is too small on the screen to be told apart is left out.
    if (budget <= 300_000) expect(cloud.drawn).toBeGreaterThan(0.8 * budget);
  });

  it("are few draw calls, chosen anew for every frame", () => {
    expect(nodes.length).toBeLessThan(1000);
    cloud.budget = COUNT;
    const start = performance.now();
    const frames = 60;
    for (let i = 0; i < frames; ++i) cloud.update(i % 2 ? near : whole, HEIGHT_PX, 1);
    const parts = cloud.object.children.filter((part) => part.visible).length;
    console.log(`${((performance.now() - start) / frames).toFixed(2)} ms a frame to choose ${parts} of ${nodes.length} nodes`);
    expect(parts).toBeGreaterThan(0);
    // From near, what lies behind is left out.
    const drawnNear = cloud.drawn;
    cloud.update(whole, HEIGHT_PX, 1);
    expect(drawnNear).toBeLessThan(cloud.drawn);
  });
});
