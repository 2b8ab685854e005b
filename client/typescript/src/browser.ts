// SPDX-License-Identifier: Apache-2.0
// Groundlock in a browser: through the WebSocket of groundlock-dashboard, which
// serves the page, too. Results and errors are those of the client for Node.
/// <reference lib="dom" />
import { create, fromBinary, toBinary } from "@bufbuild/protobuf";
import { alignRequest } from "./align.js";
import type { BuildOptions, DashboardOptions, ImportOptions, LongOptions, Source, StartOptions, WatchOptions } from "./browserTypes.js";
import { type Request, Watch } from "./browserWatch.js";
import { choice, finite, identifier, mapName, whole } from "./checks.js";
import * as c from "./convert.js";
import { Code, GroundlockError, badArgument, errorOf } from "./errors.js";
import * as dp from "./gen/groundlock/dashboard/v1/dashboard_pb.js";
import type * as mp from "./gen/groundlock/v1/maps_pb.js";
import type { BoxLike } from "./geometry.js";
import { ALIGNING, whileTelling } from "./progress.js";
import type * as t from "./types.js";
import { type PageFile, failureOf, partsOf, upload } from "./uploads.js";

export { BUILD, VERSION } from "./gen/build.js";
export { Code, GroundlockError } from "./errors.js";
export type { CodeName } from "./errors.js";
export type {
  Box2, Box3, BoxLike, CameraModel, CameraModelName, GeodeticPosition, Plane, Quaternion, RigidTransform,
  SimilarityTransform, Vector3,
} from "./geometry.js";
export { CAMERA_MODELS, apply, compose, corners, inverse, iou, rotate, rotationMatrix, toMatrix } from "./geometry.js";
export type { Encoding, Image } from "./images.js";
export type * from "./browserTypes.js";
export type * from "./types.js";
export type { PageFile } from "./uploads.js";

type Reply = dp.ServerMessage["message"];
type Case = NonNullable<Reply["case"]>;
type Value<C extends Case> = Extract<Reply, { case: C }>["value"];

const ACTIONS = {
  play: dp.ControlSource_Action.PLAY,
  pause: dp.ControlSource_Action.PAUSE,
  stop: dp.ControlSource_Action.STOP,
  step: dp.ControlSource_Action.STEP,
} as const;
const FIRST_PAUSE_MS = 200;
const LAST_PAUSE_MS = 3_000;
interface Waiting {
  readonly resolve: (reply: Reply) => void;
  readonly reject: (error: GroundlockError) => void;
  readonly progress: ((progress: dp.Progress) => void) | undefined;
}

/** One connection, which comes back by itself when it was lost; watches go on then. */
export class Dashboard {
  readonly #url: URL;
  readonly #giveUpAfterMs: number;
  readonly #waiting = new Map<bigint, Waiting>();
  readonly #watches = new Map<string, Watch>();
  readonly #clouds = new Map<string, mp.GetPointCloudResponse[]>();
  #changed: (() => void)[] = []; // who waits for points or sources
  #socket: WebSocket | undefined;
  #nextId = 1n;
  #lostAt: number | undefined;
  #pause = FIRST_PAUSE_MS;
  #error: GroundlockError | undefined;
  #greeted: ((error?: GroundlockError) => void) | undefined;
  #maps: readonly t.MapInfo[] = [];
  #sessions: readonly t.SessionInfo[] = [];
  #sources: readonly Source[] = [];
  readonly #uploaded = new Map<string, Source>(); // by the upload's id
  #reconnects = 0;

  private constructor(url: URL, giveUpAfterMs: number) {
    this.#url = url;
    this.#giveUpAfterMs = giveUpAfterMs;
  }

