// SPDX-License-Identifier: Apache-2.0
// Where the camera and the targets have been in the last minute.
import { vec3, worldFromCamera, type FrameRecord } from "../data/frame";
import type { FrameHistory } from "../data/history";
import type { Vec3 } from "../math/pose";

const TRAIL_S = 60;
const MAX_TRAIL_POINTS = 600;

// By target; the camera's has the name "".
export function trailsUpTo(record: FrameRecord, history: FrameHistory): Map<string, Vec3[]> {
  const result = new Map<string, Vec3[]>();
  const until = history.indexOf(record.sequence);
  const from = Math.max(0, history.indexAt(record.timeS - TRAIL_S));
  const step = Math.max(1, Math.ceil((until - from) / MAX_TRAIL_POINTS));
  const add = (id: string, p: Vec3 | null) => {
    if (!p) return;
    const path = result.get(id);
    if (path) path.push(p);
    else result.set(id, [p]);
  };
  // Steps hang on the sequence number, so that trails do not crawl.
  for (let i = from; i <= until; ++i) {
    const r = history.at(i)!;
    if (i !== until && r.sequence % step !== 0) continue;
    add("", worldFromCamera(r)?.translation ?? null);
    for (const t of r.result.targets) add(t.targetId, vec3(t.groundCenterM));
  }
  return result;
}
