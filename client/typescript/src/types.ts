// SPDX-License-Identifier: Apache-2.0
// Maps, sessions, frames and the answers to them; units and frames as in
// geometry.
import type {
  Box2, Box3, CameraModel, GeodeticPosition, Plane, Quaternion, RigidTransform, SimilarityTransform, Vector3,
} from "./geometry.js";
import type { GroundlockError } from "./errors.js";
import type { Image, ImageLike } from "./images.js";
import type { ImuModel, InertialSample } from "./inertial.js";

// --- maps ---------------------------------------------------------------------

export type MapFormat = "auto" | "colmap" | "nvm" | "bundler" | "openmvg" | "opensfm" | "groundlock";
/** colmap, colmap-text: a folder; groundlock: the map file itself (.glmap). */
export type MapExportFormat = "colmap" | "colmap-text" | "nvm" | "ply" | "groundlock";

/** A version of a map. */
export interface MapInfo {
  readonly name: string;
  readonly version: number;
  readonly contentHash: string;
  readonly createTime: Date;
  readonly sourceFormat: string;
  readonly metric: boolean; // world is in metres
  readonly worldFromSource: SimilarityTransform;
  readonly groundWorld: Plane;
  readonly numCameras: number;
  readonly numViews: number;
  readonly numLandmarks: number;
  readonly numObservations: number;
  readonly meanReprojectionErrorPx: number;
  readonly hasDescriptors: boolean; // without them no camera can be localised
  readonly fileBytes: number;
  readonly origin: GeodeticPosition | undefined; // world is east, north, up of it
  /** Of all its images, if they have one and the same: sessions that name no
   * camera take it. */
  readonly lens: CameraModel | undefined;
  /** unknown: sessions give no boxes in the world; estimated: found in the map;
   * measured: given with the world. */
  readonly groundState: "unknown" | "estimated" | "measured";
  readonly groundSigmaDeg: number; // of its tilt about any axis in it; 0 = not stated
  readonly groundHeightSigma: number; // of its cameras' mean height over it, as a share of that; 0 = not stated
  readonly groundReliefM: number; // by which its heights differ; 0 = it is the plane
  readonly groundReliefGiven: boolean; // they are a terrain's, not what landmarks tell
}

/** How far a long call is. A callback that throws ends the call, which leaves
 * nothing behind; what it threw goes on to the caller. */
export interface Progress {
  readonly stage: string; // "uploading", "importing", "preparing", "aligning", "downloading", or a build's
  readonly fraction: number; // of this stage, 0 to 1
  readonly note: string;
  readonly bytesDone: number;
  readonly bytesTotal: number;
}
export type OnProgress = (progress: Progress) => void;

export interface ImportReport {
  readonly map: MapInfo;
  readonly warnings: readonly string[];
}
export interface BuildReport extends ImportReport {
  readonly report: unknown; // as `groundlock map build --json` prints it
}
export interface MapCheck {
  readonly map: MapInfo | undefined; // undefined if the file cannot even be opened
  readonly problems: readonly string[]; // empty = the map is sound
}

/** A mapping image: its lens and where it was taken. */
export interface MapCamera {
  readonly name: string;
  readonly camera: CameraModel;
  readonly worldFromCamera: RigidTransform;
}
/** Landmarks: x, y, z and red, green, blue of each. */
export interface PointCloud {
  readonly xyzWorld: Float32Array;
  readonly rgb: Uint8Array;
  readonly cameras: readonly MapCamera[];
}

/** A measured place: in the new world, m, or on Earth. */
export type Place = Vector3 | GeodeticPosition;
/** A point of the map: its place in the present world, or its pixels in two or
 * more mapping images. */
export type MapPoint =
  | { readonly positionWorld: Vector3 }
  | { readonly pixels: readonly { readonly image: string; readonly xPx: number; readonly yPx: number }[] };

