// SPDX-License-Identifier: Apache-2.0
// The page's own state (tools, layers, windows) and what keys and buttons do.
import { computed, effect, signal } from "@preact/signals";
import { BodyKind } from "../gen/groundlock/v1/tracking_pb";
import { ImageView, type Box2, type ImageMode } from "../image/image_view";
import type { Shown } from "../image/presenter";
import { SceneView, type ViewMode } from "../scene/scene_view";
import { palette, theme } from "../ui/theme";
import { Beat } from "./beat";
import { GroundTool } from "./ground_tool";
import { LatencyMeter } from "./latency_meter";
import { Model, type View } from "./model";
import { TimeRange } from "./time_range";
import { message, toast } from "./toasts";

export type DialogName = "start" | "maps" | "sessions" | "export" | "help" | null;
export type Layout = "split" | "image" | "scene";

export class App {
  readonly model = new Model();
  readonly time = new TimeRange(this.model.player);
  readonly latency = new LatencyMeter();
  readonly beat = new Beat();
  readonly ground = new GroundTool(this.model);
  readonly dialog = signal<DialogName>(null);
  readonly mode = signal<ImageMode>("look");
  // The target that the next drawn box marks anew; null = a new one.
  readonly redraws = signal<string | null>(null);
  // Of what kind the next targets are; not told: what their size lets one guess.
  readonly bodyKind = signal(BodyKind.UNSPECIFIED);
  readonly stabilized = signal(false);
  readonly layers = signal({ landmarks: true, boxes2d: true, boxes3d: true, movers: true, points: true, mapCameras: true, trails: true });
  readonly viewMode = signal<ViewMode>("orbit");
  readonly layout = signal<Layout>("split");
  readonly sceneStats = signal("");
  readonly sceneError = signal("");
  // Targets in the order in which they were first seen: their colours.
  readonly targetOrder = signal<readonly string[]>([]);
  readonly live = computed(() => this.model.view.value?.kind === "live" && this.model.player.cursor.value === null);
  readonly image: ImageView;
  readonly scene: SceneView | null;
  private sceneTimer = 0;

  constructor() {
    this.image = new ImageView({
      onDrawn: (box) => this.drawn(box),
      onMoved: (id, box) => {
        this.setMode("look");
        void this.model.moveTarget(id, box);
      },
      onSelect: (id) => (this.model.selectedTarget.value = id),
      onMover: (mover) => this.takeMover(mover.moverId),
      onCancel: () => this.setMode("look"),
      onWidth: (shownPx) => this.model.setImageWidth(shownPx),
    });
    this.scene = this.makeScene();
    const { player } = this.model;
    player.onShow = (shown) => this.show(shown);
    this.connectViews();
    this.followAddress();
  }

  private makeScene(): SceneView | null {
    try {
      const scene = new SceneView(this.image.image);
      scene.onStats = (text) => {
        if (performance.now() - this.sceneTimer < 300) return;
        this.sceneTimer = performance.now();
        this.sceneStats.value = text;
      };
      scene.onPick = (point) => this.ground.add(point);
      return scene;
    } catch (error) {
      this.sceneError.value = `The 3D scene needs WebGL 2: ${message(error)}`;
      return null;
    }
  }

  private connectViews(): void {
    const { model } = this;
    effect(() => {
      this.image.setColors(palette.value);
      this.scene?.setColors(palette.value, theme.value === "dark");
    });
    effect(() => this.image.setMode(this.mode.value));
    effect(() => this.image.setStabilized(this.stabilized.value));
    effect(() => this.image.setSelected(model.selectedTarget.value));
    effect(() => {
      const layers = this.layers.value;
      this.image.options = layers;
      this.image.redraw();
      if (this.scene) {
        this.scene.layers = layers;
        this.scene.refresh();
      }
    });
    effect(() => this.scene?.setMode(this.viewMode.value));
    effect(() => this.scene?.setCloud(model.cloud.value));
    effect(() => {
      const ground = model.cloudMap.value?.groundWorld;
      const n = ground?.normal;
      const asked = this.ground.plane.value;
      if (asked) this.scene?.setGround(asked.normal, asked.d);
      else this.scene?.setGround(n ? [n.x, n.y, n.z] : [0, 0, 1], ground?.d ?? 0);
    });
    effect(() => this.scene?.setPicking(this.ground.active.value));
    effect(() => this.scene?.setPicked(this.ground.places.value));
    effect(() => {
      model.view.value;
      this.image.clear();
      this.scene?.clear();
      this.targetOrder.value = [];
      this.latency.clear();
      this.ground.clear();
      this.setMode("look");
      this.time.follow();
      this.time.span.value = model.view.peek()?.kind === "replay" ? "all" : 60;
    });
    effect(() => {
      model.player.grown.value;
      const order = this.targetOrder.peek();
      const last = model.player.history.last;
      const fresh = (last?.result.targets ?? []).map((t) => t.targetId).filter((id) => !order.includes(id));
      if (fresh.length > 0) this.targetOrder.value = [...order, ...fresh];
    });
  }

