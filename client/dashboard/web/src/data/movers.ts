// SPDX-License-Identifier: Apache-2.0
// What moves by itself and is no target yet.
import { MoversState, type FrameRecord, type Mover } from "./frame";
import type { Vec2 } from "../math/pose";

// The smallest one around a point of the image.
export function moverAt(record: FrameRecord, p: Vec2): Mover | null {
  let best: Mover | null = null;
  for (const mover of record.result.movers) {
    const b = mover.box;
    if (!b || p[0] < b.x || p[1] < b.y || p[0] > b.x + b.width || p[1] > b.y + b.height) continue;
    if (!best?.box || b.width * b.height < best.box.width * best.box.height) best = mover;
  }
  return best;
}

export function speedOf(mover: Mover): number {
  const v = mover.velocityWorldMS;
  return v ? Math.hypot(v.x, v.y, v.z) : 0;
}

// Why none are looked for; empty where they are, or where nobody has asked.
export function moversWords(state: MoversState): string {
  switch (state) {
    case MoversState.STARTING:
      return "Looking for what moves: too little has been seen yet.";
    case MoversState.NO_MAP:
      return "What moves is not looked for: there is no map that it could move against.";
    case MoversState.NO_GROUND:
      return "What moves is not looked for: the map does not know its ground, or the camera is not above it.";
    case MoversState.NO_POSE:
      return "What moves is not looked for while the camera is not localised.";
    case MoversState.POSE_CONTRADICTED:
      return "What moves is not told: too much of the picture contradicts the camera's pose.";
    default:
      return "";
  }
}
