// SPDX-License-Identifier: Apache-2.0
// A million points at a steady rate: octree nodes are drawn from the coarsest
// down, those that look largest first, until the budget of points is used up.
// All nodes share one buffer on the GPU and differ in the range they draw.
import {
  BufferAttribute,
  BufferGeometry,
  Frustum,
  Group,
  Matrix4,
  Points,
  ShaderMaterial,
  Sphere,
  Vector3,
  type PerspectiveCamera,
} from "three";
import type { Vec2, Vec3 } from "../math/pose";
import type { CloudOutput } from "./octree.worker";

const VERTEX = /* glsl */ `
  attribute vec3 rgb;
  uniform float pixels;      // of the view's height, over 2 tan(fov / 2)
  uniform float size_m;      // of a point in the world
  uniform float max_px;
  uniform float min_px;
  varying vec3 v_color;
  void main() {
    vec4 p = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * p;
    gl_PointSize = clamp(size_m * pixels / max(1e-6, -p.z), min_px, max_px);
    v_color = rgb;
  }`;

const FRAGMENT = /* glsl */ `
  uniform float opacity;
  uniform float gain;
  varying vec3 v_color;
  void main() {
    vec2 d = gl_PointCoord - 0.5;
    if (dot(d, d) > 0.25) discard;
    gl_FragColor = vec4(min(vec3(1.0), v_color * gain), opacity);
  }`;

export class PointCloud {
  readonly object = new Group();
  budget = 1_000_000;
  drawn = 0;
  private readonly material = new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: {
      pixels: { value: 1 },
      size_m: { value: 0.02 },
      max_px: { value: 6 },
      min_px: { value: 1.5 },
      opacity: { value: 1 },
      gain: { value: 1 },
    },
  });
  private parts: (Points | null)[] = [];
  private nodes: CloudOutput["nodes"] = [];
  private positions: BufferAttribute | null = null;
  private colors: BufferAttribute | null = null;

  get total(): number {
    return this.positions?.count ?? 0;
  }

  set(cloud: CloudOutput, spacing: number): void {
    this.clear();
    this.nodes = cloud.nodes;
    this.positions = new BufferAttribute(cloud.positions, 3);
    this.colors = new BufferAttribute(cloud.colors, 3, true);
    this.parts = this.nodes.map(() => null);
    this.material.uniforms.size_m!.value = spacing;
  }

  setGain(gain: number): void {
    this.material.uniforms.gain!.value = gain;
  }

  clear(): void {
    for (const part of this.parts) part?.geometry.dispose();
    this.object.clear();
    this.parts = [];
    this.nodes = [];
    this.positions = null;
    this.colors = null;
  }

  dispose(): void {
    this.clear();
    this.material.dispose();
  }

  // Chooses what is drawn from where the camera is.
  update(camera: PerspectiveCamera, heightPx: number, pixelRatio: number): void {
    const pixels = heightPx / (2 * Math.tan((camera.fov * Math.PI) / 360));
    this.material.uniforms.pixels!.value = pixels * pixelRatio;
    this.material.uniforms.min_px!.value = 1.6 * pixelRatio;
    this.material.uniforms.max_px!.value = 7 * pixelRatio;
    const frustum = new Frustum().setFromProjectionMatrix(
      new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse),
    );
    const sphere = new Sphere();
    const c = new Vector3();
    const visible = new Set<number>();
    let left = this.budget;
    // A heap would do less work; there are a few hundred nodes.
    const open: { index: number; size: number }[] = [];
    const offer = (index: number) => {
      const node = this.nodes[index]!;
      c.set(...node.center);
      sphere.set(c, node.half * Math.sqrt(3));
      if (!frustum.intersectsSphere(sphere)) return;
      const distance = Math.max(1e-6, camera.position.distanceTo(c) - sphere.radius);
      open.push({ index, size: (node.half * pixels) / distance });
    };
    if (this.nodes.length > 0) offer(0);
    while (open.length > 0) {
      let best = 0;
      for (let i = 1; i < open.length; ++i) if (open[i]!.size > open[best]!.size) best = i;
      const { index, size } = open[best]!;
      open[best] = open[open.length - 1]!;
      open.pop();
      const node = this.nodes[index]!;
      if (node.count > left) break;
      // A cube this small on the screen shows no more than its parent does.
      if (node.level > 0 && size < 12) continue;
      left -= node.count;
      visible.add(index);
      node.children.forEach(offer);
    }
    this.parts.forEach((part, i) => {
      if (part) part.visible = visible.has(i);
      else if (visible.has(i)) this.addPart(i);
    });
    this.drawn = this.budget - left;
  }

  // The point that is drawn nearest to a place on the screen, no farther than
  // `reachPx` from it. All points count, drawn at present or not.
  nearest(camera: PerspectiveCamera, widthPx: number, heightPx: number, at: Vec2, reachPx: number): Vec3 | null {
    if (!this.positions) return null;
    const p = this.positions.array;
    const m = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse).elements;
    let best = reachPx * reachPx;
    let found = -1;
    for (let i = 0; i < p.length; i += 3) {
      const [x, y, z] = [p[i]!, p[i + 1]!, p[i + 2]!];
      const w = m[3]! * x + m[7]! * y + m[11]! * z + m[15]!;
      if (!(w > camera.near)) continue;
      const u = 0.5 * widthPx * (1 + (m[0]! * x + m[4]! * y + m[8]! * z + m[12]!) / w) - at[0];
      const v = 0.5 * heightPx * (1 - (m[1]! * x + m[5]! * y + m[9]! * z + m[13]!) / w) - at[1];
      const distance = u * u + v * v;
      if (distance > best) continue;
      best = distance;
      found = i;
    }
    return found < 0 ? null : [p[found]!, p[found + 1]!, p[found + 2]!];
  }

  private addPart(index: number): void {
    const node = this.nodes[index]!;
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", this.positions!);
    geometry.setAttribute("rgb", this.colors!);
    geometry.setDrawRange(node.first, node.count);
    const points = new Points(geometry, this.material);
    points.frustumCulled = false;
    this.parts[index] = points;
    this.object.add(points);
  }
}