  /** UNAVAILABLE: nobody answers; UNAUTHENTICATED, PERMISSION_DENIED: the token. */
  static async connect(options: DashboardOptions = {}): Promise<Dashboard> {
    const timeoutMs = positive("connectTimeoutMs", options.connectTimeoutMs ?? 10_000);
    const giveUpAfterMs = positive("giveUpAfterMs", options.giveUpAfterMs ?? 60_000);
    let url: URL;
    try {
      url = new URL(options.url ?? location.origin);
    } catch {
      throw badArgument("url", `${JSON.stringify(options.url)} is no address; http://HOST:PORT or https://HOST:PORT`);
    }
    if (!/^https?:$/.test(url.protocol)) throw badArgument("url", `${url.protocol} must be http: or https:`);
    if (options.token !== undefined) await logIn(url, options.token, timeoutMs);
    const dashboard = new Dashboard(url, giveUpAfterMs);
    await new Promise<void>((resolve, reject) => {
      const late = setTimeout(() => dashboard.#fail(unavailable(`${url.origin}: no dashboard answers`)), timeoutMs);
      dashboard.#greeted = (error) => {
        clearTimeout(late);
        dashboard.#greeted = undefined;
        if (error) reject(error);
        else resolve();
      };
      dashboard.#open();
    });
    return dashboard;
  }

  /** The newest version of each map, as the dashboard told last. */
  get maps(): readonly t.MapInfo[] {
    return this.#maps;
  }
  get sessions(): readonly t.SessionInfo[] {
    return this.#sessions;
  }
  get sources(): readonly Source[] {
    return this.#sources;
  }
  /** How often the connection was lost and restored. */
  get numReconnects(): number {
    return this.#reconnects;
  }

