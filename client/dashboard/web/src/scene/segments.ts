// SPDX-License-Identifier: Apache-2.0
// Lines of a width in pixels whose points may change with every frame: buffers
// are kept and grow by doubling.
import { InstancedInterleavedBuffer, InterleavedBufferAttribute, Vector2, type ColorRepresentation } from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import type { Vec3 } from "../math/pose";

export class Segments {
  readonly object: LineSegments2;
  private geometry = new LineSegmentsGeometry();
  private readonly material: LineMaterial;
  private points = new Float32Array(0);
  private distances = new Float32Array(0);

  constructor(width: number, color: ColorRepresentation, opacity = 1) {
    this.material = new LineMaterial({
      color,
      linewidth: width,
      transparent: opacity < 1,
      opacity,
      depthWrite: opacity >= 1,
    });
    this.object = new LineSegments2(this.geometry, this.material);
    this.object.frustumCulled = false;
    this.grow(64);
    this.geometry.instanceCount = 0;
  }

  setColor(color: ColorRepresentation, opacity = this.material.opacity): void {
    this.material.color.set(color);
    this.material.opacity = opacity;
    this.material.transparent = opacity < 1;
  }

  // size in world units; 0 = solid.
  setDashes(size: number): void {
    if (this.material.dashed !== size > 0) {
      this.material.dashed = size > 0;
      this.material.needsUpdate = true;
    }
    this.material.dashSize = size;
    this.material.gapSize = 0.8 * size;
  }

  // Drawn over everything, also what hides it.
  setOnTop(on: boolean): void {
    this.material.depthTest = !on;
  }

  resize(width: number, height: number): void {
    this.material.resolution = new Vector2(width, height);
  }

  // Pairs of points: a to b, c to d, ...
  setPairs(points: readonly Vec3[]): void {
    this.fill(points.length >> 1, (i) => [points[2 * i]!, points[2 * i + 1]!], false);
  }

  // One way through all points.
  setPath(points: readonly Vec3[]): void {
    this.fill(Math.max(0, points.length - 1), (i) => [points[i]!, points[i + 1]!], true);
  }

  dispose(): void {
    this.geometry.dispose();
    this.material.dispose();
  }

  private fill(count: number, segment: (i: number) => [Vec3, Vec3], joined: boolean): void {
    if (6 * count > this.points.length) this.grow(count);
    let along = 0;
    for (let i = 0; i < count; ++i) {
      const [a, b] = segment(i);
      this.points.set(a, 6 * i);
      this.points.set(b, 6 * i + 3);
      const length = Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
      this.distances[2 * i] = joined ? along : 0;
      this.distances[2 * i + 1] = (joined ? along : 0) + length;
      along += length;
    }
    this.geometry.instanceCount = count;
    this.object.visible = count > 0;
    if (count === 0) return;
    for (const name of ["instanceStart", "instanceDistanceStart"]) {
      (this.geometry.attributes[name] as InterleavedBufferAttribute).data.needsUpdate = true;
    }
  }

  private grow(segments: number): void {
    const capacity = Math.max(64, 2 ** Math.ceil(Math.log2(segments)));
    this.points = new Float32Array(6 * capacity);
    this.distances = new Float32Array(2 * capacity);
    const old = this.geometry;
    this.geometry = new LineSegmentsGeometry();
    const ends = new InstancedInterleavedBuffer(this.points, 6, 1);
    const along = new InstancedInterleavedBuffer(this.distances, 2, 1);
    this.geometry.setAttribute("instanceStart", new InterleavedBufferAttribute(ends, 3, 0));
    this.geometry.setAttribute("instanceEnd", new InterleavedBufferAttribute(ends, 3, 3));
    this.geometry.setAttribute("instanceDistanceStart", new InterleavedBufferAttribute(along, 1, 0));
    this.geometry.setAttribute("instanceDistanceEnd", new InterleavedBufferAttribute(along, 1, 1));
    this.object.geometry = this.geometry;
    old.dispose();
  }
}
