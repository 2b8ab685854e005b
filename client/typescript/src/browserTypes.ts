// SPDX-License-Identifier: Apache-2.0
// What the client for browsers is told.
import type { BoxLike, CameraModel, GeodeticPosition, SimilarityTransform } from "./geometry.js";
import type * as t from "./types.js";

export interface DashboardOptions {
  /** Where groundlock-dashboard is; left out = where the page is from, as its log-in wants. */
  readonly url?: string;
  /** Logged in with before anything else, if the server asks who calls. */
  readonly token?: string;
  /** How long to wait for the dashboard; left out = 10000. */
  readonly connectTimeoutMs?: number;
  /** For how long a lost connection is tried again; left out = 60000. */
  readonly giveUpAfterMs?: number;
}

/** A video or camera that the dashboard can feed a session from. */
export interface Source {
  readonly sourceId: string;
  readonly name: string;
}

export interface StartOptions extends t.SessionSpec {
  /** Of `sources`. */
  readonly sourceId: string;
  /** Targets in the first frame: id to box, px. */
  readonly targets?: Readonly<Record<string, BoxLike>>;
  /** Start anew at the end, until stopped. */
  readonly loop?: boolean;
  /** Send the first frame, then wait for control(id, "play"). */
  readonly paused?: boolean;
}

export interface WatchOptions {
  /** With the frames' images; left out = without. */
  readonly images?: boolean;
  /** How wide they are shown, px; left out = as they are. */
  readonly imageWidthPx?: number;
}

export interface LongOptions {
  /** Called as bytes go and as the server works; what it throws cancels. */
  readonly onProgress?: t.OnProgress;
  readonly signal?: AbortSignal;
}
export interface ImportOptions extends LongOptions {
  readonly format?: t.MapFormat;
  /** To metres with z up; left out = the ground is found by itself and becomes z = 0. */
  readonly align?: SimilarityTransform;
  readonly origin?: GeodeticPosition;
}
export interface BuildOptions extends LongOptions {
  /** Left out = estimated. */
  readonly camera?: CameraModel;
  readonly maxImages?: number;
}
