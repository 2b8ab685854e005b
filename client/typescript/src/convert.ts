// SPDX-License-Identifier: Apache-2.0
// Between the messages and the plain objects. What goes out is checked; errors
// name the field.
import { create } from "@bufbuild/protobuf";
import type { Timestamp } from "@bufbuild/protobuf/wkt";
import { aboveZero, choice, finite, identifier, mapName, whole } from "./checks.js";
import { Code, GroundlockError, badArgument, errorOf } from "./errors.js";
import * as g from "./geometry.js";
import * as gp from "./gen/groundlock/v1/geometry_pb.js";
import * as mp from "./gen/groundlock/v1/maps_pb.js";
import * as tp from "./gen/groundlock/v1/tracking_pb.js";
import { type Encoding, type Image, imageOf } from "./images.js";
import { type ImuModel, MAX_SAMPLES_PER_FRAME, checkInertial, imuOf } from "./inertial.js";
import type * as t from "./types.js";

const CAMERAS = Object.fromEntries(
  Object.keys(g.CAMERA_MODELS).map((name) => [name, gp.CameraModelId[name as g.CameraModelName]]),
) as Record<g.CameraModelName, gp.CameraModelId>;
const ENCODINGS: Record<Encoding, tp.ImageEncoding> = {
  auto: tp.ImageEncoding.UNSPECIFIED,
  jpeg: tp.ImageEncoding.JPEG,
  png: tp.ImageEncoding.PNG,
  gray8: tp.ImageEncoding.RAW_GRAY8,
  bgr8: tp.ImageEncoding.RAW_BGR8,
  rgb8: tp.ImageEncoding.RAW_RGB8,
};
const FLOWS: Record<t.FlowMode, tp.FlowMode> = { lossless: tp.FlowMode.LOSSLESS, live: tp.FlowMode.LIVE };
// What the protocol may say; the compiler asks for whatever it learns.
type Words<E> = Exclude<keyof E, "UNSPECIFIED">;
const CAMERA_STATES: Record<t.CameraState & Words<typeof tp.CameraState>, tp.CameraState> = {
  INITIALIZING: tp.CameraState.INITIALIZING,
  TRACKED: tp.CameraState.TRACKED,
  ODOMETRY: tp.CameraState.ODOMETRY,
  HELD: tp.CameraState.HELD,
  LOST: tp.CameraState.LOST,
} satisfies Record<Words<typeof tp.CameraState>, tp.CameraState>;
const TARGET_STATES: Record<t.TargetState & Words<typeof tp.TargetState>, tp.TargetState> = {
  TRACKED: tp.TargetState.TRACKED,
  PREDICTED: tp.TargetState.PREDICTED,
  LOST: tp.TargetState.LOST,
} satisfies Record<Words<typeof tp.TargetState>, tp.TargetState>;
const BODY_KINDS: Record<t.BodyKind & Words<typeof tp.BodyKind>, tp.BodyKind> = {
  CAR: tp.BodyKind.CAR,
  VAN: tp.BodyKind.VAN,
  TRUCK: tp.BodyKind.TRUCK,
  BUS: tp.BodyKind.BUS,
  MOTORCYCLE: tp.BodyKind.MOTORCYCLE,
  BICYCLE: tp.BodyKind.BICYCLE,
  PERSON: tp.BodyKind.PERSON,
  BOAT: tp.BodyKind.BOAT,
} satisfies Record<Words<typeof tp.BodyKind>, tp.BodyKind>;
export const MAP_FORMATS: Record<t.MapFormat, mp.MapFormat> = {
  auto: mp.MapFormat.UNSPECIFIED,
  colmap: mp.MapFormat.COLMAP,
  nvm: mp.MapFormat.NVM,
  bundler: mp.MapFormat.BUNDLER,
  openmvg: mp.MapFormat.OPENMVG,
  opensfm: mp.MapFormat.OPENSFM,
  groundlock: mp.MapFormat.GROUNDLOCK,
};
export const EXPORT_FORMATS: Record<t.MapExportFormat, mp.MapExportFormat> = {
  colmap: mp.MapExportFormat.COLMAP,
  "colmap-text": mp.MapExportFormat.COLMAP_TEXT,
  nvm: mp.MapExportFormat.NVM,
  ply: mp.MapExportFormat.PLY,
  groundlock: mp.MapExportFormat.GROUNDLOCK,
};

