// SPDX-License-Identifier: Apache-2.0
// A whole video through the tracker, in one call.
import { identifier, mapName, whole } from "./checks.js";
import type { Client, Session } from "./client.js";
import { Code, GroundlockError, badArgument } from "./errors.js";
import { type BoxLike, type CameraModel, cameraOf, checkBox } from "./geometry.js";
import {
  type ImuModel, type InertialSample, checkInertial, imuOf, inertialBetween, inertialSince, readInertial,
} from "./inertial.js";
import { type OpenOptions, connect } from "./localServer.js";
import { writeCsv } from "./tables.js";
import type { Answer, Frame, FrameResult, SessionInfo, SessionOptions, TargetBody, TargetResult } from "./types.js";
import { Video } from "./video.js";

/** The id of the target that `box` marks, as `groundlock track --init-box` has it. */
export const DEFAULT_TARGET = "target";
// Enough frames on the way to hide the wire.
const MAX_IN_FLIGHT = 8;

export interface TrackOptions extends OpenOptions {
  readonly map: string | null; // null = in the image only
  /** The target's box, px, in the frame `boxFrame` (left out = the first). */
  readonly box?: BoxLike;
  readonly boxFrame?: number;
  /** What is known of it. */
  readonly body?: TargetBody;
  /** Further ones, by their ids. */
  readonly targets?: Readonly<
    Record<string, { readonly box: BoxLike; readonly frame?: number; readonly body?: TargetBody }>
  >;
  /** Or the path of a camera.json; left out = the map's own lens. */
  readonly camera?: CameraModel | string;
  /** The unit on the camera, or the path of its imu.json. */
  readonly imu?: ImuModel | string;
  /** What it recorded, or the path of EuRoC's data.csv. */
  readonly inertial?: readonly InertialSample[] | string;
  /** What the unit's clock says when the video's says 0. */
  readonly imuEpochNs?: bigint;
  readonly options?: SessionOptions;
  readonly first?: number; // frames [first, last) of the video
  readonly last?: number;
  readonly fps?: number; // of a folder of images
  /** Called with each answer as it comes; throwing ends the run. */
  readonly onAnswer?: (answer: Answer) => void;
  /** The connection to use; without one, as connect() does. */
  readonly client?: Client;
}

/** What became of a video. */
export class TrackRun {
  constructor(
    readonly session: SessionInfo, // as it began
    readonly answers: readonly Answer[], // one for each frame, in order
    readonly captureTimesNs: ReadonlyMap<number, bigint>, // by sequence
    readonly targetErrors: ReadonlyMap<string, string>, // targets that could not be started
    readonly numReconnects: number,
  ) {}

  /** Of the frames that were processed. */
  get results(): FrameResult[] {
    return this.answers.filter((a): a is FrameResult => a.kind === "result");
  }

  /** A target in the frames that have it. */
  target(targetId: string = DEFAULT_TARGET): (TargetResult & { readonly sequence: number })[] {
    return this.results.flatMap((r) =>
      r.targets.filter((t) => t.targetId === targetId).map((t) => ({ ...t, sequence: r.sequence })),
    );
  }

  /** As `groundlock track --results` writes it; returns the rows. */
  writeCsv(path: string): number {
    return writeCsv(path, this.answers, this.captureTimesNs);
  }
}

/** Tracks what `box` marks through a video, a folder of images, a URL or a V4L2
 * device, and resolves to all answers. */
export async function track(source: string, options: TrackOptions): Promise<TrackRun> {
  const wanted = targetsOf(options);
  if (options.map !== null) mapName("map", options.map);
  const inertial = inertialOf(options);
  const { first, last, fps } = options;
  const video = await Video.open(source, {
    ...(first === undefined ? {} : { first }),
    ...(last === undefined ? {} : { last }),
    ...(fps === undefined ? {} : { fps }),
  });
  const camera = options.camera === undefined ? undefined : cameraOf("camera", options.camera);
  if (camera && (camera.widthPx !== video.widthPx || camera.heightPx !== video.heightPx)) {
    throw badArgument(
      "camera",
      `is for ${camera.widthPx}x${camera.heightPx}, but frames of ${source} are ${video.widthPx}x${video.heightPx}`,
    );
  }
  const client = options.client ?? (await connect(connectOptions(options)));
  try {
    const session = await client.createSession({
      map: options.map,
      ...(camera ? { camera } : {}),
      options: { ...options.options, ...(options.imu !== undefined && { imu: imuOf("imu", options.imu) }) },
    });
    try {
      for (const [id, { box, frame, body }] of wanted) await session.setTarget(id, box, { sequence: frame, body });
      return await runThrough(video, session, new Set(wanted.keys()), inertial, options.onAnswer);
    } finally {
      await session.delete().catch(() => undefined); // ended by itself, or the first error says more
    }
  } finally {
    if (!options.client) await client.close();
  }
}

