// SPDX-License-Identifier: Apache-2.0
// What the page knows, as signals, and what it can ask the dashboard to do.
import { batch, computed, signal } from "@preact/signals";
import { cameraOf, makeRecord } from "../data/frame";
import {
  RecordingInfo_State,
  ServerState_State,
  SubscriptionState_State,
  type Hello,
  type PointCloudBlock,
  type PointCloudStart,
  type RecordingInfo,
  type ServerMessage,
  type ServerState,
  type SessionEntry,
  type Source,
  type SubscriptionState,
} from "../gen/groundlock/dashboard/v1/dashboard_pb";
import type { MapInfo } from "../gen/groundlock/v1/maps_pb";
import { BodyKind, type Session } from "../gen/groundlock/v1/tracking_pb";
import type { Box2 } from "../image/image_view";
import { Connection, RequestError, type LinkState } from "../link/connection";
import { fetchInfo, logIn, logOut, recordingUrl, webSocketUrl, HttpError } from "../link/http";
import { Recording } from "../replay/recording";
import type { CloudData } from "../scene/scene_view";
import { CloudAssembler } from "./cloud_loader";
import { imagesInFlight, ImageReceipts } from "./image_receipts";
import { wantedImageWidth } from "./image_width";
import { Player } from "./player";
import { message, toast } from "./toasts";

export type View =
  | { readonly kind: "live"; readonly id: string }
  | { readonly kind: "replay"; readonly id: string };

const INFO_RETRY_MS = 2000;
const MAX_EARLY_BLOCKS = 64;
const MISSED_RETRY_MS = 500;
// A window that is being resized asks for images of another size at the end.
const RESIZED_MS = 400;

export class Model {
  readonly access = signal<"checking" | "login" | "ready">("checking");
  readonly loginError = signal("");
  readonly link = signal<LinkState>("connecting");
  readonly everConnected = signal(false);
  readonly retryAt = signal(0);
  readonly hello = signal<Hello | null>(null);
  readonly server = signal<ServerState | null>(null);
  readonly sessions = signal<readonly SessionEntry[]>([]);
  readonly sessionsKnown = signal(false);
  readonly maps = signal<readonly MapInfo[]>([]);
  readonly sources = signal<readonly Source[]>([]);
  readonly recordings = signal<readonly RecordingInfo[]>([]);
  readonly freeBytes = signal(0n);
  readonly view = signal<View | null>(null);
  readonly session = signal<Session | null>(null); // of the view
  readonly subscription = signal<SubscriptionState | null>(null);
  readonly replayProgress = signal<number | null>(null);
  readonly selectedTarget = signal<string | null>(null);
  readonly cloud = signal<CloudData | null>(null);
  readonly cloudProgress = signal<number | null>(null);
  readonly cloudMap = signal<MapInfo | null>(null);
  readonly loginRequired = signal(false);
  readonly serverUnknown = signal(false);

  readonly entry = computed(() => {
    const view = this.view.value;
    return view?.kind === "live"
      ? (this.sessions.value.find((s) => s.session?.sessionId === view.id) ?? null)
      : null;
  });
  readonly camera = computed(() => cameraOf(this.session.value?.camera));
  readonly recordingNow = computed(() =>
    this.recordings.value.find(
      (r) => r.state === RecordingInfo_State.RECORDING && r.name === this.entry.value?.recording,
    ) ?? null,
  );
  readonly player = new Player();
  private readonly receipts = new ImageReceipts((sequence) => {
    const sessionId = this.view.value?.id ?? "";
    this.connection.tell({ case: "imageTaken", value: { sessionId, sequence: BigInt(sequence) } });
  });
  private inFlight = 0; // as subscribed
  private imageWidth = 0; // px of the screen; 0 = not known yet
  private widthTimer: ReturnType<typeof setTimeout> | undefined;
  readonly connection: Connection;
  private recording: Recording | null = null;
  private cloudWanted: { name: string; version: bigint } | null = null;
  private cloudParts: CloudAssembler | null = null;
  private earlyBlocks: PointCloudBlock[] = [];
  private cloudStart: PointCloudStart | null = null;

