// SPDX-License-Identifier: Apache-2.0
// One frame as the page keeps it, and short ways to what is in it.
import type {
  Box3 as ProtoBox3,
  RigidTransform,
  Vector3,
} from "../gen/groundlock/v1/geometry_pb";
import type { CameraModel } from "../gen/groundlock/v1/geometry_pb";
import {
  CameraState,
  MoversState,
  TargetState,
  type FrameResult,
  type Mover,
  type TargetResult,
} from "../gen/groundlock/v1/tracking_pb";
import { Camera } from "../math/camera";
import type { Box3 } from "../math/box3";
import { normalize, type Rigid, type Vec3 } from "../math/pose";

export { CameraState, MoversState, TargetState };
export type { FrameResult, Mover, TargetResult };

export interface FrameRecord {
  readonly sequence: number;
  // Seconds on the history's axis: the capture time, made to rise.
  timeS: number;
  readonly captureNs: bigint;
  readonly result: FrameResult;
  readonly skipped: number; // results left out before this one
  readonly hasImage: boolean;
  // The dashboard's clock when it got the result; 0 = not known.
  readonly receivedNs: bigint;
}

export function makeRecord(
  result: FrameResult,
  skipped = 0,
  hasImage = false,
  receivedNs = 0n,
): FrameRecord {
  return {
    sequence: Number(result.sequence),
    timeS: Number(result.captureTimeNs) / 1e9,
    captureNs: result.captureTimeNs,
    result,
    skipped,
    hasImage,
    receivedNs,
  };
}

export function vec3(v: Vector3 | undefined): Vec3 | null {
  return v ? [v.x, v.y, v.z] : null;
}

export function rigid(t: RigidTransform | undefined): Rigid | null {
  if (!t?.rotation || !t.translation) return null;
  const { w, x, y, z } = t.rotation;
  return {
    rotation: normalize([w, x, y, z]),
    translation: [t.translation.x, t.translation.y, t.translation.z],
  };
}

export function box3(b: ProtoBox3 | undefined): Box3 | null {
  const worldFromObject = rigid(b?.worldFromObject);
  const size = vec3(b?.sizeM);
  return worldFromObject && size ? { worldFromObject, size } : null;
}

// Null for a camera that is missing or makes no sense.
export function cameraOf(model: CameraModel | undefined): Camera | null {
  if (!model) return null;
  try {
    return new Camera({
      model: model.model as number,
      width: model.widthPx,
      height: model.heightPx,
      params: model.params,
    });
  } catch {
    return null;
  }
}

export function worldFromCamera(record: FrameRecord): Rigid | null {
  return rigid(record.result.camera?.worldFromCamera);
}

export function cameraState(record: FrameRecord): CameraState {
  return record.result.camera?.state ?? CameraState.UNSPECIFIED;
}

export function targetOf(record: FrameRecord, id: string): TargetResult | undefined {
  return record.result.targets.find((t) => t.targetId === id);
}