function connectOptions(options: TrackOptions): OpenOptions {
  const { server, local, token, tokenFile, tls, connectTimeoutMs, callTimeoutMs, maxMessageBytes } = options;
  const all = { server, local, token, tokenFile, tls, connectTimeoutMs, callTimeoutMs, maxMessageBytes };
  return Object.fromEntries(Object.entries(all).filter(([, value]) => value !== undefined));
}

async function runThrough(
  video: Video,
  session: Session,
  wanted: ReadonlySet<string>,
  inertial: readonly InertialSample[] | undefined,
  onAnswer: ((answer: Answer) => void) | undefined,
): Promise<TrackRun> {
  const info = await session.info();
  const answers: Answer[] = [];
  const times = new Map<number, bigint>();
  const errors = new Map<string, string>();
  async function* frames(): AsyncGenerator<Frame> {
    let previousNs: bigint | undefined;
    for await (const frame of video) {
      times.set(frame.sequence, frame.captureTimeNs);
      yield inertial ? { ...frame, inertial: inertialBetween(inertial, previousNs, frame.captureTimeNs) } : frame;
      previousNs = frame.captureTimeNs;
    }
  }
  const stream = await session.stream({ maxInFlight: MAX_IN_FLIGHT });
  try {
    for await (const answer of stream.process(frames())) {
      answers.push(answer);
      if (answer.kind === "result") {
        for (const { targetId, message } of answer.targetErrors) errors.set(targetId, message);
      }
      onAnswer?.(answer);
      // Nothing left to follow: the rest would be for nothing.
      if (wanted.size > 0 && [...wanted].every((id) => errors.has(id))) {
        const id = [...wanted][0] as string;
        throw new GroundlockError(Code.INVALID_ARGUMENT, `target ${id}: ${errors.get(id)}`, `targets.${id}`);
      }
    }
  } finally {
    await stream.cancel();
  }
  if (answers.length === 0) throw badArgument("video", `${video.source}: no frames in the range`);
  const failed = answers[0];
  if (failed?.kind === "failed" && answers.every((a) => a.kind === "failed")) throw failed.error;
  return new TrackRun(info, answers, times, errors, stream.numReconnects);
}

function inertialOf({ imu, inertial, imuEpochNs = 0n }: TrackOptions): InertialSample[] | undefined {
  if (imu === undefined && inertial === undefined) return undefined;
  if (imu === undefined) throw badArgument("imu", "is missing: inertial needs it");
  if (inertial === undefined) throw badArgument("inertial", "is missing: imu needs it");
  if (typeof imuEpochNs !== "bigint") throw badArgument("imuEpochNs", `${String(imuEpochNs)} must be a bigint`);
  const samples = typeof inertial === "string" ? readInertial(inertial) : checkInertial("inertial", inertial);
  return inertialSince(samples, imuEpochNs);
}

interface Mark {
  readonly box: BoxLike;
  readonly frame: number;
  readonly body: TargetBody | undefined;
}

function targetsOf(options: TrackOptions): Map<string, Mark> {
  const first = whole("first", options.first ?? 0);
  const found = new Map<string, Mark>();
  if (options.box !== undefined) {
    found.set(DEFAULT_TARGET, {
      box: checkBox("box", options.box),
      frame: whole("boxFrame", options.boxFrame ?? first),
      body: options.body,
    });
  } else if (options.boxFrame !== undefined) {
    throw badArgument("boxFrame", "is the frame of `box`, which is missing");
  } else if (options.body !== undefined) {
    throw badArgument("body", "is that of what `box` marks, which is missing");
  }
  for (const [id, target] of Object.entries(options.targets ?? {})) {
    const field = `targets.${id}`;
    identifier(field, id);
    if (found.has(id)) throw badArgument(field, "is the name of the target that `box` marks");
    found.set(id, {
      box: checkBox(`${field}.box`, target?.box),
      frame: whole(`${field}.frame`, target.frame ?? first),
      body: target.body,
    });
  }
  for (const [id, { frame }] of found) {
    if (frame < first || (options.last !== undefined && frame >= options.last)) {
      const field = id === DEFAULT_TARGET && options.box !== undefined ? "boxFrame" : `targets.${id}.frame`;
      throw badArgument(field, `${frame} is not among the frames [${first}, ${options.last ?? "end"})`);
    }
  }
  return found;
}
