// SPDX-License-Identifier: Apache-2.0
// Answers as a table: one row for each frame and target, with the columns and
// digits of `groundlock track --results`; empty = there is none.
import { renameSync, rmSync, writeFileSync } from "node:fs";
import type { Answer, CameraResult, StageTimes, TargetResult } from "./types.js";

// Name and decimals; undefined = text or a whole number.
const COLUMN_DECIMALS: Readonly<Record<string, number | undefined>> = {
  frame: undefined, t_s: 6, camera_state: undefined,
  cam_x: 6, cam_y: 6, cam_z: 6, cam_qw: 9, cam_qx: 9, cam_qy: 9, cam_qz: 9, inliers: undefined,
  target: undefined, target_state: undefined, confidence: 4, box_x: 3, box_y: 3, box_w: 3, box_h: 3,
  ground_x: 6, ground_y: 6, ground_z: 6, heading_rad: 6, length_m: 4, width_m: 4, height_m: 4,
  decode_ms: 3, localize_ms: 3, track_ms: 3, total_ms: 3,
};
export const COLUMNS: readonly string[] = Object.keys(COLUMN_DECIMALS);

/** A value for each column that there is one of. */
export type Row = Record<string, string | number>;

function cameraRow(camera: CameraResult): Row {
  const row: Row = { camera_state: camera.state, inliers: Math.max(0, camera.numInliers) };
  const pose = camera.worldFromCamera;
  if (pose) {
    const [cam_x, cam_y, cam_z] = pose.translation;
    const { w: cam_qw, x: cam_qx, y: cam_qy, z: cam_qz } = pose.rotation;
    Object.assign(row, { cam_x, cam_y, cam_z, cam_qw, cam_qx, cam_qy, cam_qz });
  }
  return row;
}

function targetRow(target: TargetResult): Row {
  const row: Row = { target: target.targetId, target_state: target.state, confidence: target.confidence };
  if (target.box) {
    const { x: box_x, y: box_y, width: box_w, height: box_h } = target.box;
    Object.assign(row, { box_x, box_y, box_w, box_h });
  }
  if (target.groundCenterM) {
    const [ground_x, ground_y, ground_z] = target.groundCenterM;
    Object.assign(row, { ground_x, ground_y, ground_z, heading_rad: target.headingRad });
  }
  if (target.boxWorld) {
    const [length_m, width_m, height_m] = target.boxWorld.sizeM;
    Object.assign(row, { length_m, width_m, height_m });
  }
  return row;
}

function timesRow(times: StageTimes): Row {
  const { decodeMs: decode_ms, localizeMs: localize_ms, trackMs: track_ms, totalMs: total_ms } = times;
  return { decode_ms, localize_ms, track_ms, total_ms };
}

/** captureTimesNs: by sequence, of frames that failed or were dropped: their
 * answers have none. */
export function* rows(answers: Iterable<Answer>, captureTimesNs?: ReadonlyMap<number, bigint>): Generator<Row> {
  for (const answer of answers) {
    const time = answer.kind === "result" ? answer.captureTimeNs : captureTimesNs?.get(answer.sequence);
    const row: Row = { frame: answer.sequence, ...(time === undefined ? {} : { t_s: 1e-9 * Number(time) }) };
    if (answer.kind !== "result") {
      yield row;
      continue;
    }
    const common = { ...row, ...cameraRow(answer.camera), ...timesRow(answer.times) };
    if (answer.targets.length === 0) yield common;
    for (const target of answer.targets) yield { ...common, ...targetRow(target) };
  }
}

function text(name: string, value: string | number | undefined): string {
  if (value === undefined) return "";
  if (typeof value === "string") return /[",\r\n]/.test(value) ? `"${value.replaceAll('"', '""')}"` : value;
  const decimals = COLUMN_DECIMALS[name];
  if (!Number.isFinite(value)) return "";
  return decimals === undefined ? String(value) : value.toFixed(decimals);
}

/** Writes the table, whole or not at all; returns the number of rows. */
export function writeCsv(path: string, answers: Iterable<Answer>, captureTimesNs?: ReadonlyMap<number, bigint>): number {
  const lines = [COLUMNS.join(",")];
  for (const row of rows(answers, captureTimesNs)) lines.push(COLUMNS.map((name) => text(name, row[name])).join(","));
  const scratch = `${path}.${process.pid}.part`;
  try {
    writeFileSync(scratch, `${lines.join("\n")}\n`);
    renameSync(scratch, path);
  } catch (error) {
    rmSync(scratch, { force: true });
    throw error;
  }
  return lines.length - 1;
}
