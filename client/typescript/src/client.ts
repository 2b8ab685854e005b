// SPDX-License-Identifier: Apache-2.0
// The client of a server, and its sessions.
import { once } from "node:events";
import { create } from "@bufbuild/protobuf";
import type * as grpc from "@grpc/grpc-js";
import { alignRequest } from "./align.js";
import { Channel, type ConnectOptions } from "./channel.js";
import { choice, identifier, mapName, whole } from "./checks.js";
import * as c from "./convert.js";
import { Code, GroundlockError, badArgument, errorOfCall } from "./errors.js";
import { ExportReceiver, Upload, findBuildFiles, findImportFiles } from "./files.js";
import * as mp from "./gen/groundlock/v1/maps_pb.js";
import * as tp from "./gen/groundlock/v1/tracking_pb.js";
import { type BoxLike, type CameraModel, type GeodeticPosition, type SimilarityTransform, readAlignment } from "./geometry.js";
import type { ImageLike } from "./images.js";
import { ALIGNING, whileTelling } from "./progress.js";
import type { StreamOptions } from "./resume.js";
import { type Frames, TrackingStream, Watcher } from "./stream.js";
import type * as t from "./types.js";

const maps = mp.MapService.method;
const tracking = tp.TrackingService.method;
const PAGE_SIZE = 1000;

export interface ImportOptions {
  readonly format?: t.MapFormat;
  /** COLMAP's database.db, where it is not beside or above the model. */
  readonly database?: string;
  /** The folder of the images and their features, where they are not beside the model. */
  readonly images?: string;
  /** To metres with z up, or the path of an align.json; without it the ground is
   * found by itself and becomes z = 0. */
  readonly align?: SimilarityTransform | string;
  readonly origin?: GeodeticPosition;
  readonly seed?: number;
  readonly onProgress?: t.OnProgress;
}

export interface BuildOptions {
  readonly video?: string;
  /** A folder, or the paths of photos. */
  readonly images?: string | readonly string[];
  /** The lens, or its camera.json; left out = estimated. */
  readonly camera?: CameraModel | string;
  readonly maxImages?: number;
  readonly maxFeatures?: number;
  readonly seed?: number;
  readonly onProgress?: t.OnProgress;
}

/** A session on the server; made by Client.createSession() and Client.session(). */
export class Session {
  readonly #channel: Channel;
  constructor(channel: Channel, readonly id: string) {
    this.#channel = channel;
  }

