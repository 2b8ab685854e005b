// SPDX-License-Identifier: Apache-2.0
// Groundlock in a browser: through the WebSocket of groundlock-dashboard, which
// serves the page, too. Results and errors are those of the client for Node.
/// <reference lib="dom" />
import { create, fromBinary, toBinary } from "@bufbuild/protobuf";
import type { MessageInitShape } from "@bufbuild/protobuf";
import { choice, finite, identifier, mapName, whole } from "./checks.js";
import * as c from "./convert.js";
import { Code, GroundlockError, badArgument, errorOf } from "./errors.js";
import * as dp from "./gen/groundlock/dashboard/v1/dashboard_pb.js";
import type * as mp from "./gen/groundlock/v1/maps_pb.js";
import type { BoxLike } from "./geometry.js";
import type * as t from "./types.js";

export { Code, GroundlockError } from "./errors.js";
export type { CodeName } from "./errors.js";
export type {
  Box2, Box3, BoxLike, CameraModel, CameraModelName, GeodeticPosition, Plane, Quaternion, RigidTransform,
  SimilarityTransform, Vector3,
} from "./geometry.js";
export { CAMERA_MODELS, apply, compose, corners, inverse, iou, rotate, rotationMatrix, toMatrix } from "./geometry.js";
export type { Encoding, Image } from "./images.js";
export type * from "./types.js";

type Request = NonNullable<MessageInitShape<typeof dp.ClientMessageSchema>["request"]>;
type Reply = dp.ServerMessage["message"];
type Case = NonNullable<Reply["case"]>;
type Value<C extends Case> = Extract<Reply, { case: C }>["value"];

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

const ACTIONS = {
  play: dp.ControlSource_Action.PLAY,
  pause: dp.ControlSource_Action.PAUSE,
  stop: dp.ControlSource_Action.STOP,
  step: dp.ControlSource_Action.STEP,
} as const;
const FIRST_PAUSE_MS = 200;
const LAST_PAUSE_MS = 3_000;
// Results that wait for who iterates; older ones are left out and counted.
const MAX_WAITING = 256;

interface Waiting {
  readonly resolve: (reply: Reply) => void;
  readonly reject: (error: GroundlockError) => void;
}

/** One connection, which comes back by itself when it was lost; watches go on then. */
export class Dashboard {
  readonly #url: URL;
  readonly #giveUpAfterMs: number;
  readonly #waiting = new Map<bigint, Waiting>();
  readonly #watches = new Map<string, Watch>();
  readonly #clouds = new Map<string, mp.GetPointCloudResponse[]>();
  #cloudsChanged: (() => void)[] = [];
  #socket: WebSocket | undefined;
  #nextId = 1n;
  #lostAt: number | undefined;
  #pause = FIRST_PAUSE_MS;
  #error: GroundlockError | undefined;
  #greeted: ((error?: GroundlockError) => void) | undefined;
  #maps: readonly t.MapInfo[] = [];
  #sessions: readonly t.SessionInfo[] = [];
  #sources: readonly Source[] = [];
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

  /** Marks a target by its box, px, in the next frame; resolves to its id. */
  async setTarget(sessionId: string, targetId: string, box: BoxLike): Promise<string> {
    const value = {
      sessionId: identifier("sessionId", sessionId),
      targetId: identifier("targetId", targetId, true),
      box: c.boxTo("box", box),
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
      await new Promise<void>((resolve) => this.#cloudsChanged.push(resolve));
      if (this.#error) throw this.#error;
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

  async #request<C extends Case>(expected: C, request: Request): Promise<Value<C>> {
    if (this.#error) throw this.#error;
    const id = this.#nextId++;
    const reply = await new Promise<Reply>((resolve, reject) => {
      if (this.#socket?.readyState !== WebSocket.OPEN) {
        reject(unavailable(`${this.#url.origin}: not connected to the dashboard; it is tried again`));
        return;
      }
      this.#waiting.set(id, { resolve, reject });
      this.#tell(request, id);
    });
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
    for (const resolve of this.#cloudsChanged.splice(0)) resolve();
    this.#greeted?.(error);
    this.#socket?.close();
  }

  #take(message: dp.ServerMessage): void {
    const waiting = this.#waiting.get(message.requestId);
    if (waiting && message.message.case !== "progress") {
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
          for (const resolve of this.#cloudsChanged.splice(0)) resolve();
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

/** What has come of a session, and who waits for it. */
class Watch {
  readonly #ready: t.WatchUpdate[] = [];
  #held: dp.FrameUpdate | undefined; // its image is to follow
  #skipped = 0;
  #wake: (() => void) | undefined;
  #ended = false;
  #error: GroundlockError | undefined;

  constructor(readonly sessionId: string, readonly images: boolean, readonly widthPx: number) {}

  request(): Request {
    this.#held = undefined;
    return {
      case: "subscribe",
      value: {
        sessionId: this.sessionId, includeImages: this.images, skipHistory: true,
        maxImagesInFlight: 2, imageWidthPx: this.widthPx,
      },
    };
  }

  result(update: dp.FrameUpdate): void {
    this.#release(undefined); // its image was replaced by a newer one
    if (this.images && update.hasImage) this.#held = update;
    else this.#push(update, undefined);
  }
  image(image: dp.FrameImage): void {
    if (this.#held?.result?.sequence === image.sequence) this.#release(image);
  }
  end(error?: GroundlockError): void {
    this.#ended = true;
    this.#error = error;
    this.#wake?.();
  }

  async next(): Promise<t.WatchUpdate | undefined> {
    for (;;) {
      const update = this.#ready.shift();
      if (update) return update;
      if (this.#error) throw this.#error;
      if (this.#ended) return undefined;
      await new Promise<void>((resolve) => (this.#wake = resolve));
    }
  }

  #release(image: dp.FrameImage | undefined): void {
    const update = this.#held;
    this.#held = undefined;
    if (update) this.#push(update, image);
  }
  #push(update: dp.FrameUpdate, image: dp.FrameImage | undefined): void {
    if (this.#ready.length >= MAX_WAITING) {
      this.#ready.shift();
      ++this.#skipped;
    }
    this.#ready.push({
      result: c.resultFrom(update.result),
      image: image?.image && c.imageFrom(image.image),
      skipped: Number(update.skipped) + this.#skipped,
    });
    this.#skipped = 0;
    this.#wake?.();
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
  if (response.ok) return;
  const told = (await response.json().catch(() => ({}))) as { code?: string; message?: string };
  const code = Code[(told.code ?? "UNKNOWN") as keyof typeof Code] ?? Code.UNKNOWN;
  throw new GroundlockError(code, told.message ?? `the log-in was answered by ${response.status}`, "token");
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