  private show(shown: Shown): void {
    const camera = this.model.camera.peek();
    const { player } = this.model;
    const order = this.targetOrder.peek();
    const fresh = shown.record.result.targets.map((t) => t.targetId).filter((id) => !order.includes(id));
    if (fresh.length > 0) this.targetOrder.value = [...order, ...fresh];
    this.image.show(shown, camera);
    this.scene?.show({
      record: shown.record,
      history: player.history,
      camera,
      withImage: shown.picture !== null,
      order: this.targetOrder.peek(),
    });
    this.beat.frame();
    if (player.isLive && player.cursor.peek() === null && shown.imageSequence === shown.record.sequence) {
      const { sequence } = shown.record;
      this.latency.drawn(shown.record, this.model.connection.clock, () => this.model.imageShown(sequence));
    }
  }

  private drawn(box: Box2): void {
    const id = this.redraws.peek() ?? "";
    this.setMode("look");
    void this.model.setTarget(box, id, this.bodyKind.peek());
  }

  // Makes what moves a target, by its box in the newest frame: the one that was
  // clicked may be old.
  takeMover(moverId: bigint): void {
    if (!this.canMark()) return;
    const newest = this.model.player.history.last;
    const box = newest?.result.movers.find((m) => m.moverId === moverId)?.box;
    if (!box) {
      toast("bad", "It does not move any more, or is out of view.");
      return;
    }
    const { x, y, width, height } = box;
    void this.model.setTarget({ x, y, width, height });
  }

  setMode(mode: ImageMode, target: string | null = null): void {
    this.redraws.value = mode === "draw" ? target : null;
    this.mode.value = mode;
    if (mode !== "look") {
      if (!this.live.peek()) this.goLive();
      this.image.element.focus({ preventScroll: true });
    }
  }

  // Boxes can be drawn in sessions only, and only now.
  canMark(): boolean {
    return this.model.view.value?.kind === "live";
  }

  // Time ---------------------------------------------------------------------

  jump(timeS: number): void {
    this.time.freeze();
    this.model.player.playing.value = false;
    this.model.player.seek(timeS);
  }

  step(frames: number): void {
    this.time.freeze();
    this.model.player.step(frames);
  }

  togglePlay(): void {
    if (this.live.peek()) this.time.freeze();
    this.model.player.togglePlay();
  }

  goLive(): void {
    this.time.follow();
    if (this.model.player.isLive) this.model.player.seek(null);
  }

  // The address --------------------------------------------------------------

  // #/session/ID and #/replay/NAME.
  private followAddress(): void {
    const read = () => {
      const match = /^#\/(session|replay)\/(.+)$/.exec(location.hash);
      let id = "";
      try {
        id = match ? decodeURIComponent(match[2]!) : "";
      } catch {
        toast("bad", "The address names no session.");
      }
      this.model.open(id ? { kind: match![1] === "replay" ? "replay" : "live", id } : null);
    };
    addEventListener("hashchange", read);
    read();
    effect(() => {
      const view = this.model.view.value;
      document.title = view ? `${view.id} · Groundlock` : "Groundlock";
    });
    // Whoever opens the bare address sees what is going on.
    const stop = effect(() => {
      if (!this.model.sessionsKnown.value) return;
      const streaming = this.model.sessions.value.filter((s) => s.session?.streaming);
      queueMicrotask(() => stop());
      if (this.model.view.peek() || streaming.length !== 1) return;
      this.go({ kind: "live", id: streaming[0]!.session!.sessionId });
    });
  }

  go(view: View | null): void {
    this.dialog.value = null;
    location.hash = view ? `#/${view.kind === "replay" ? "replay" : "session"}/${encodeURIComponent(view.id)}` : "#/";
  }

  toggleLayer(name: keyof App["layers"]["value"]): void {
    this.layers.value = { ...this.layers.value, [name]: !this.layers.value[name] };
  }
}