  constructor() {
    this.connection = new Connection(webSocketUrl(), {
      onState: (state, retryAt) => {
        batch(() => {
          this.link.value = state;
          this.retryAt.value = retryAt;
          if (state === "open") this.everConnected.value = true;
        });
        // A refused or broken connection may mean that the log-in has lapsed.
        if (state === "waiting" || state === "refused") void this.checkAccess();
      },
      onPushed: (m) => this.receive(m),
    });
  }

  // Access -------------------------------------------------------------------

  async start(): Promise<void> {
    for (;;) {
      try {
        await this.checkAccess();
        return;
      } catch {
        batch(() => {
          this.link.value = "waiting";
          this.retryAt.value = performance.now() + INFO_RETRY_MS;
        });
        await new Promise((resolve) => setTimeout(resolve, INFO_RETRY_MS));
      }
    }
  }

  private async checkAccess(): Promise<void> {
    let info;
    try {
      info = await fetchInfo();
    } catch (error) {
      if (this.access.value === "checking") throw error;
      return; // the connection's own retries go on
    }
    // Until the server has answered nobody knows whether it wants a token.
    this.serverUnknown.value = info.login_required === null;
    if (info.login_required === null && this.access.value === "checking") {
      throw new Error("the server has not answered yet");
    }
    this.loginRequired.value = info.login_required === true;
    if (info.login_required && !info.logged_in) {
      this.connection.stop();
      this.access.value = "login";
    } else {
      this.access.value = "ready";
      this.connection.start();
    }
  }

  async logIn(token: string): Promise<void> {
    this.loginError.value = "";
    try {
      await logIn(token);
      this.access.value = "ready";
      this.connection.start();
    } catch (error) {
      this.loginError.value =
        error instanceof HttpError && error.status === 401
          ? "The server does not know this token."
          : message(error);
    }
  }

  async logOut(): Promise<void> {
    try {
      await logOut();
      location.hash = "";
      location.reload();
    } catch (error) {
      toast("bad", message(error));
    }
  }

  // Where to look ------------------------------------------------------------

  open(view: View | null): void {
    const old = this.view.value;
    if (old?.kind === view?.kind && old?.id === view?.id) return;
    if (old?.kind === "live" && this.link.value === "open") {
      void this.connection
        .request("done", { case: "unsubscribe", value: { sessionId: old.id } })
        .catch(() => undefined);
    }
    this.recording?.close();
    this.recording = null;
    batch(() => {
      this.view.value = view;
      this.session.value = null;
      this.subscription.value = null;
      this.selectedTarget.value = null;
      this.replayProgress.value = null;
      this.setCloud(null, null);
      this.player.reset(view?.kind !== "replay", null);
    });
    this.cloudWanted = null;
    this.missed = false;
    this.receipts.clear();
    if (view?.kind === "live") this.subscribe(false);
    if (view?.kind === "replay") void this.replay(view.id);
  }

  private subscribe(again: boolean): void {
    const view = this.view.value;
    if (view?.kind !== "live" || this.link.value !== "open") return;
    this.inFlight = imagesInFlight(this.connection.clock.roundTripMs);
    this.connection
      .request("subscribed", {
        case: "subscribe",
        value: {
          sessionId: view.id,
          includeImages: true,
          skipHistory: again,
          maxImagesInFlight: this.inFlight,
          imageWidthPx: this.imageWidth,
        },
      })
      .then((reply) => {
        if (this.view.value?.id !== view.id) return;
        this.session.value = reply.session ?? null;
        const mapName = reply.session?.mapName;
        if (mapName) void this.loadCloud(mapName, reply.session!.mapVersion);
      })
      .catch((error: unknown) => {
        if (error instanceof RequestError && error.code === 14) return; // tried again
        if (error instanceof RequestError && error.code === 5) {
          // It may be among the sessions in the list by now, or will be.
          this.missed = true;
          setTimeout(() => this.returnToSession(), MISSED_RETRY_MS);
          return;
        }
        toast("bad", `${view.id}: ${message(error)}`);
      });
  }

  // The images are now shown so wide; px of the screen.
  setImageWidth(shownPx: number): void {
    const wanted = wantedImageWidth(shownPx);
    if (wanted === this.imageWidth) return;
    this.imageWidth = wanted;
    clearTimeout(this.widthTimer);
    this.widthTimer = setTimeout(() => this.subscribe(true), RESIZED_MS);
  }

