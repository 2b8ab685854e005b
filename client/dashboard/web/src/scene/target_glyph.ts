// SPDX-License-Identifier: Apache-2.0
// One target in 3D: its box with the front face green, where it has been, and
// how uncertain its place on the ground is. A predicted target's box is dashed
// and hollow.
import { BufferAttribute, BufferGeometry, DoubleSide, Group, Mesh, MeshBasicMaterial } from "three";
import { box3, TargetState, vec3, type TargetResult } from "../data/frame";
import { BOX_EDGES, boxCorners, FRONT_FACE } from "../math/box3";
import { ellipseOf, SIGMAS_95 } from "../math/ellipse";
import type { Vec3 } from "../math/pose";
import type { Token } from "../ui/theme";
import { Segments } from "./segments";

const ELLIPSE_POINTS = 48;

function fillMaterial(opacity: number): MeshBasicMaterial {
  return new MeshBasicMaterial({ transparent: true, opacity, side: DoubleSide, depthWrite: false });
}

export class TargetGlyph {
  readonly object = new Group();
  readonly lines: Segments[];
  anchor: Vec3 | null = null; // above the box, for the label
  private readonly edges = new Segments(2.25, "#fff");
  private readonly frontEdges = new Segments(2.75, "#fff");
  private readonly ring = new Segments(1.5, "#fff", 0.9);
  readonly trail = new Segments(2, "#fff", 0.85);
  private readonly front: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly disc: Mesh<BufferGeometry, MeshBasicMaterial>;
  private readonly body = new Group();

  constructor() {
    this.lines = [this.edges, this.frontEdges, this.ring, this.trail];
    const quad = new BufferGeometry();
    quad.setAttribute("position", new BufferAttribute(new Float32Array(12), 3));
    quad.setIndex([0, 1, 2, 0, 2, 3]);
    this.front = new Mesh(quad, fillMaterial(0.4));
    const fan = new BufferGeometry();
    fan.setAttribute("position", new BufferAttribute(new Float32Array(3 * (ELLIPSE_POINTS + 1)), 3));
    const index: number[] = [];
    for (let i = 0; i < ELLIPSE_POINTS; ++i) index.push(0, i + 1, ((i + 1) % ELLIPSE_POINTS) + 1);
    fan.setIndex(index);
    this.disc = new Mesh(fan, fillMaterial(0.14));
    for (const mesh of [this.front, this.disc]) mesh.frustumCulled = false;
    this.body.add(this.edges.object, this.frontEdges.object, this.ring.object, this.front, this.disc);
    this.object.add(this.body, this.trail.object);
  }

  set(target: TargetResult | undefined, trail: readonly Vec3[], colors: Record<Token, string>, own: string): void {
    this.trail.setColor(own);
    this.trail.setPath(trail);
    const box = target && box3(target.boxWorld);
    this.body.visible = !!box;
    this.anchor = null;
    if (!target || !box) return;
    const seen = target.state === TargetState.TRACKED;
    const lost = target.state === TargetState.LOST;
    const corners = boxCorners(box);
    this.edges.setColor(seen ? colors.box : colors.ghost, lost ? 0.4 : 1);
    this.edges.setDashes(seen ? 0 : 0.09 * Math.max(...box.size));
    this.edges.setPairs(BOX_EDGES.flatMap(([a, b]) => [corners[a]!, corners[b]!]));
    const face = FRONT_FACE.map((i) => corners[i]!);
    this.frontEdges.setColor(colors.front, lost ? 0.4 : 1);
    this.frontEdges.setDashes(seen ? 0 : 0.09 * Math.max(...box.size));
    this.frontEdges.setPairs(face.flatMap((p, i) => [p, face[(i + 1) % 4]!]));
    const position = this.front.geometry.attributes.position as BufferAttribute;
    face.forEach((p, i) => position.setXYZ(i, ...p));
    position.needsUpdate = true;
    this.front.material.color.set(colors.front);
    this.front.material.opacity = seen ? 0.42 : 0.12;
    this.anchor = [
      box.worldFromObject.translation[0],
      box.worldFromObject.translation[1],
      Math.max(...corners.map((p) => p[2])),
    ];
    this.setEllipse(target, seen ? colors.accent : colors.warn, 0.01 * Math.max(...box.size));
  }

  private setEllipse(target: TargetResult, color: string, lift: number): void {
    const center = vec3(target.groundCenterM);
    const ellipse = ellipseOf(target.groundCovarianceM2);
    const visible = !!center && !!ellipse && ellipse.major > 0;
    this.ring.object.visible = visible;
    this.disc.visible = visible;
    if (!center || !ellipse || !visible) return;
    const [s, c] = [Math.sin(ellipse.angle), Math.cos(ellipse.angle)];
    const ring: Vec3[] = [];
    for (let i = 0; i <= ELLIPSE_POINTS; ++i) {
      const t = (2 * Math.PI * i) / ELLIPSE_POINTS;
      const u = SIGMAS_95 * ellipse.major * Math.cos(t);
      const v = SIGMAS_95 * ellipse.minor * Math.sin(t);
      ring.push([center[0] + c * u - s * v, center[1] + s * u + c * v, center[2] + lift]);
    }
    this.ring.setColor(color);
    this.ring.setPath(ring);
    this.disc.material.color.set(color);
    const position = this.disc.geometry.attributes.position as BufferAttribute;
    position.setXYZ(0, center[0], center[1], center[2] + lift);
    for (let i = 0; i < ELLIPSE_POINTS; ++i) position.setXYZ(i + 1, ...ring[i]!);
    position.needsUpdate = true;
  }

  dispose(): void {
    for (const line of this.lines) line.dispose();
    for (const mesh of [this.front, this.disc]) {
      mesh.geometry.dispose();
      mesh.material.dispose();
    }
  }
}
