// SPDX-License-Identifier: Apache-2.0
import { describe, expect, it } from "vitest";
import { buildOctree, robustBounds } from "../src/math/octree";

function cloud(count: number): Float32Array {
  const p = new Float32Array(3 * count);
  let state = 7;
  for (let i = 0; i < p.length; ++i) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    p[i] = (state / 2 ** 32) * (i % 3 === 2 ? 1 : 10);
  }
  return p;
}

describe("the octree", () => {
  const positions = cloud(20_000);
  const { order, nodes } = buildOctree(positions, 500);

  it("holds every point once", () => {
    expect([...order].sort((a, b) => a - b)).toEqual(Array.from({ length: 20_000 }, (_, i) => i));
    const ranges = nodes.map((n) => [n.first, n.count] as const).sort((a, b) => a[0] - b[0]);
    let next = 0;
    for (const [first, count] of ranges) {
      expect(first).toBe(next);
      next += count;
    }
    expect(next).toBe(20_000);
  });

  it("has points inside their cubes", () => {
    let outside = 0;
    for (const node of nodes) {
      for (let i = node.first; i < node.first + node.count; ++i) {
        for (let k = 0; k < 3; ++k) {
          if (Math.abs(positions[3 * order[i]! + k]! - node.center[k]!) > node.half * 1.0001) outside++;
        }
      }
    }
    expect(outside).toBe(0);
  });

  it("shows an even sample at the root", () => {
    const root = nodes[0]!;
    let left = 0;
    for (let i = 0; i < root.count; ++i) if (positions[3 * order[i]!]! < 5) left++;
    expect(left / root.count).toBeGreaterThan(0.43);
    expect(left / root.count).toBeLessThan(0.57);
  });

  it("ends with points that are all the same", () => {
    const same = buildOctree(new Float32Array(3 * 5000).fill(1), 100);
    expect(same.nodes.reduce((sum, n) => sum + n.count, 0)).toBe(5000);
    expect(buildOctree(new Float32Array(0)).nodes).toHaveLength(0);
  });
});

describe("bounds", () => {
  it("leave single points far away out", () => {
    const p = cloud(1000);
    p[0] = 1e6;
    const b = robustBounds(p)!;
    expect(b.high[0]).toBeLessThan(10);
    expect(robustBounds(new Float32Array(0))).toBeNull();
  });
});
