// SPDX-License-Identifier: Apache-2.0
// Frames as a server sends them.
import { create, type MessageInitShape } from "@bufbuild/protobuf";
import { FrameResultSchema } from "../src/gen/groundlock/v1/tracking_pb";
import { makeRecord, type FrameRecord } from "../src/data/frame";

export function frame(
  sequence: number,
  timeS: number,
  rest: MessageInitShape<typeof FrameResultSchema> = {},
  skipped = 0,
): FrameRecord {
  return makeRecord(
    create(FrameResultSchema, {
      ...rest,
      sequence: BigInt(sequence),
      captureTimeNs: BigInt(Math.round(timeS * 1e9)),
    }),
    skipped,
  );
}