const GROUND_STATES: Partial<Record<mp.GroundState, t.MapInfo["groundState"]>> = {
  [mp.GroundState.ESTIMATED]: "estimated",
  [mp.GroundState.MEASURED]: "measured",
};

/** The name that stands for a number of the wire. */
function named<K extends string>(what: string, value: number, table: Readonly<Record<K, number>>): K {
  for (const name in table) if (table[name] === value) return name;
  throw new GroundlockError(Code.INTERNAL, `the server sent ${what} ${value}, which is not known here`);
}

/** A message field that must be there. */
function given<T>(what: string, value: T | undefined): T {
  if (value === undefined) throw new GroundlockError(Code.INTERNAL, `the server sent no ${what}`);
  return value;
}

// --- outwards -------------------------------------------------------------------

export function vectorTo(field: string, value: unknown): gp.Vector3 {
  const [x, y, z] = g.checkVector(field, value);
  return create(gp.Vector3Schema, { x, y, z });
}
export function bodyTo(field: string, value: t.TargetBody): tp.TargetBody {
  if (typeof value !== "object" || value === null) throw badArgument(field, "is no body: { kind, sizeM }");
  const body = create(tp.TargetBodySchema);
  if (value.kind !== undefined) body.kind = choice(`${field}.kind`, value.kind, BODY_KINDS);
  if (value.sizeM !== undefined) {
    for (const extent of g.checkVector(`${field}.sizeM`, value.sizeM)) aboveZero(`${field}.sizeM`, extent);
    body.sizeM = vectorTo(`${field}.sizeM`, value.sizeM);
  }
  return body;
}
export function quaternionTo(field: string, value: g.Quaternion): gp.Quaternion {
  return create(gp.QuaternionSchema, g.checkQuaternion(field, value));
}
export function similarityTo(field: string, value: g.SimilarityTransform): gp.SimilarityTransform {
  const s = g.checkSimilarity(field, value);
  return create(gp.SimilarityTransformSchema, {
    scale: s.scale,
    rotation: s.rotation,
    translation: vectorTo(field, s.translation),
  });
}
export function placeTo(field: string, value: g.GeodeticPosition): gp.GeodeticPosition {
  const { latitudeDeg, longitudeDeg, heightM } = g.checkPlace(field, value);
  return create(gp.GeodeticPositionSchema, { latitudeDeg, longitudeDeg, heightM });
}
export function boxTo(field: string, value: g.BoxLike): gp.Box2 {
  const { x, y, width, height } = g.checkBox(field, value);
  return create(gp.Box2Schema, { x, y, width, height });
}
export function cameraTo(field: string, value: g.CameraModel | string): gp.CameraModel {
  const c = g.cameraOf(field, value);
  return create(gp.CameraModelSchema, {
    model: CAMERAS[c.model],
    widthPx: c.widthPx,
    heightPx: c.heightPx,
    params: [...c.params],
  });
}
export function imageTo(field: string, value: t.Frame["image"]): tp.Image {
  const i = imageOf(field, value);
  return create(tp.ImageSchema, {
    encoding: ENCODINGS[i.encoding],
    data: i.data as Uint8Array<ArrayBuffer>,
    widthPx: i.widthPx,
    heightPx: i.heightPx,
  });
}

export function optionsTo(options: t.SessionOptions): tp.SessionOptions {
  const message = create(tp.SessionOptionsSchema, {
    localizer: options.localizer ?? "",
    tracker: options.tracker ?? "",
    flowMode: choice("options.flowMode", options.flowMode ?? "lossless", FLOWS),
    seed: BigInt(whole("options.seed", options.seed ?? 0)),
    reportMatches: options.reportMatches ?? false,
    reportMovers: options.reportMovers ?? false,
  });
  if (options.confidenceThreshold !== undefined) {
    const value = finite("options.confidenceThreshold", options.confidenceThreshold);
    if (value <= 0 || value >= 1) throw badArgument("options.confidenceThreshold", `${value} must be in (0, 1)`);
    message.confidenceThreshold = value;
  }
  if (options.targetLostAfterS !== undefined) {
    message.targetLostAfterS = aboveZero("options.targetLostAfterS", options.targetLostAfterS);
  }
  if (options.cameraLostAfterS !== undefined) {
    const value = finite("options.cameraLostAfterS", options.cameraLostAfterS);
    if (value < 0 || value > 86400) throw badArgument("options.cameraLostAfterS", `${value} must be in [0, 86400]`);
    message.cameraLostAfterS = value;
  }
  if (options.imu !== undefined) message.imu = imuTo("options.imu", options.imu);
  return message;
}

