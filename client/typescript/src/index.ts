// SPDX-License-Identifier: Apache-2.0
// Groundlock keeps a lock on things that move on the ground, seen from a camera
// that moves too. This is its client for Node; docs/typescript.md shows how to
// use it.
export { BUILD, VERSION } from "./gen/build.js";
export type { ConnectOptions, TlsOptions } from "./channel.js";
export { DEFAULT_PORT } from "./channel.js";
export type { BuildOptions, ImportOptions } from "./client.js";
export { Client, Session } from "./client.js";
export { Code, GroundlockError } from "./errors.js";
export type { CodeName } from "./errors.js";
export type {
  Box2, Box3, BoxLike, CameraModel, CameraModelName, GeodeticPosition, Plane, Quaternion, RigidTransform,
  SimilarityTransform, Vector3,
} from "./geometry.js";
export {
  CAMERA_MODELS, apply, compose, corners, inverse, iou, readAlignment, readCamera, rotate, rotationMatrix, toMatrix,
} from "./geometry.js";
export { writeCamera } from "./nodeFiles.js";
export type { Encoding, Image, ImageLike } from "./images.js";
export { rawImage } from "./images.js";
export type { ImuModel, InertialSample } from "./inertial.js";
export { inertialBetween, inertialSince, readImu, readInertial } from "./inertial.js";
export type { LocalServerOptions, OpenOptions } from "./localServer.js";
export { LocalServer, connect, userDataFolder } from "./localServer.js";
export type { RecordedImage } from "./recording.js";
export { Recording } from "./recording.js";
export type { StreamOptions } from "./resume.js";
export type { Frames } from "./stream.js";
export { TrackingStream, Watcher } from "./stream.js";
export type { Row } from "./tables.js";
export { COLUMNS, rows, writeCsv } from "./tables.js";
export type { TrackOptions } from "./track.js";
export { DEFAULT_TARGET, TrackRun, track } from "./track.js";
export type * from "./types.js";
export type { VideoFrame, VideoOptions } from "./video.js";
export { Video } from "./video.js";
