// SPDX-License-Identifier: Apache-2.0
// Upright boxes: corners, edges, front face, and their way into the image.
import type { Camera } from "./camera";
import { inverse, transform, type Rigid, type Vec2, type Vec3 } from "./pose";

export interface Box3 {
  readonly worldFromObject: Rigid; // origin: the centre of the volume
  readonly size: Vec3; // length (x), width (y), height (z)
}

// Corner index bits: 1 = +x, 2 = +y, 4 = +z.
export const BOX_EDGES: readonly (readonly [number, number])[] = [
  [0, 1], [2, 3], [4, 5], [6, 7],
  [0, 2], [1, 3], [4, 6], [5, 7],
  [0, 4], [1, 5], [2, 6], [3, 7],
];
// The face at +x, in order around.
export const FRONT_FACE: readonly number[] = [1, 3, 7, 5];

export function boxCorners(box: Box3): Vec3[] {
  const corners: Vec3[] = [];
  for (let i = 0; i < 8; ++i) {
    corners.push(
      transform(box.worldFromObject, [
        (i & 1 ? 0.5 : -0.5) * box.size[0],
        (i & 2 ? 0.5 : -0.5) * box.size[1],
        (i & 4 ? 0.5 : -0.5) * box.size[2],
      ]),
    );
  }
  return corners;
}

// Segments shorter than this on z are cut here, map units times depth.
const NEAR = 1e-3;

// The pixels of a segment's two ends, cut at the camera's plane; null if all of
// it lies behind.
export function projectSegment(
  camera: Camera,
  cameraFromWorld: Rigid,
  a: Vec3,
  b: Vec3,
): [Vec2, Vec2] | null {
  let p = transform(cameraFromWorld, a);
  let q = transform(cameraFromWorld, b);
  if (p[2] < NEAR && q[2] < NEAR) return null;
  if (p[2] < NEAR) p = cut(q, p);
  if (q[2] < NEAR) q = cut(p, q);
  const from = camera.project(p);
  const to = camera.project(q);
  return from && to ? [from, to] : null;
}

function cut(front: Vec3, behind: Vec3): Vec3 {
  const t = (front[2] - NEAR) / (front[2] - behind[2]);
  return [
    front[0] + t * (behind[0] - front[0]),
    front[1] + t * (behind[1] - front[1]),
    NEAR,
  ];
}

export interface ProjectedBox {
  readonly edges: readonly [Vec2, Vec2][];
  readonly front: readonly Vec2[] | null; // null if cut by the image plane
  readonly center: Vec2 | null;
}

export function projectBox(camera: Camera, worldFromCamera: Rigid, box: Box3): ProjectedBox {
  const cameraFromWorld = inverse(worldFromCamera);
  const corners = boxCorners(box);
  const edges: [Vec2, Vec2][] = [];
  for (const [a, b] of BOX_EDGES) {
    const segment = projectSegment(camera, cameraFromWorld, corners[a]!, corners[b]!);
    if (segment) edges.push(segment);
  }
  const face = FRONT_FACE.map((i) => camera.project(transform(cameraFromWorld, corners[i]!)));
  return {
    edges,
    front: face.every((p): p is Vec2 => p !== null) ? face : null,
    center: camera.project(transform(cameraFromWorld, box.worldFromObject.translation)),
  };
}