function imuTo(field: string, value: ImuModel | string): tp.ImuModel {
  const { imuFromCamera, ...figures } = imuOf(field, value);
  return create(tp.ImuModelSchema, { imuFromCamera: quaternionTo(`${field}.imuFromCamera`, imuFromCamera), ...figures });
}

export function sessionTo(spec: t.SessionSpec): tp.CreateSessionRequest {
  const request = create(tp.CreateSessionRequestSchema, {
    sessionId: identifier("sessionId", spec.sessionId ?? "", true),
    mapName: spec.map === null ? "" : mapName("map", spec.map),
    mapVersion: BigInt(whole("mapVersion", spec.mapVersion ?? 0)),
    options: optionsTo(spec.options ?? {}),
  });
  if (spec.camera !== undefined) request.camera = cameraTo("camera", spec.camera);
  return request;
}

export function priorTo(prior: t.PosePrior): tp.PosePrior {
  const message = create(tp.PosePriorSchema);
  if (prior.positionM !== undefined && prior.geodeticPosition !== undefined) {
    throw badArgument("prior.geodeticPosition", "goes not together with prior.positionM");
  }
  for (const [part, sigma] of [
    ["positionM", "positionSigmaM"],
    ["geodeticPosition", "geodeticSigmaM"],
    ["rotation", "rotationSigmaRad"],
  ] as const) {
    if (prior[part] === undefined && prior[sigma] === undefined) continue;
    if (prior[part] === undefined) throw badArgument(`prior.${part}`, `is missing: prior.${sigma} is given`);
    if (prior[sigma] === undefined) {
      throw badArgument(`prior.${sigma}`, `is missing: prior.${part} needs it, above 0`);
    }
    message[sigma] = aboveZero(`prior.${sigma}`, prior[sigma]);
  }
  if (prior.positionM) message.positionM = vectorTo("prior.positionM", prior.positionM);
  if (prior.geodeticPosition) {
    message.geodeticPosition = placeTo("prior.geodeticPosition", prior.geodeticPosition);
  }
  if (prior.rotation) message.rotation = quaternionTo("prior.rotation", prior.rotation);
  if (prior.positionArmM !== undefined) {
    if (prior.positionM === undefined && prior.geodeticPosition === undefined) {
      throw badArgument("prior.positionArmM", "goes with prior.positionM or prior.geodeticPosition");
    }
    message.positionArmM = vectorTo("prior.positionArmM", prior.positionArmM);
  }
  return message;
}

const INT64_MAX = (1n << 63n) - 1n;

export function frameTo(frame: t.Frame, sequence: number): tp.TrackRequest {
  const time: unknown = frame.captureTimeNs ?? process.hrtime.bigint();
  if (typeof time !== "bigint" || time < 0n || time > INT64_MAX) {
    throw badArgument("frame.captureTimeNs", `${String(time)} must be a bigint, 0n or more`);
  }
  const value = create(tp.TrackRequest_FrameSchema, {
    sequence: BigInt(sequence),
    captureTimeNs: time,
    image: imageTo("frame.image", frame.image),
  });
  if (frame.camera !== undefined) value.camera = cameraTo("frame.camera", frame.camera);
  if (frame.prior !== undefined) value.prior = priorTo(frame.prior);
  if (frame.inertial !== undefined) {
    const samples = checkInertial("frame.inertial", frame.inertial);
    if (samples.length > MAX_SAMPLES_PER_FRAME) {
      throw badArgument("frame.inertial", `${samples.length} samples; a frame may bring ${MAX_SAMPLES_PER_FRAME}`);
    }
    value.inertial = samples.map((s) =>
      create(tp.InertialSampleSchema, {
        timeNs: s.timeNs,
        angularRateRadS: vectorTo("frame.inertial", s.angularRateRadS),
        accelerationMS2: vectorTo("frame.inertial", s.accelerationMS2 ?? [0, 0, 0]),
      }),
    );
  }
  return create(tp.TrackRequestSchema, { message: { case: "frame", value } });
}

