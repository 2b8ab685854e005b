// SPDX-License-Identifier: Apache-2.0
// A history as lanes of coloured runs: one for the camera, one per target.
import { cameraState, CameraState, TargetState } from "./frame";
import type { FrameHistory } from "./history";

// In words and as a style token.
export type Tone = "good" | "warn" | "bad" | "idle";

export interface Run {
  readonly fromS: number;
  toS: number;
  readonly tone: Tone;
}
export interface Lane {
  readonly id: string; // "" = the camera
  readonly runs: readonly Run[];
}

// Frames farther apart leave a gap, s.
const MAX_GAP_S = 0.5;

export function cameraTone(state: CameraState): Tone {
  switch (state) {
    case CameraState.TRACKED: return "good";
    case CameraState.HELD: return "warn";
    case CameraState.ODOMETRY: return "warn";
    case CameraState.LOST: return "bad";
    default: return "idle";
  }
}

export function targetTone(state: TargetState): Tone {
  switch (state) {
    case TargetState.TRACKED: return "good";
    case TargetState.PREDICTED: return "warn";
    case TargetState.LOST: return "bad";
    default: return "idle";
  }
}

export function cameraWords(state: CameraState): string {
  switch (state) {
    case CameraState.INITIALIZING: return "looking for itself";
    case CameraState.TRACKED: return "localised";
    case CameraState.HELD: return "held";
    case CameraState.ODOMETRY: return "beyond the map";
    case CameraState.LOST: return "lost";
    default: return "no map";
  }
}

// What the frames say of the session's lens; "" while they do not contradict it.
export function lensWords(seen: { focalRatio: number; cornerShare: number } | undefined): string {
  if (!seen) return "";
  const words: string[] = [];
  if (seen.focalRatio !== 1) words.push(`focal length × ${seen.focalRatio.toFixed(2)}`);
  if (seen.cornerShare !== 0) words.push(`corners ${seen.cornerShare > 0 ? "+" : "−"}${Math.abs(100 * seen.cornerShare).toFixed(0)} %`);
  return `another lens: ${words.join(", ")}`;
}

export function targetWords(state: TargetState, ageS: number): string {
  switch (state) {
    case TargetState.TRACKED: return "seen";
    case TargetState.PREDICTED: return `predicted for ${ageS.toFixed(1)} s`;
    case TargetState.LOST: return `lost for ${ageS.toFixed(0)} s`;
    default: return "unknown";
  }
}

class LaneBuilder {
  readonly runs: Run[] = [];
  add(timeS: number, untilS: number, tone: Tone): void {
    const last = this.runs[this.runs.length - 1];
    if (last && last.tone === tone && timeS - last.toS < 1e-6) last.toS = untilS;
    else this.runs.push({ fromS: timeS, toS: untilS, tone });
  }
}

// Lanes of the frames between two times; targets in order of appearance.
export function buildLanes(history: FrameHistory, fromS: number, toS: number): Lane[] {
  const camera = new LaneBuilder();
  const targets = new Map<string, LaneBuilder>();
  let step = 1 / 24;
  for (let i = Math.max(0, history.indexAt(fromS)); i < history.length; ++i) {
    const record = history.at(i)!;
    if (record.timeS > toS) break;
    const next = history.at(i + 1);
    if (next && next.timeS - record.timeS < MAX_GAP_S) step = next.timeS - record.timeS;
    const until = record.timeS + step;
    camera.add(record.timeS, until, cameraTone(cameraState(record)));
    for (const target of record.result.targets) {
      let lane = targets.get(target.targetId);
      if (!lane) targets.set(target.targetId, (lane = new LaneBuilder()));
      lane.add(record.timeS, until, targetTone(target.state));
    }
  }
  return [
    { id: "", runs: camera.runs },
    ...[...targets].map(([id, lane]) => ({ id, runs: lane.runs })),
  ];
}

// Round steps for an axis that is span wide, with at most `count` ticks.
export function tickStep(span: number, count: number): number {
  const rough = span / Math.max(1, count);
  for (const step of [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 1200, 3600]) {
    if (step >= rough) return step;
  }
  return 7200;
}

export function clock(seconds: number): string {
  const s = Math.max(0, seconds);
  const whole = Math.floor(s);
  const minutes = Math.floor(whole / 60);
  const tail = `${String(whole % 60).padStart(2, "0")}`;
  const hours = Math.floor(minutes / 60);
  return hours > 0
    ? `${hours}:${String(minutes % 60).padStart(2, "0")}:${tail}`
    : `${minutes}:${tail}`;
}