/** How a map gets its new world; see docs/api.md. */
export type AlignMethod =
  | { readonly newWorldFromSource: SimilarityTransform }
  | { readonly newWorldFromWorld: SimilarityTransform }
  | { readonly knownDistance: { readonly from: MapPoint; readonly to: MapPoint; readonly distanceM: number } }
  | { readonly controlPoints: readonly { readonly name: string; readonly point: MapPoint; readonly place: Place }[] }
  | { readonly cameraPositions: Readonly<Record<string, Place>>; readonly accuracyM?: number };

/** Heights of the ground, say of an elevation model, in the map's present world,
 * which must be metric with z up: on a regular grid over x and y. Stays with the
 * map until it is aligned anew. */
export interface Terrain {
  readonly firstXM: number; // of the first height
  readonly firstYM: number;
  readonly stepM: number;
  readonly columns: number; // along x; at least 3, as rows are
  readonly zM: readonly number[] | Float32Array; // row by row along y; NaN = unknown
  readonly sigmaM?: number; // else as the map's own ground scatters about it
  readonly fitHeight?: boolean; // move it to the ground that the landmarks show
}

export interface AlignOptions {
  readonly origin?: GeodeticPosition;
  /** In the present world: a point on the ground, its plane, or (with no method)
   * its heights. */
  readonly ground?: "automatic" | Vector3 | Plane | Terrain;
  readonly version?: number;
  readonly seed?: number;
  readonly reportOnly?: boolean; // publishes nothing
  readonly onProgress?: OnProgress; // called now and then while the server works
}
export interface AlignReport {
  readonly map: MapInfo; // as published, or as it would be
  readonly newWorldFromWorld: SimilarityTransform;
  readonly residuals: readonly { readonly name: string; readonly errorM: Vector3; readonly used: boolean }[];
  readonly rmsErrorM: number;
  readonly rmsHorizontalErrorM: number;
  readonly medianErrorM: number;
  readonly maxErrorM: number;
  readonly warnings: readonly string[];
  /** How the landmarks lie to the terrain that was given: the map's ground over
   * it, its scatter, and by how many of how many landmarks. */
  readonly terrain:
    | {
        readonly offsetM: number;
        readonly scatterM: number;
        readonly numGround: number;
        readonly numLandmarks: number;
      }
    | undefined;
}

// --- sessions -----------------------------------------------------------------

/** lossless: the sender is held back; live: the oldest waiting frame is dropped
 * and answered so. */
export type FlowMode = "lossless" | "live";

export type BodyKind = "CAR" | "VAN" | "TRUCK" | "BUS" | "MOTORCYCLE" | "BICYCLE" | "PERSON" | "BOAT";

/** What is known of a target's body. It makes the 3D box right from the first frame
 * on; without a map it is of no use. */
export interface TargetBody {
  readonly kind?: BodyKind | undefined;
  /** Length, width and height, each good to 5 %, in metres or map units; left out = as
   * its kind is. More than 0 and at most 500. */
  readonly sizeM?: Vector3 | undefined;
}