// --- inwards --------------------------------------------------------------------

function timeFrom(stamp: Timestamp | undefined): Date {
  return new Date(stamp === undefined ? 0 : Number(stamp.seconds) * 1e3 + stamp.nanos / 1e6);
}
function vectorFrom(v: gp.Vector3 | undefined): g.Vector3 {
  return [v?.x ?? 0, v?.y ?? 0, v?.z ?? 0];
}
function quaternionFrom(q: gp.Quaternion | undefined): g.Quaternion {
  const { w, x, y, z } = given("rotation", q);
  return { w, x, y, z };
}
function rigidFrom(r: gp.RigidTransform): g.RigidTransform {
  return { rotation: quaternionFrom(r.rotation), translation: vectorFrom(r.translation) };
}
function similarityFrom(s: gp.SimilarityTransform | undefined): g.SimilarityTransform {
  const { scale, rotation, translation } = given("similarity", s);
  return { scale, rotation: quaternionFrom(rotation), translation: vectorFrom(translation) };
}
export function cameraFrom(c: gp.CameraModel | undefined): g.CameraModel {
  const { model, widthPx, heightPx, params } = given("camera", c);
  return { model: named("camera model", model, CAMERAS), widthPx, heightPx, params: [...params] };
}

export function mapFrom(i: mp.MapInfo | undefined): t.MapInfo {
  const m = given("map", i);
  const o = m.origin;
  return {
    name: m.name,
    version: Number(m.version),
    contentHash: m.contentHash,
    createTime: timeFrom(m.createTime),
    sourceFormat: m.sourceFormat,
    metric: m.metric,
    worldFromSource: similarityFrom(m.worldFromSource),
    groundWorld: { normal: vectorFrom(m.groundWorld?.normal), d: m.groundWorld?.d ?? 0 },
    numCameras: Number(m.numCameras),
    numViews: Number(m.numViews),
    numLandmarks: Number(m.numLandmarks),
    numObservations: Number(m.numObservations),
    meanReprojectionErrorPx: m.meanReprojectionErrorPx,
    hasDescriptors: m.hasDescriptors,
    fileBytes: Number(m.fileBytes),
    lens: m.lens && cameraFrom(m.lens),
    groundState: GROUND_STATES[m.groundState] ?? "unknown",
    groundSigmaDeg: m.groundSigmaDeg,
    groundHeightSigma: m.groundHeightSigma,
    groundReliefM: m.groundReliefM,
    groundReliefGiven: m.groundReliefGiven,
    origin: o && { latitudeDeg: o.latitudeDeg, longitudeDeg: o.longitudeDeg, heightM: o.heightM },
  };
}

export function alignReportFrom(a: mp.AlignMapResponse): t.AlignReport {
  return {
    map: mapFrom(a.map),
    newWorldFromWorld: similarityFrom(a.newWorldFromWorld),
    residuals: a.residuals.map((r) => ({ name: r.name, errorM: vectorFrom(r.errorM), used: r.used })),
    rmsErrorM: a.rmsErrorM,
    rmsHorizontalErrorM: a.rmsHorizontalErrorM,
    medianErrorM: a.medianErrorM,
    maxErrorM: a.maxErrorM,
    warnings: [...a.warnings],
    terrain: a.terrain && {
      offsetM: a.terrain.offsetM,
      scatterM: a.terrain.scatterM,
      numGround: Number(a.terrain.numGround),
      numLandmarks: Number(a.terrain.numLandmarks),
    },
  };
}

export function mapCameraFrom(c: mp.GetPointCloudResponse_MapCamera): t.MapCamera {
  return {
    name: c.name,
    camera: cameraFrom(c.camera),
    worldFromCamera: rigidFrom(given("pose", c.worldFromCamera)),
  };
}