  /** How it stands. NOT_FOUND: deleted or expired. */
  async info(): Promise<t.SessionInfo> {
    const request = create(tp.GetSessionRequestSchema, { sessionId: this.id });
    return c.sessionFrom((await this.#channel.unary(tracking.getSession, request)).session);
  }

  /** Marks a target by its box, px, in the frame `sequence`, not yet processed;
   * left out = the next that is. An empty id is made up by the server; an
   * existing one is marked anew. body: what is known of it. Resolves to the id. */
  async setTarget(
    targetId: string,
    box: BoxLike,
    options: { readonly sequence?: number; readonly body?: t.TargetBody | undefined } = {},
  ): Promise<string> {
    const request = create(tp.SetTargetRequestSchema, {
      sessionId: this.id,
      targetId: identifier("targetId", targetId, true),
      box: c.boxTo("box", box),
    });
    if (options.sequence !== undefined) request.sequence = BigInt(whole("sequence", options.sequence));
    if (options.body !== undefined) request.body = c.bodyTo("body", options.body);
    return (await this.#channel.unary(tracking.setTarget, request)).targetId;
  }

  /** Says where a target is, without learning its appearance anew. */
  async moveTarget(targetId: string, box: BoxLike): Promise<void> {
    const target = { sessionId: this.id, targetId: identifier("targetId", targetId) };
    await this.#channel.unary(
      tracking.moveTarget, create(tp.MoveTargetRequestSchema, { ...target, box: c.boxTo("box", box) }),
    );
  }

  async dropTarget(targetId: string): Promise<void> {
    const target = { sessionId: this.id, targetId: identifier("targetId", targetId) };
    await this.#channel.unary(tracking.dropTarget, create(tp.DropTargetRequestSchema, target));
  }

  /** Opens the stream of frames. NOT_FOUND if the session is gone. */
  stream(options: StreamOptions = {}): Promise<TrackingStream> {
    return TrackingStream.open(this.#channel, this.id, options);
  }

  /** Streams the frames, and yields one answer for each: see TrackingStream.process. */
  async *track(frames: Frames, options: StreamOptions = {}): AsyncGenerator<t.Answer> {
    const stream = await this.stream(options);
    try {
      yield* stream.process(frames);
    } finally {
      await stream.cancel();
    }
  }

  /** Follows the results of a session that somebody else feeds. */
  async watch(options: { readonly includeImages?: boolean; readonly imageWidthPx?: number } = {}): Promise<Watcher> {
    const request = create(tp.WatchSessionRequestSchema, {
      sessionId: this.id,
      includeImages: options.includeImages ?? false,
      imageWidthPx: whole("imageWidthPx", options.imageWidthPx ?? 0, 0, 0xffffffff),
    });
    return Watcher.open(this.#channel.serverStream(tracking.watchSession, request), this.#channel.server);
  }

  /** Ends it: its stream and watchers are closed. */
  async delete(): Promise<void> {
    await this.#channel.unary(tracking.deleteSession, create(tp.DeleteSessionRequestSchema, { sessionId: this.id }));
  }
}

/** A connection to a server, shared by all calls; made by connect(). */
export class Client {
  readonly #channel: Channel;
  readonly #onClose: (() => Promise<void>) | undefined;

  private constructor(channel: Channel, onClose: (() => Promise<void>) | undefined) {
    this.#channel = channel;
    this.#onClose = onClose;
  }

  /** server: HOST:PORT. UNAVAILABLE if nobody answers within connectTimeoutMs. */
  static async open(server: string, options: ConnectOptions = {}, onClose?: () => Promise<void>): Promise<Client> {
    const channel = new Channel(server, options);
    try {
      await channel.ready();
    } catch (error) {
      channel.close();
      throw error;
    }
    return new Client(channel, onClose);
  }

  get server(): string {
    return this.#channel.server;
  }

  /** Ends all streams and the connection. */
  async close(): Promise<void> {
    this.#channel.close();
    await this.#onClose?.();
  }

  /** Who this client is for the server, and what it may do. */
  async caller(): Promise<t.Caller> {
    const caller = await this.#channel.unary(tracking.getCaller, create(tp.GetCallerRequestSchema));
    return { name: caller.name, tenant: caller.tenant, scopes: [...caller.scopes], openToAll: caller.openToAll };
  }

  // --- maps

  /** Uploads a reconstruction, and publishes it as the newest version. path: a
   * folder with a COLMAP model (its database.db beside or above it), or the file
   * or folder of another format. */
  async importMap(name: string, path: string, options: ImportOptions = {}): Promise<t.ImportReport> {
    const found = findImportFiles(path, options);
    const upload = new Upload(found.files);
    const header = create(mp.ImportMapRequest_HeaderSchema, {
      name: mapName("name", name),
      format: choice("format", found.format, c.MAP_FORMATS),
      modelPath: found.model,
      databasePath: found.database,
      imagesPath: found.images,
      seed: BigInt(whole("seed", options.seed ?? 0)),
      numFiles: BigInt(found.files.length),
    });
    const align = typeof options.align === "string" ? readAlignment(options.align) : options.align;
    if (align !== undefined) header.worldFromSource = c.similarityTo("align", align);
    if (options.origin !== undefined) {
      if (align === undefined) throw badArgument("origin", "needs align: it says where that world lies on Earth");
      header.origin = c.placeTo("origin", options.origin);
    }
    let settle: (error: GroundlockError | null, response?: mp.ImportMapResponse) => void = () => undefined;
    const answered = new Promise<mp.ImportMapResponse>((resolve, reject) => {
      settle = (error, response) => (error || !response ? reject(error) : resolve(response));
    });
    const call = this.#channel.clientStream(maps.importMap, (error, response) => settle(error, response));
    const response = await whileTelling(
      () => upload.progress(upload.complete ? "importing" : "uploading"),
      options.onProgress,
      () => call.cancel(),
      async () => {
        const sent = send(call, upload, (message) => create(mp.ImportMapRequestSchema, { message }), header, answered);
        const [result] = await Promise.all([answered, sent]);
        return result;
      },
    );
    return { map: c.mapFrom(response.map), warnings: [...response.warnings] };
  }

  /** Builds a map of a video or of photos, and publishes it. FAILED_PRECONDITION
   * says why they make no map, and what to do. */
  async buildMap(name: string, options: BuildOptions): Promise<t.BuildReport> {
    const { files, videoPath } = findBuildFiles(options.video, options.images);
    const upload = new Upload(files);
    const header = create(mp.BuildMapRequest_HeaderSchema, {
      name: mapName("name", name),
      videoPath,
      maxImages: whole("maxImages", options.maxImages ?? 0, 0, 0xffffffff),
      maxFeatures: whole("maxFeatures", options.maxFeatures ?? 0, 0, 0xffffffff),
      seed: BigInt(whole("seed", options.seed ?? 0)),
      numFiles: BigInt(files.length),
    });
    if (options.camera !== undefined) header.camera = c.cameraTo("camera", options.camera);
    const call = this.#channel.duplex(maps.buildMap);
    let now: t.Progress | undefined;
    let result: mp.BuildMapResponse_Result | undefined;
    const answered = this.#each(call, (response: mp.BuildMapResponse) => {
      const m = response.message;
      if (m.case === "result") result = m.value;
      if (m.case === "progress") {
        const { stage, fraction, note } = m.value;
        now = { stage, fraction, note, bytesDone: upload.done, bytesTotal: upload.total };
      }
    });
    await whileTelling(
      () => now ?? upload.progress(upload.complete ? "preparing" : "uploading"),
      options.onProgress,
      () => call.cancel(),
      async () => {
        const sent = send(call, upload, (message) => create(mp.BuildMapRequestSchema, { message }), header, answered);
        await Promise.all([answered, sent]);
      },
    );
    if (result === undefined) {
      throw new GroundlockError(Code.UNAVAILABLE, "the server ended the build without a result");
    }
    const report: unknown = result.reportJson ? JSON.parse(result.reportJson) : {};
    return { map: c.mapFrom(result.map), warnings: [...result.warnings], report };
  }

  /** The newest version of every map, by name. */
  async listMaps(): Promise<t.MapInfo[]> {
    const all: t.MapInfo[] = [];
    let pageToken = "";
    do {
      const page = await this.#channel.unary(
        maps.listMaps, create(mp.ListMapsRequestSchema, { pageSize: PAGE_SIZE, pageToken }),
      );
      all.push(...page.maps.map(c.mapFrom));
      pageToken = page.nextPageToken;
    } while (pageToken !== "");
    return all;
  }

  /** One map; version 0 is the newest. */
  async getMap(name: string, version = 0): Promise<t.MapInfo> {
    const request = create(mp.GetMapRequestSchema, versioned(name, version));
    return c.mapFrom((await this.#channel.unary(maps.getMap, request)).map);
  }

  /** Removes all versions; running sessions keep theirs. */
  async deleteMap(name: string): Promise<void> {
    const request = create(mp.DeleteMapRequestSchema, { name: mapName("name", name) });
    await this.#channel.unary(maps.deleteMap, request);
  }

  /** Reads a stored map whole and says what is wrong with it. */
  async checkMap(name: string, version = 0): Promise<t.MapCheck> {
    const request = create(mp.CheckMapRequestSchema, versioned(name, version));
    const { map, problems } = await this.#channel.unary(maps.checkMap, request, false);
    return { map: map && c.mapFrom(map), problems: [...problems] };
  }

  /** Landmarks and mapping images; maxPoints 0 = all, else an even subsample. */
  async pointCloud(
    name: string,
    options: { readonly version?: number; readonly maxPoints?: number } = {},
  ): Promise<t.PointCloud> {
    const request = create(mp.GetPointCloudRequestSchema, {
      ...versioned(name, options.version ?? 0),
      maxPoints: BigInt(whole("maxPoints", options.maxPoints ?? 0)),
    });
    const blocks: mp.GetPointCloudResponse[] = [];
    const call = this.#channel.serverStream(maps.getPointCloud, request);
    await this.#each(call, (block: mp.GetPointCloudResponse) => blocks.push(block));
    return c.pointCloudFrom(blocks);
  }

  /** Writes a map as another tool's files: a folder for COLMAP, a file otherwise,
   * which must not be there. Nothing is left on failure. Resolves to what the
   * format could not express exactly. */
  async exportMap(
    name: string,
    path: string,
    options: { readonly format?: t.MapExportFormat; readonly version?: number; readonly onProgress?: t.OnProgress } = {},
  ): Promise<string[]> {
    const format = options.format ?? "colmap";
    const request = create(mp.ExportMapRequestSchema, {
      ...versioned(name, options.version ?? 0),
      format: choice("format", format, c.EXPORT_FORMATS),
    });
    const receiver = new ExportReceiver(path, format);
    const call = this.#channel.serverStream(maps.exportMap, request);
    try {
      for await (const message of call) {
        await receiver.take(message as mp.ExportMapResponse);
        options.onProgress?.(receiver.progress());
      }
      await receiver.place();
      return receiver.warnings;
    } catch (error) {
      throw isCallError(error) ? errorOfCall(error, this.server) : error;
    } finally {
      call.on("error", () => undefined); // of the cancelling
      call.cancel();
      await receiver.close();
    }
  }

  /** Publishes a map in another world: metric, on Earth, on its ground; or
   * (reportOnly) tells what it would be. method null: only the ground moves it. */
  async alignMap(name: string, method: t.AlignMethod | null, options: t.AlignOptions = {}): Promise<t.AlignReport> {
    const request = alignRequest(name, method, options);
    const cancel = new AbortController();
    const response = await whileTelling(
      () => ALIGNING, options.onProgress, () => cancel.abort(),
      () => this.#channel.unary(maps.alignMap, request, false, cancel.signal));
    return c.alignReportFrom(response);
  }

  // --- sessions

  async createSession(spec: t.SessionSpec): Promise<Session> {
    const { session } = await this.#channel.unary(tracking.createSession, c.sessionTo(spec));
    return new Session(this.#channel, c.sessionFrom(session).sessionId);
  }

  /** A session that is there already. */
  async session(sessionId: string): Promise<Session> {
    const session = new Session(this.#channel, identifier("sessionId", sessionId));
    await session.info();
    return session;
  }

  async listSessions(): Promise<t.SessionInfo[]> {
    const all: t.SessionInfo[] = [];
    let pageToken = "";
    do {
      const page = await this.#channel.unary(
        tracking.listSessions, create(tp.ListSessionsRequestSchema, { pageSize: PAGE_SIZE, pageToken }),
      );
      all.push(...page.sessions.map(c.sessionFrom));
      pageToken = page.nextPageToken;
    } while (pageToken !== "");
    return all;
  }

  /** Finds the camera of a single image, without a session. */
  async localize(image: ImageLike, spec: t.LocalizeSpec): Promise<t.LocalizeReport> {
    const request = create(tp.LocalizeRequestSchema, {
      mapName: mapName("map", spec.map),
      mapVersion: BigInt(whole("mapVersion", spec.mapVersion ?? 0)),
      image: c.imageTo("image", image),
      localizer: spec.localizer ?? "",
      seed: BigInt(whole("seed", spec.seed ?? 0)),
    });
    if (spec.camera !== undefined) request.camera = c.cameraTo("camera", spec.camera);
    if (spec.prior !== undefined) request.prior = c.priorTo(spec.prior);
    return c.localizeFrom(await this.#channel.unary(tracking.localize, request, false));
  }

  /** Reads a stream to its end. */
  #each<T>(call: grpc.ClientReadableStream<T> | grpc.ClientDuplexStream<never, T>, take: (message: T) => void): Promise<void> {
    return new Promise((resolve, reject) => {
      const readable = call as grpc.ClientReadableStream<T>;
      readable.on("data", take);
      readable.on("error", (error: Error) => reject(errorOfCall(error, this.server)));
      readable.on("end", () => resolve());
    });
  }
}

function versioned(name: string, version: number): { name: string; version: bigint } {
  return { name: mapName("name", name), version: BigInt(whole("version", version)) };
}

function isCallError(error: unknown): error is grpc.ServiceError {
  return error instanceof Error && "details" in error && !(error instanceof GroundlockError);
}

type Message<H> =
  | { case: "header"; value: H }
  | { case: "fileStart"; value: mp.ImportMapRequest_FileStart }
  | { case: "chunk"; value: Uint8Array<ArrayBuffer> };

/** Sends the files; stops early if the call has ended, since its own status says
 * why. */
async function send<H, M>(
  call: { write(message: M): boolean; end(): void } & NodeJS.EventEmitter,
  upload: Upload,
  make: (message: Message<H>) => M,
  header: H,
  answered: Promise<unknown>,
): Promise<void> {
  let over = false;
  const ended = answered.then(() => undefined, () => undefined).then(() => void (over = true));
  call.write(make({ case: "header", value: header }));
  for await (const part of upload.parts()) {
    if (over) return;
    const message =
      part.case === "chunk"
        ? make(part)
        : make({ case: "fileStart", value: create(mp.ImportMapRequest_FileStartSchema, part.value) });
    // The network takes no more for now.
    if (!call.write(message)) await Promise.race([once(call, "drain").catch(() => undefined), ended]);
  }
  call.end();
}