  /** Makes a session and has the dashboard feed it; resolves to how it stands. */
  async start(options: StartOptions): Promise<t.SessionInfo> {
    const { session } = await this.#request("sessionStarted", {
      case: "startSession",
      value: {
        session: c.sessionTo(options),
        sourceId: text("sourceId", options.sourceId),
        loop: options.loop ?? false,
        paused: options.paused ?? false,
        targets: Object.entries(options.targets ?? {}).map(([id, box]) => ({
          targetId: identifier(`targets.${id}`, id),
          box: c.boxTo(`targets.${id}`, box),
        })),
      },
    });
    return c.sessionFrom(session);
  }

  /** Of a session that the dashboard feeds. */
  async control(sessionId: string, action: keyof typeof ACTIONS): Promise<void> {
    const value = { sessionId: identifier("sessionId", sessionId), action: choice("action", action, ACTIONS) };
    await this.#request("done", { case: "controlSource", value });
  }

  /** Marks a target by its box, px, in the next frame; body: what is known of it.
   * Resolves to its id. */
  async setTarget(
    sessionId: string,
    targetId: string,
    box: BoxLike,
    options: { readonly body?: t.TargetBody | undefined } = {},
  ): Promise<string> {
    const value = {
      sessionId: identifier("sessionId", sessionId),
      targetId: identifier("targetId", targetId, true),
      box: c.boxTo("box", box),
      ...(options.body && { body: c.bodyTo("body", options.body) }),
    };
    return (await this.#request("targetSet", { case: "setTarget", value })).targetId;
  }

  /** Says where a target is, without learning its appearance anew. */
  async moveTarget(sessionId: string, targetId: string, box: BoxLike): Promise<void> {
    const value = {
      sessionId: identifier("sessionId", sessionId),
      targetId: identifier("targetId", targetId),
      box: c.boxTo("box", box),
    };
    await this.#request("done", { case: "moveTarget", value });
  }

  async dropTarget(sessionId: string, targetId: string): Promise<void> {
    const value = { sessionId: identifier("sessionId", sessionId), targetId: identifier("targetId", targetId) };
    await this.#request("done", { case: "dropTarget", value });
  }

  async deleteSession(sessionId: string): Promise<void> {
    const value = { sessionId: identifier("sessionId", sessionId) };
    await this.#request("done", { case: "deleteSession", value });
  }

  /** An even subsample of the map's landmarks. */
  async pointCloud(name: string, options: { readonly version?: number } = {}): Promise<t.PointCloud> {
    const value = { mapName: mapName("name", name), mapVersion: BigInt(whole("version", options.version ?? 0)) };
    const start = await this.#request("pointCloudStart", { case: "getPointCloud", value });
    const key = `${start.mapName}@${start.mapVersion}`;
    for (;;) {
      const blocks = this.#clouds.get(key) ?? [];
      if (blocks.length >= start.numBlocks) {
        this.#clouds.delete(key);
        return c.pointCloudFrom(blocks);
      }
      await new Promise<void>((resolve) => this.#changed.push(resolve));
      if (this.#error) throw this.#error;
    }
  }

  /** Publishes a map that another tool has made (COLMAP, OpenSfM, …), from the files that
   * make it up. */
  async importMap(name: string, files: readonly PageFile[], options: ImportOptions = {}): Promise<t.ImportReport> {
    if (options.origin !== undefined && options.align === undefined) {
      throw badArgument("origin", "needs align: it says where that world lies on Earth");
    }
    const value = {
      name: mapName("name", name),
      format: choice("format", options.format ?? "auto", c.MAP_FORMATS),
      ...(options.align && { worldFromSource: c.similarityTo("align", options.align) }),
      ...(options.origin && { origin: c.placeTo("origin", options.origin) }),
    };
    const { map, warnings } = await this.#withFiles("map", name, files, options, (uploadId) => ({
      case: "importMap", value: { ...value, uploadId },
    }));
    return { map: c.mapFrom(map), warnings: [...warnings] };
  }

  /** Builds a map of one video, or of photos. FAILED_PRECONDITION says why they make none. */
  async buildMap(name: string, files: readonly PageFile[], options: BuildOptions = {}): Promise<t.BuildReport> {
    const value = {
      name: mapName("name", name),
      maxImages: whole("maxImages", options.maxImages ?? 0, 0, 0xffffffff),
      ...(options.camera && { camera: c.cameraTo("camera", options.camera) }),
    };
    const built = await this.#withFiles("map", name, files, options, (uploadId) => ({
      case: "buildMap", value: { ...value, uploadId },
    }));
    const report: unknown = built.reportJson ? JSON.parse(built.reportJson) : {};
    return { map: c.mapFrom(built.map), warnings: [...built.warnings], report };
  }

  /** Publishes a new version of the map in another world; null: by its ground alone. */
  async alignMap(name: string, method: t.AlignMethod | null, options: t.AlignOptions = {}): Promise<t.AlignReport> {
    const value = alignRequest(name, method, options);
    const cancel = new AbortController();
    const response = await whileTelling(
      () => ALIGNING, options.onProgress, () => cancel.abort(),
      () => this.#request("mapAligned", { case: "alignMap", value }, { signal: cancel.signal }));
    return c.alignReportFrom(response);
  }

  /** Deletes all versions; sessions that use the map go on. */
  async deleteMap(name: string): Promise<void> {
    await this.#request("done", { case: "deleteMap", value: { name: mapName("name", name) } });
  }

  /** Brings a video to the dashboard (a file, or what the page has recorded of a
   * camera); resolves to the source that start() takes. */
  async uploadVideo(name: string, video: Blob, options: LongOptions = {}): Promise<Source> {
    if (!(video instanceof Blob)) throw badArgument("video", "must be a Blob or File");
    const parts = [{ path: text("name", name), data: video }];
    const id = await upload(this.#url, "video", name, parts, options.onProgress, options.signal);
    for (;;) {
      const source = this.#uploaded.get(id);
      if (source) return source;
      if (this.#error) throw this.#error;
      await new Promise<void>((resolve) => this.#changed.push(resolve));
    }
  }

  /** Follows a session's results as they come, until it ends or the loop is left;
   * who is slow gets fewer. One watch for each session. */
  async *watch(sessionId: string, options: WatchOptions = {}): AsyncGenerator<t.WatchUpdate> {
    const watch = new Watch(
      identifier("sessionId", sessionId), options.images ?? false, whole("imageWidthPx", options.imageWidthPx ?? 0));
    if (this.#watches.has(sessionId)) throw badArgument("sessionId", `${sessionId} is watched already`);
    this.#watches.set(sessionId, watch);
    try {
      await this.#request("subscribed", watch.request());
      for (;;) {
        const update = await watch.next();
        if (update === undefined) return;
        if (update.image) this.#tell({ case: "imageTaken", value: { sessionId, sequence: BigInt(update.result.sequence) } });
        yield update;
      }
    } finally {
      this.#watches.delete(sessionId);
      this.#tell({ case: "unsubscribe", value: { sessionId } });
    }
  }

  close(): void {
    this.#fail(new GroundlockError(Code.CANCELLED, "the connection was closed"));
  }

  // Uploads, then has the dashboard do something with the files.
  async #withFiles(
    kind: "map", name: string, files: readonly PageFile[], options: LongOptions, request: (uploadId: string) => Request,
  ): Promise<dp.MapImported> {
    const parts = partsOf("files", files);
    const id = await upload(this.#url, kind, name, parts, options.onProgress, options.signal);
    const bytes = parts.reduce((sum, part) => sum + part.data.size, 0);
    return this.#request("mapImported", request(id), {
      ...options,
      ...(options.onProgress && {
        onProgress: (now) => options.onProgress?.({ ...now, bytesDone: bytes, bytesTotal: bytes }),
      }),
    });
  }

  async #request<C extends Case>(expected: C, request: Request, options: LongOptions = {}): Promise<Value<C>> {
    if (this.#error) throw this.#error;
    const id = this.#nextId++;
    let thrown: { error: unknown } | undefined;
    const cancel = (): void => this.#tell({ case: "cancel", value: { requestId: id } });
    const progress = ({ stage, fraction, note }: dp.Progress): void => {
      if (thrown) return;
      try {
        options.onProgress?.({ stage, fraction, note, bytesDone: 0, bytesTotal: 0 });
      } catch (error) {
        thrown = { error };
        cancel();
      }
    };
    options.signal?.addEventListener("abort", cancel);
    const reply = await new Promise<Reply>((resolve, reject) => {
      if (this.#socket?.readyState !== WebSocket.OPEN) {
        reject(unavailable(`${this.#url.origin}: not connected to the dashboard; it is tried again`));
        return;
      }
      this.#waiting.set(id, { resolve, reject, progress: options.onProgress && progress });
      this.#tell(request, id);
      if (options.signal?.aborted) cancel();
    }).finally(() => options.signal?.removeEventListener("abort", cancel));
    if (thrown) throw (thrown as { error: unknown }).error;
    if (reply.case === "error") throw errorOf(reply.value.code, reply.value.message);
    if (reply.case !== expected) {
      throw new GroundlockError(Code.INTERNAL, `the dashboard answered ${request.case} by ${reply.case}`);
    }
    return reply.value as Value<C>;
  }

  #tell(request: Request, requestId = 0n): void {
    // Only acknowledgements have no number; what ends a watch needs one, too.
    const id = requestId === 0n && request.case !== "imageTaken" ? this.#nextId++ : requestId;
    if (this.#socket?.readyState !== WebSocket.OPEN) return;
    this.#socket.send(
      toBinary(dp.ClientMessageSchema, create(dp.ClientMessageSchema, { requestId: id, request })) as Uint8Array<ArrayBuffer>);
  }

  #open(): void {
    const socket = new WebSocket(`${this.#url.origin.replace(/^http/, "ws")}/ws`);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => {
      let message: dp.ServerMessage;
      try {
        message = fromBinary(dp.ServerMessageSchema, new Uint8Array(event.data));
      } catch {
        this.#fail(new GroundlockError(Code.INTERNAL, `${this.#url.origin}: not what a dashboard says`));
        return;
      }
      this.#take(message);
    };
    socket.onclose = () => this.#lost(socket);
  }

  #lost(socket: WebSocket): void {
    if (this.#socket !== socket || this.#error) return;
    this.#socket = undefined;
    const error = unavailable(`${this.#url.origin}: the connection to the dashboard broke`);
    for (const { reject } of this.#waiting.values()) reject(error);
    this.#waiting.clear();
    this.#clouds.clear();
    this.#lostAt ??= performance.now();
    if (performance.now() - this.#lostAt > this.#giveUpAfterMs) {
      this.#fail(error);
      return;
    }
    setTimeout(() => {
      if (!this.#error) this.#open();
    }, this.#pause);
    this.#pause = Math.min(2 * this.#pause, LAST_PAUSE_MS);
  }

  #fail(error: GroundlockError): void {
    this.#error ??= error;
    for (const { reject } of this.#waiting.values()) reject(error);
    this.#waiting.clear();
    for (const watch of this.#watches.values()) watch.end(error);
    for (const resolve of this.#changed.splice(0)) resolve();
    this.#greeted?.(error);
    this.#socket?.close();
  }

  #take(message: dp.ServerMessage): void {
    const waiting = this.#waiting.get(message.requestId);
    if (waiting && message.message.case === "progress") {
      waiting.progress?.(message.message.value);
      return;
    }
    if (waiting) {
      this.#waiting.delete(message.requestId);
      waiting.resolve(message.message);
      return;
    }
    const m = message.message;
    switch (m.case) {
      case "hello":
        if (this.#lostAt !== undefined && !this.#greeted) ++this.#reconnects;
        this.#lostAt = undefined;
        this.#pause = FIRST_PAUSE_MS;
        for (const watch of this.#watches.values()) void this.#resume(watch);
        break;
      case "serverState":
        this.#serverState(m.value);
        break;
      case "maps":
        this.#maps = m.value.maps.map((map) => c.mapFrom(map));
        break;
      case "sessions":
        this.#sessions = m.value.sessions.map((entry) => c.sessionFrom(entry.session));
        break;
      case "sources":
        this.#sources = m.value.sources.map(({ sourceId, name }) => ({ sourceId, name }));
        this.#uploaded.clear();
        for (const { sourceId, name, uploadId } of m.value.sources) {
          if (uploadId) this.#uploaded.set(uploadId, { sourceId, name });
        }
        for (const resolve of this.#changed.splice(0)) resolve();
        break;
      case "frameUpdate":
        this.#watches.get(m.value.sessionId)?.result(m.value);
        break;
      case "frameImage":
        this.#watches.get(m.value.sessionId)?.image(m.value);
        break;
      case "subscriptionState":
        this.#subscription(m.value);
        break;
      case "pointCloudBlock":
        if (m.value.points) {
          const key = `${m.value.mapName}@${m.value.mapVersion}`;
          this.#clouds.set(key, [...(this.#clouds.get(key) ?? []), m.value.points]);
          for (const resolve of this.#changed.splice(0)) resolve();
        }
        break;
    }
  }

  #serverState(state: dp.ServerState): void {
    if (state.state === dp.ServerState_State.UNAUTHENTICATED) {
      this.#fail(new GroundlockError(Code.UNAUTHENTICATED, state.message || "the token is no longer good"));
    } else {
      this.#greeted?.();
    }
  }

  async #resume(watch: Watch): Promise<void> {
    try {
      await this.#request("subscribed", watch.request());
    } catch (error) {
      const told = error as GroundlockError;
      // The dashboard itself may not have found its server again yet.
      if (told.code === Code.UNAVAILABLE) setTimeout(() => this.#again(watch), this.#pause);
      else watch.end(told.code === Code.NOT_FOUND ? undefined : told);
    }
  }
  #again(watch: Watch): void {
    // After a lost connection Hello does it.
    const open = this.#socket?.readyState === WebSocket.OPEN;
    if (open && this.#watches.get(watch.sessionId) === watch) void this.#resume(watch);
  }

  #subscription(state: dp.SubscriptionState): void {
    const watch = this.#watches.get(state.sessionId);
    if (state.state === dp.SubscriptionState_State.ENDED) watch?.end();
    else if (state.state === dp.SubscriptionState_State.FAILED) {
      watch?.end(new GroundlockError(Code.FAILED_PRECONDITION, state.message));
    }
  }
}

async function logIn(url: URL, token: string, timeoutMs: number): Promise<void> {
  let response: Response;
  try {
    response = await fetch(new URL("/api/login", url), {
      method: "POST",
      headers: { "Content-Type": "application/json" },
      body: JSON.stringify({ token: text("token", token) }),
      signal: AbortSignal.timeout(timeoutMs),
    });
  } catch (error) {
    if (error instanceof GroundlockError) throw error;
    throw unavailable(`${url.origin}: no dashboard answers`);
  }
  if (!response.ok) throw failureOf(response.status, await response.text(), "the log-in", "token");
}

function unavailable(words: string): GroundlockError {
  return new GroundlockError(Code.UNAVAILABLE, words);
}

function text(field: string, value: unknown): string {
  if (typeof value !== "string" || value === "") throw badArgument(field, "must be text, and not empty");
  return value;
}

function positive(field: string, value: number): number {
  if (finite(field, value) <= 0) throw badArgument(field, `${value} must be above 0`);
  return value;
}