export function pointCloudFrom(blocks: readonly mp.GetPointCloudResponse[]): t.PointCloud {
  const counts = blocks.map((b) => Math.min(Math.floor(b.xyzM.length / 3), Math.floor(b.rgb.length / 3)));
  const total = counts.reduce((a, b) => a + b, 0);
  const xyzWorld = new Float32Array(3 * total);
  const rgb = new Uint8Array(3 * total);
  let at = 0;
  blocks.forEach((block, i) => {
    const size = 3 * (counts[i] as number);
    xyzWorld.set(block.xyzM.slice(0, size), at);
    rgb.set(block.rgb.subarray(0, size), at);
    at += size;
  });
  return { xyzWorld, rgb, cameras: blocks.flatMap((b) => b.cameras.map(mapCameraFrom)) };
}

export function sessionFrom(session: tp.Session | undefined): t.SessionInfo {
  const s = given("session", session);
  const o = s.options;
  return {
    sessionId: s.sessionId,
    mapName: s.mapName,
    mapVersion: Number(s.mapVersion),
    camera: s.camera && cameraFrom(s.camera),
    options: {
      localizer: o?.localizer ?? "",
      tracker: o?.tracker ?? "",
      flowMode: o?.flowMode === tp.FlowMode.LIVE ? "live" : "lossless",
      confidenceThreshold: o?.confidenceThreshold,
      targetLostAfterS: o?.targetLostAfterS,
      cameraLostAfterS: o?.cameraLostAfterS,
      seed: Number(o?.seed ?? 0),
      reportMatches: o?.reportMatches ?? false,
      reportMovers: o?.reportMovers ?? false,
      ...(o?.imu && {
        imu: {
          imuFromCamera: quaternionFrom(o.imu.imuFromCamera),
          gyroscopeNoiseRadSSqrtHz: o.imu.gyroscopeNoiseRadSSqrtHz,
          gyroscopeWalkRadS2SqrtHz: o.imu.gyroscopeWalkRadS2SqrtHz,
          gyroscopeBiasRadS: o.imu.gyroscopeBiasRadS,
        },
      }),
    },
    createTime: timeFrom(s.createTime),
    nextSequence: Number(s.nextSequence),
    framesProcessed: Number(s.framesProcessed),
    framesDropped: Number(s.framesDropped),
    framesFailed: Number(s.framesFailed),
    targetIds: [...s.targetIds],
    streaming: s.streaming,
    owner: s.owner,
  };
}

function cameraResultFrom(camera: tp.CameraResult | undefined): t.CameraResult {
  const c = given("camera", camera);
  return {
    state: named("camera state", c.state, CAMERA_STATES),
    worldFromCamera: c.worldFromCamera && rigidFrom(c.worldFromCamera),
    covariance: c.covariance.length === 36 ? [...c.covariance] : undefined,
    numInliers: c.numInliers,
    meanReprojectionErrorPx: c.meanReprojectionErrorPx,
    resetCount: Number(c.resetCount),
    lensContradiction: c.lensContradiction && {
      focalRatio: c.lensContradiction.focalRatio,
      cornerShare: c.lensContradiction.cornerShare,
    },
    ignoresGyroscope: c.ignoresGyroscope,
    matchXyPx: [...c.matchXyPx],
    matchXyzWorld: [...c.matchXyzM],
  };
}

function bodyKindFrom(kind: tp.BodyKind): t.BodyKind | undefined {
  return kind === tp.BodyKind.UNSPECIFIED ? undefined : named("kind of body", kind, BODY_KINDS);
}

function targetFrom(r: tp.TargetResult): t.TargetResult {
  const b = r.box;
  return {
    targetId: r.targetId,
    state: named("target state", r.state, TARGET_STATES),
    confidence: r.confidence,
    box: b && { x: b.x, y: b.y, width: b.width, height: b.height },
    boxWorld: r.boxWorld && {
      worldFromObject: rigidFrom(given("box's pose", r.boxWorld.worldFromObject)),
      sizeM: vectorFrom(r.boxWorld.sizeM),
    },
    groundCenterM: r.groundCenterM && vectorFrom(r.groundCenterM),
    headingRad: r.headingRad,
    groundCovarianceM2: r.groundCovarianceM2.length === 4 ? [...r.groundCovarianceM2] : undefined,
    velocityWorldMS: r.velocityWorldMS && vectorFrom(r.velocityWorldMS),
    ageS: r.ageS,
    headingSigmaRad: r.headingSigmaRad,
    frontKnown: r.frontKnown,
    sizeCovarianceM2: r.sizeCovarianceM2.length === 9 ? [...r.sizeCovarianceM2] : undefined,
    bodyKind: bodyKindFrom(r.bodyKind),
  };
}

