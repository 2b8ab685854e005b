// SPDX-License-Identifier: Apache-2.0
// What moves and is no target: where it stands, a dashed square, and where it
// will be in a second.
import { vec3, type Mover } from "../data/frame";
import type { Vec3 } from "../math/pose";
import { Segments } from "./segments";

// Pairs of points for Segments. size: half the square's side, map units.
export function moverSegments(movers: readonly Mover[], size: number): Vec3[] {
  const points: Vec3[] = [];
  for (const mover of movers) {
    const p = vec3(mover.groundCenterM);
    const v = vec3(mover.velocityWorldMS);
    if (!p || !v) continue;
    const corners = ([[-1, -1], [1, -1], [1, 1], [-1, 1]] as const).map(
      ([u, w]): Vec3 => [p[0] + u * size, p[1] + w * size, p[2]],
    );
    corners.forEach((corner, i) => points.push(corner, corners[(i + 1) % 4]!));
    points.push(p, [p[0] + v[0], p[1] + v[1], p[2] + v[2]]);
  }
  return points;
}

export class MoverGlyphs {
  readonly lines = new Segments(1.5, "#fff");

  set(movers: readonly Mover[], size: number, color: string): void {
    const points = moverSegments(movers, size);
    this.lines.setColor(color);
    this.lines.setDashes(0.5 * size);
    this.lines.setPairs(points);
    this.lines.object.visible = points.length > 0;
  }

  dispose(): void {
    this.lines.dispose();
  }
}