  // An image has been drawn; the next one may come.
  imageShown(sequence: number): void {
    this.receipts.taken(sequence);
    // The way to the dashboard has become longer or shorter.
    if (Math.abs(imagesInFlight(this.connection.clock.roundTripMs) - this.inFlight) > 1) this.subscribe(true);
  }

  private async replay(name: string): Promise<void> {
    const cloud = new CloudAssembler();
    const recording = new Recording(recordingUrl(name), {
      onSession: (session) => (this.session.value = session),
      onMap: (map) => (this.cloudMap.value = map),
      onPoints: (block) => cloud.add(block),
      onResults: (records) => {
        if (recording.closed || records.length === 0) return;
        const first = this.player.history.length === 0;
        this.player.merge(records);
        if (first) {
          if (cloud.points > 0) this.setCloud(cloud.finish(), this.cloudMap.value);
          this.player.seek(records[0]!.timeS);
        }
      },
      onImage: (sequence, data) => this.player.addImage(sequence, data),
      onProgress: (fraction) => (this.replayProgress.value = fraction),
    });
    this.recording = recording;
    this.replayProgress.value = 0;
    this.player.reset(false, recording);
    try {
      await recording.read();
      if (!recording.closed && this.player.history.length === 0) {
        toast("bad", `Recording ${name} holds no frames.`);
      }
      // Results may have come before the images they are shown with.
      if (!recording.closed) this.player.seek(this.player.cursor.value ?? 0);
    } catch (error) {
      if (!recording.closed) toast("bad", `Recording ${name}: ${message(error)}`);
    } finally {
      if (this.recording === recording) this.replayProgress.value = null;
    }
  }

  // Points -------------------------------------------------------------------

  private setCloud(cloud: CloudData | null, map: MapInfo | null): void {
    this.cloud.value = cloud;
    this.cloudMap.value = map;
    this.cloudProgress.value = null;
  }

  private async loadCloud(name: string, version: bigint): Promise<void> {
    const wanted = this.cloudWanted;
    if (wanted?.name === name && wanted.version === version) return;
    this.cloudWanted = { name, version };
    this.cloudParts = new CloudAssembler();
    this.cloudStart = null;
    this.earlyBlocks = [];
    this.cloudProgress.value = 0;
    try {
      const start = await this.connection.request("pointCloudStart", {
        case: "getPointCloud",
        value: { mapName: name, mapVersion: version },
      });
      this.cloudStart = start;
      const early = this.earlyBlocks;
      this.earlyBlocks = [];
      for (const block of early) this.takeBlock(block);
      if (start.numBlocks === 0) this.setCloud(null, null);
    } catch (error) {
      this.cloudWanted = null;
      this.cloudProgress.value = null;
      toast("bad", `Map ${name}: ${message(error)}`);
    }
  }

  private takeBlock(block: PointCloudBlock): void {
    const start = this.cloudStart;
    if (!start) {
      if (this.earlyBlocks.length < MAX_EARLY_BLOCKS) this.earlyBlocks.push(block);
      return;
    }
    const parts = this.cloudParts;
    if (!parts || block.mapName !== start.mapName || block.mapVersion !== start.mapVersion) return;
    if (block.points) parts.add(block.points);
    this.cloudProgress.value = (block.index + 1) / block.numBlocks;
    if (block.index + 1 === block.numBlocks) {
      this.cloudParts = null;
      const map = this.maps.value.find((m) => m.name === start.mapName) ?? null;
      this.setCloud(parts.points > 0 ? parts.finish() : null, map);
    }
  }

  // Pushed messages ----------------------------------------------------------