/** What is left out is the server's choice. */
export interface SessionOptions {
  readonly localizer?: string; // "fast" or "baseline"
  readonly tracker?: string; // "dcf", "act", "kcf", "csrt", ...
  readonly flowMode?: FlowMode;
  readonly confidenceThreshold?: number; // in (0, 1)
  readonly targetLostAfterS?: number; // in (0, 86400]
  readonly cameraLostAfterS?: number; // in [0, 86400]
  readonly seed?: number; // same frames, options and seed: same results
  readonly reportMatches?: boolean; // landmarks seen, with each result
  readonly reportMovers?: boolean; // what moves by itself: FrameResult.movers
  /** The unit that Frame.inertial comes from, or the path of its imu.json. */
  readonly imu?: ImuModel | string | undefined;
}
export interface SessionSpec {
  readonly map: string | null; // null = none: targets in 2D only
  /** Or the path of a camera.json; left out = the map's own lens. */
  readonly camera?: CameraModel | string;
  readonly options?: SessionOptions;
  readonly sessionId?: string; // left out = made up by the server
  readonly mapVersion?: number; // left out = the newest
}
export interface SessionInfo {
  readonly sessionId: string;
  readonly mapName: string;
  readonly mapVersion: number;
  readonly camera: CameraModel | undefined; // no map, and none was given
  readonly options: SessionOptions;
  readonly createTime: Date;
  readonly nextSequence: number; // one past the last accepted frame
  readonly framesProcessed: number;
  readonly framesDropped: number;
  readonly framesFailed: number;
  readonly targetIds: readonly string[];
  readonly streaming: boolean; // a client is attached
  readonly owner: string; // who has created it: Caller.name
}
/** Who this client is for the server, and what it may do. */
export interface Caller {
  readonly name: string; // of the token or certificate, or "jwt:" and the token's subject
  readonly tenant: string; // whose maps and sessions there are; "" = of the one without a name
  readonly scopes: readonly string[]; // "maps:read", "sessions:own", ..., implied ones included
  readonly openToAll: boolean; // the server asks nobody: everybody may do everything
}

// --- frames -------------------------------------------------------------------

/** What other sensors say about where the camera is. A part goes with its
 * standard deviation, per axis, above 0. A wrong one costs time alone. */
export interface PosePrior {
  /** Of the camera's centre or, with positionArmM, of the sensor; world. */
  readonly positionM?: Vector3;
  readonly positionSigmaM?: number;
  readonly geodeticPosition?: GeodeticPosition; // instead, if the map has an origin
  readonly geodeticSigmaM?: number;
  readonly rotation?: Quaternion; // world_from_camera
  readonly rotationSigmaRad?: number;
  /** From the camera's centre to the sensor of the position (the antenna), along
   * the camera's axes: x right, y down, z forward. Goes with a position. */
  readonly positionArmM?: Vector3;
}
export interface Frame {
  readonly image: ImageLike;
  readonly sequence?: number; // left out = one more than the previous
  readonly captureTimeNs?: bigint; // a monotone clock; left out = this machine's, now
  readonly camera?: CameraModel; // of this frame alone
  readonly prior?: PosePrior;
  /** Since the frame before, up to this one's capture time or a little beyond, at
   * most 4096: see inertialBetween. Of use with SessionOptions.imu. */
  readonly inertial?: readonly InertialSample[];
}

// --- answers ------------------------------------------------------------------

/** ODOMETRY: where the map ends, carried on by what else is followed in the
 * image; the covariance grows with the way until the map is seen again. */
export type CameraState = "INITIALIZING" | "TRACKED" | "ODOMETRY" | "HELD" | "LOST";
export type TargetState = "TRACKED" | "PREDICTED" | "LOST";

