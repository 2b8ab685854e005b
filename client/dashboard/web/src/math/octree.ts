// SPDX-License-Identifier: Apache-2.0
// A point cloud as an octree in which every node holds an even share of the
// points in its cube and its children hold the rest: drawing the nodes from the
// root down adds detail without drawing a point twice.

export interface OctreeNode {
  readonly first: number; // of the node's points in `order`
  readonly count: number;
  readonly center: readonly [number, number, number];
  readonly half: number; // half the cube's side
  readonly level: number;
  readonly children: readonly number[];
}

export interface Octree {
  readonly order: Uint32Array; // point indices, node by node
  readonly nodes: readonly OctreeNode[]; // 0 is the root; empty for no points
}

const MAX_LEVEL = 16;

//   positions  x, y, z per point.
//   capacity   points per node.
export function buildOctree(positions: Float32Array, capacity = 6000): Octree {
  const total = Math.floor(positions.length / 3);
  const order = new Uint32Array(total);
  for (let i = 0; i < total; ++i) order[i] = i;
  shuffle(order); // a node's first points are then a fair sample of its cube
  const nodes: OctreeNode[] = [];
  if (total === 0) return { order, nodes };

  const { center, half } = cubeAround(positions);
  const scratch = new Uint32Array(total);
  const build = (
    first: number,
    count: number,
    c: readonly [number, number, number],
    h: number,
    level: number,
  ): number => {
    const index = nodes.length;
    const own = count <= 1.5 * capacity || level >= MAX_LEVEL ? count : capacity;
    const children: number[] = [];
    nodes.push({ first, count: own, center: c, half: h, level, children });
    const rest = count - own;
    if (rest === 0) return index;

    const from = first + own;
    const counts = new Uint32Array(9);
    const octant = (point: number): number =>
      (positions[3 * point]! > c[0] ? 1 : 0) +
      (positions[3 * point + 1]! > c[1] ? 2 : 0) +
      (positions[3 * point + 2]! > c[2] ? 4 : 0);
    for (let i = 0; i < rest; ++i) counts[octant(order[from + i]!) + 1]!++;
    for (let k = 0; k < 8; ++k) counts[k + 1]! += counts[k]!;
    const next = counts.slice(0, 8);
    for (let i = 0; i < rest; ++i) {
      const point = order[from + i]!;
      scratch[next[octant(point)]!++] = point;
    }
    order.set(scratch.subarray(0, rest), from);
    for (let k = 0; k < 8; ++k) {
      const size = counts[k + 1]! - counts[k]!;
      if (size === 0) continue;
      const q = h / 2;
      children.push(
        build(
          from + counts[k]!,
          size,
          [c[0] + (k & 1 ? q : -q), c[1] + (k & 2 ? q : -q), c[2] + (k & 4 ? q : -q)],
          q,
          level + 1,
        ),
      );
    }
    return index;
  };
  build(0, total, center, half, 0);
  return { order, nodes };
}

function cubeAround(positions: Float32Array): {
  center: [number, number, number];
  half: number;
} {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; ++i) {
    const v = positions[i]!;
    if (v < low[i % 3]!) low[i % 3] = v;
    if (v > high[i % 3]!) high[i % 3] = v;
  }
  const center = [0, 1, 2].map((k) => 0.5 * (low[k]! + high[k]!)) as [number, number, number];
  const half = Math.max(...[0, 1, 2].map((k) => 0.5 * (high[k]! - low[k]!)), 1e-6) * 1.0001;
  return { center, half };
}

// Fisher-Yates with a fixed linear congruential generator (Numerical Recipes):
// the same cloud is cut the same way every time.
function shuffle(order: Uint32Array): void {
  let state = 12345;
  for (let i = order.length - 1; i > 0; --i) {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    const j = Math.floor((state / 0x1_0000_0000) * (i + 1));
    const t = order[i]!;
    order[i] = order[j]!;
    order[j] = t;
  }
}

// Bounds of the middle 96 % of the points along each axis: views are framed by
// them, and a few points at infinity do not matter.
export function robustBounds(positions: Float32Array): { low: number[]; high: number[] } | null {
  const total = Math.floor(positions.length / 3);
  if (total === 0) return null;
  const step = Math.max(1, Math.floor(total / 20_000));
  const low: number[] = [];
  const high: number[] = [];
  for (let axis = 0; axis < 3; ++axis) {
    const values: number[] = [];
    for (let i = 0; i < total; i += step) values.push(positions[3 * i + axis]!);
    values.sort((a, b) => a - b);
    low.push(values[Math.floor(0.02 * (values.length - 1))]!);
    high.push(values[Math.ceil(0.98 * (values.length - 1))]!);
  }
  return { low, high };
}