  private receive({ message: m }: ServerMessage): void {
    switch (m.case) {
      case "hello":
        this.hello.value = m.value;
        this.subscribe(this.player.history.length > 0);
        return;
      case "serverState": {
        const before = this.server.value?.state;
        this.server.value = m.value;
        if (m.value.state === ServerState_State.UNAUTHENTICATED) void this.relogin();
        if (before === ServerState_State.UNREACHABLE && m.value.state === ServerState_State.CONNECTED) {
          toast("good", "The Groundlock server is back.");
        }
        return;
      }
      case "sessions":
        batch(() => {
          this.sessions.value = m.value.sessions;
          this.sessionsKnown.value = true;
        });
        this.returnToSession();
        return;
      case "maps":
        this.maps.value = m.value.maps;
        return;
      case "sources":
        this.sources.value = m.value.sources;
        return;
      case "recordings":
        batch(() => {
          this.recordings.value = m.value.recordings;
          this.freeBytes.value = m.value.freeBytes;
        });
        return;
      case "history":
        if (this.isLive(m.value.sessionId)) {
          this.player.merge(m.value.results.map((r) => makeRecord(r)));
        }
        return;
      case "frameUpdate":
        if (this.isLive(m.value.sessionId) && m.value.result) {
          const { result, skipped, hasImage, receivedTimeNs } = m.value;
          this.player.append(makeRecord(result, Number(skipped), hasImage, receivedTimeNs));
        }
        return;
      case "frameImage":
        if (this.isLive(m.value.sessionId) && m.value.image) {
          const sequence = Number(m.value.sequence);
          this.receipts.arrived(sequence);
          if (!this.player.addImage(sequence, m.value.image.data)) this.receipts.taken(sequence);
        }
        return;
      case "subscriptionState":
        if (!this.isLive(m.value.sessionId)) return;
        this.subscription.value = m.value;
        if (m.value.state === SubscriptionState_State.FAILED) {
          toast("bad", `${m.value.sessionId}: ${m.value.message}`);
        }
        return;
      case "pointCloudBlock":
        this.takeBlock(m.value);
        return;
    }
  }

  // A session of the same name has come (again) after ours had ended.
  private returnToSession(): void {
    const state = this.subscription.value?.state;
    const gone = state === SubscriptionState_State.ENDED || state === SubscriptionState_State.FAILED;
    if (!this.entry.value) this.missed = true;
    else if (gone || this.missed) {
      this.missed = false;
      this.subscription.value = null;
      this.subscribe(false);
    }
  }
  private missed = false; // the view's session was not among the listed ones

  private isLive(sessionId: string): boolean {
    return this.view.value?.kind === "live" && this.view.value.id === sessionId;
  }

  private async relogin(): Promise<void> {
    if (!this.loginRequired.value) return;
    this.connection.stop();
    this.loginError.value = "Your log-in has lapsed.";
    this.access.value = "login";
  }

  // Targets ------------------------------------------------------------------

  async setTarget(box: Box2, targetId = "", kind = BodyKind.UNSPECIFIED): Promise<void> {
    const sessionId = this.view.value?.id ?? "";
    try {
      const reply = await this.connection.request("targetSet", {
        case: "setTarget",
        value: { sessionId, targetId, box, ...(kind !== BodyKind.UNSPECIFIED && { body: { kind } }) },
      });
      this.selectedTarget.value = reply.targetId;
      toast("good", `Target ${reply.targetId} is marked in the next frame.`);
    } catch (error) {
      toast("bad", `The target could not be marked: ${message(error)}`);
    }
  }

  async moveTarget(targetId: string, box: Box2): Promise<void> {
    const sessionId = this.view.value?.id ?? "";
    await this.attempt(`Target ${targetId} could not be moved`, () =>
      this.connection.request("done", { case: "moveTarget", value: { sessionId, targetId, box } }),
    );
  }

  async dropTarget(targetId: string): Promise<void> {
    const sessionId = this.view.value?.id ?? "";
    await this.attempt(`Target ${targetId} could not be dropped`, () =>
      this.connection.request("done", { case: "dropTarget", value: { sessionId, targetId } }),
    );
    if (this.selectedTarget.value === targetId) this.selectedTarget.value = null;
  }

  // Recording ----------------------------------------------------------------

  async toggleRecording(): Promise<void> {
    const view = this.view.value;
    if (view?.kind !== "live") return;
    if (this.entry.value?.recording) {
      await this.attempt("The recording could not be ended", async () => {
        const info = await this.connection.request("recording", {
          case: "stopRecording",
          value: { sessionId: view.id },
        });
        toast("good", `Recorded ${info.name}: ${info.frames} frames.`);
      });
    } else {
      await this.attempt("The recording could not be started", () =>
        this.connection.request("recording", { case: "startRecording", value: { sessionId: view.id } }),
      );
    }
  }

  // Runs a request; an error becomes a message. True if it succeeded.
  async attempt(what: string, run: () => Promise<unknown>): Promise<boolean> {
    try {
      await run();
      return true;
    } catch (error) {
      toast("bad", `${what}: ${message(error)}`);
      return false;
    }
  }
}