/** By which the frames were taken with another lens than the session's. */
export interface LensContradiction {
  readonly focalRatio: number; // the focal length seen over the given one
  /** How much farther out than the lens says the image's corner is, as a share
   * of its distance from the principal point. */
  readonly cornerShare: number;
}
export interface CameraResult {
  readonly state: CameraState;
  readonly worldFromCamera: RigidTransform | undefined; // while there is no pose
  /** 6x6, row by row, of the centre in world, m, and a rotation vector in
   * world, rad: R_true = Exp(dtheta) R. Set with the pose. */
  readonly covariance: readonly number[] | undefined;
  readonly numInliers: number; // in ODOMETRY not all in the map
  readonly meanReprojectionErrorPx: number;
  readonly resetCount: number; // raised whenever the pose does not continue
  /** Set once frames agree on it, and in each result from then on. */
  readonly lensContradiction: LensContradiction | undefined;
  /** The images contradict the gyroscope again and again, so it is not looked at any
   * more: its axes, clock or unit are other than was said. */
  readonly ignoresGyroscope: boolean;
  readonly matchXyPx: readonly number[]; // with reportMatches: x, y of each
  readonly matchXyzWorld: readonly number[]; // x, y, z of each
}
export interface TargetResult {
  readonly targetId: string;
  readonly state: TargetState;
  readonly confidence: number; // of the 2D tracker, [0, 1]
  readonly box: Box2 | undefined; // if it does not project
  readonly boxWorld: Box3 | undefined; // without a camera pose, as the next ones
  readonly groundCenterM: Vector3 | undefined;
  readonly headingRad: number; // about world z, 0 along x
  readonly groundCovarianceM2: readonly number[] | undefined; // 2x2, row by row
  readonly velocityWorldMS: Vector3 | undefined;
  readonly ageS: number; // since it was last seen
  readonly headingSigmaRad: number; // pi / sqrt(3) while nothing tells it
  readonly frontKnown: boolean; // if not, it may as well head the opposite way
  readonly sizeCovarianceM2: readonly number[] | undefined; // 3x3: length, width, height
  /** What it is taken for, as was told or by its size. */
  readonly bodyKind: BodyKind | undefined;
}
/** Whether movers are looked for in a frame and, if not, why: not asked for; too few
 * frames so far; no map; a ground that the map does not know, or that the camera is below;
 * a camera that is neither TRACKED nor in ODOMETRY; a pose that so much of the picture
 * contradicts that it is doubted. */
export type MoversState =
  | "NOT_ASKED"
  | "WATCHING"
  | "STARTING"
  | "NO_MAP"
  | "NO_GROUND"
  | "NO_POSE"
  | "POSE_CONTRADICTED";
/** What moves by itself over the ground: a suggestion for setTarget. */
export interface Mover {
  readonly moverId: number; // stays with it from frame to frame
  readonly box: Box2;
  readonly groundCenterM: Vector3; // world
  readonly groundCovarianceM2: readonly number[]; // 2x2, row by row, world x and y
  readonly velocityWorldMS: Vector3;
  readonly velocityCovarianceM2S2: readonly number[]; // 2x2, row by row, world x and y
  readonly confidence: number; // the probability that it exists
}
/** Wall clock, ms. */
export interface StageTimes {
  readonly queueMs: number;
  readonly decodeMs: number;
  readonly localizeMs: number;
  readonly trackMs: number;
  readonly totalMs: number;
  readonly moversMs: number;
}
export interface FrameResult {
  readonly kind: "result";
  readonly sequence: number;
  readonly captureTimeNs: bigint;
  readonly camera: CameraResult;
  readonly targets: readonly TargetResult[];
  readonly mapVersion: number;
  readonly times: StageTimes;
  readonly targetErrors: readonly { readonly targetId: string; readonly message: string }[];
  readonly movers: readonly Mover[]; // the surest first; none unless WATCHING
  readonly moversState: MoversState;
}
/** A frame that could not be processed; the session goes on. */
export interface FrameFailed {
  readonly kind: "failed";
  readonly sequence: number;
  readonly error: GroundlockError;
}
/** A frame that was left out: live mode, or the server is stopping. */
export interface FrameDropped {
  readonly kind: "dropped";
  readonly sequence: number;
  readonly reason: "overload" | "shutdown" | "unknown";
}
/** The one answer to a frame. */
export type Answer = FrameResult | FrameFailed | FrameDropped;

export interface LocalizeSpec {
  readonly map: string;
  readonly camera?: CameraModel | string; // left out = the map's own lens
  readonly localizer?: string;
  readonly mapVersion?: number;
  readonly seed?: number;
  readonly prior?: PosePrior;
}
export interface LocalizeReport {
  readonly camera: CameraResult; // state TRACKED or LOST
  readonly mapVersion: number;
  readonly times: StageTimes;
}
export interface WatchUpdate {
  readonly result: FrameResult;
  readonly image: Image | undefined;
  readonly skipped: number; // results left out since the last update
}
