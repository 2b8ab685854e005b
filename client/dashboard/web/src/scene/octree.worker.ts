// SPDX-License-Identifier: Apache-2.0
// Cuts a cloud into an octree away from the page's thread and puts its points
// in the octree's order.
import { buildOctree, robustBounds, type OctreeNode } from "../math/octree";

export interface CloudInput {
  positions: Float32Array;
  colors: Uint8Array;
}
export interface CloudOutput extends CloudInput {
  nodes: readonly OctreeNode[];
  bounds: { low: number[]; high: number[] } | null;
}

self.onmessage = (event: MessageEvent<CloudInput>) => {
  const { positions, colors } = event.data;
  const { order, nodes } = buildOctree(positions);
  const p = new Float32Array(positions.length);
  const c = new Uint8Array(colors.length);
  order.forEach((from, to) => {
    for (let k = 0; k < 3; ++k) {
      p[3 * to + k] = positions[3 * from + k]!;
      c[3 * to + k] = colors[3 * from + k]!;
    }
  });
  const output: CloudOutput = { positions: p, colors: c, nodes, bounds: robustBounds(positions) };
  postMessage(output, { transfer: [p.buffer, c.buffer] });
};