const MOVERS_STATES: Readonly<Record<number, t.MoversState>> = {
  [tp.MoversState.UNSPECIFIED]: "NOT_ASKED",
  [tp.MoversState.WATCHING]: "WATCHING",
  [tp.MoversState.STARTING]: "STARTING",
  [tp.MoversState.NO_MAP]: "NO_MAP",
  [tp.MoversState.NO_GROUND]: "NO_GROUND",
  [tp.MoversState.NO_POSE]: "NO_POSE",
  [tp.MoversState.POSE_CONTRADICTED]: "POSE_CONTRADICTED",
};

function moverFrom(m: tp.Mover): t.Mover {
  const { x, y, width, height } = given("mover's box", m.box);
  return {
    moverId: Number(m.moverId),
    box: { x, y, width, height },
    groundCenterM: vectorFrom(m.groundCenterM),
    groundCovarianceM2: [...m.groundCovarianceM2],
    velocityWorldMS: vectorFrom(m.velocityWorldMS),
    velocityCovarianceM2S2: [...m.velocityCovarianceM2S2],
    confidence: m.confidence,
  };
}

function timesFrom(s: tp.StageTimes | undefined): t.StageTimes {
  return {
    queueMs: s?.queueMs ?? 0,
    decodeMs: s?.decodeMs ?? 0,
    localizeMs: s?.localizeMs ?? 0,
    trackMs: s?.trackMs ?? 0,
    totalMs: s?.totalMs ?? 0,
    moversMs: s?.moversMs ?? 0,
  };
}

export function resultFrom(result: tp.FrameResult | undefined): t.FrameResult {
  const f = given("result", result);
  return {
    kind: "result",
    sequence: Number(f.sequence),
    captureTimeNs: f.captureTimeNs,
    camera: cameraResultFrom(f.camera),
    targets: f.targets.map(targetFrom),
    mapVersion: Number(f.mapVersion),
    times: timesFrom(f.times),
    targetErrors: f.targetErrors.map((e) => ({ targetId: e.targetId, message: e.message })),
    movers: f.movers.map(moverFrom),
    // A newer server may have reasons that this client does not know.
    moversState: MOVERS_STATES[f.moversState] ?? "NOT_ASKED",
  };
}

/** The answer in a TrackResponse. */
export function answerFrom(response: tp.TrackResponse): t.Answer {
  const m = response.message;
  switch (m.case) {
    case "result":
      return resultFrom(m.value);
    case "error":
      return { kind: "failed", sequence: Number(m.value.sequence), error: errorOf(m.value.code, m.value.message) };
    case "dropped": {
      const reasons = tp.FrameDropped_Reason;
      const reason =
        m.value.reason === reasons.OVERLOAD ? "overload" : m.value.reason === reasons.SHUTDOWN ? "shutdown" : "unknown";
      return { kind: "dropped", sequence: Number(m.value.sequence), reason };
    }
    default:
      throw new GroundlockError(Code.INTERNAL, `the server sent an answer of kind ${m.case}`);
  }
}

export function imageFrom(i: tp.Image): Image {
  return {
    encoding: named("image encoding", i.encoding, ENCODINGS),
    data: i.data,
    widthPx: i.widthPx,
    heightPx: i.heightPx,
  };
}

export function watchFrom(w: tp.WatchSessionResponse): t.WatchUpdate {
  return { result: resultFrom(w.result), image: w.image && imageFrom(w.image), skipped: Number(w.skipped) };
}

export function localizeFrom(l: tp.LocalizeResponse): t.LocalizeReport {
  return { camera: cameraResultFrom(l.camera), mapVersion: Number(l.mapVersion), times: timesFrom(l.times) };
}
