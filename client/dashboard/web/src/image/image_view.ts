// SPDX-License-Identifier: Apache-2.0
// The camera's image with its overlay, raw or stabilised, and the drawing of
// boxes with mouse, finger or keys. The stabilising warp is a CSS transform of
// the image's canvas: the compositor does it, and no pixel passes our hands.
import type { FrameRecord } from "../data/frame";
import { worldFromCamera, type Mover } from "../data/frame";
import { moverAt } from "../data/movers";
import type { Camera } from "../math/camera";
import { applyHomography, invert3, stabilizingHomography, Stabilizer } from "../math/stabilizer";
import type { Mat3, Vec2 } from "../math/pose";
import type { Token } from "../ui/theme";
import { heightOf, widthOf } from "./decode";
import { drawLabel, drawOverlay, type OverlayOptions } from "./overlay";
import type { Shown } from "./presenter";

export interface Box2 {
  x: number;
  y: number;
  width: number;
  height: number;
}
export type ImageMode = "look" | "draw" | "move";

export interface ImageViewEvents {
  onDrawn(box: Box2): void;
  onMoved(targetId: string, box: Box2): void;
  onSelect(targetId: string | null): void;
  // What moves, and is no target, was clicked.
  onMover(mover: Mover): void;
  onCancel(): void;
  // The image is now shown so wide; px of the screen.
  onWidth(shownPx: number): void;
}

const MIN_BOX_PX = 4;
const KEY_STEP_PX = 8;

interface Drag {
  from: Vec2; // image pixels
  to: Vec2;
  target?: { id: string; box: Box2 };
}

export class ImageView {
  readonly element: HTMLElement;
  readonly image: HTMLCanvasElement; // the raw image; also the 3D texture
  options: OverlayOptions = { landmarks: true, boxes2d: true, boxes3d: true, movers: true };
  private readonly overlay: HTMLCanvasElement;
  private readonly clip: HTMLElement;
  private readonly stabilizer = new Stabilizer();
  private stabilized = false;
  private homography: Mat3 | null = null;
  private shown: Shown | null = null;
  private camera: Camera | null = null;
  private colors: Record<Token, string> | null = null;
  private mode: ImageMode = "look";
  private drag: Drag | null = null;
  private crosshair: Vec2 | null = null; // while drawing with keys
  private selected: string | null = null;
  private size: Vec2 = [1280, 720]; // of the image, pixels
  private scale = 1; // CSS pixels per image pixel
  private offset: Vec2 = [0, 0];
  private readonly observer: ResizeObserver;

  constructor(private readonly events: ImageViewEvents) {
    this.element = document.createElement("div");
    this.element.className = "image-view";
    this.element.tabIndex = 0;
    this.element.setAttribute("role", "application");
    this.clip = document.createElement("div");
    this.clip.className = "image-clip";
    this.image = document.createElement("canvas");
    this.image.className = "image-canvas";
    this.image.width = 2;
    this.image.height = 2;
    this.overlay = document.createElement("canvas");
    this.overlay.className = "image-overlay";
    this.clip.append(this.image);
    this.element.append(this.clip, this.overlay);
    this.observer = new ResizeObserver(() => this.layout());
    this.observer.observe(this.element);
    this.listen();
    this.describe();
  }

  dispose(): void {
    this.observer.disconnect();
    this.element.remove();
  }

  setColors(colors: Record<Token, string>): void {
    this.colors = colors;
    this.redraw();
  }

  setMode(mode: ImageMode): void {
    this.mode = mode;
    this.drag = null;
    this.crosshair = null;
    this.element.dataset.mode = mode;
    this.describe();
    this.redraw();
  }

  setSelected(id: string | null): void {
    this.selected = id;
    this.redraw();
  }

  setStabilized(on: boolean): void {
    this.stabilized = on;
    this.stabilizer.reset();
    this.updateHomography();
    this.redraw();
  }

  clear(): void {
    this.shown = null;
    this.homography = null;
    this.stabilizer.reset();
    this.image.width = this.image.width; // clears it
    this.redraw();
  }

  // Draws at once: the picture need not outlive the call.
  show(shown: Shown, camera: Camera | null): void {
    const restarted = this.shown !== null && shown.record.timeS < this.shown.record.timeS;
    this.shown = shown;
    this.camera = camera;
    if (restarted) this.stabilizer.reset();
    const { picture } = shown;
    if (picture) {
      const [width, height] = [widthOf(picture), heightOf(picture)];
      if (this.image.width !== width || this.image.height !== height) {
        this.image.width = width;
        this.image.height = height;
      }
      this.image.getContext("2d", { alpha: false })!.drawImage(picture, 0, 0);
    } else {
      this.image.getContext("2d", { alpha: false })!.clearRect(0, 0, this.image.width, this.image.height);
    }
    const size: Vec2 = camera
      ? [camera.width, camera.height]
      : picture
        ? [this.image.width, this.image.height]
        : this.size;
    if (size[0] !== this.size[0] || size[1] !== this.size[1]) {
      this.size = size;
      this.layout();
    }
    this.updateHomography();
    this.redraw();
  }

  get record(): FrameRecord | null {
    return this.shown?.record ?? null;
  }

  private updateHomography(): void {
    const record = this.shown?.record;
    const raw = record ? worldFromCamera(record)?.rotation ?? null : null;
    this.homography = null;
    if (this.stabilized && record && this.camera) {
      const smooth = this.stabilizer.update(raw, record.timeS);
      if (raw && smooth) this.homography = stabilizingHomography(this.camera, raw, smooth);
    }
    this.applyTransform();
  }

  private layout(): void {
    const width = this.element.clientWidth;
    const height = this.element.clientHeight;
    if (width === 0 || height === 0) return;
    this.scale = Math.min(width / this.size[0], height / this.size[1]);
    const w = this.size[0] * this.scale;
    const h = this.size[1] * this.scale;
    this.offset = [0.5 * (width - w), 0.5 * (height - h)];
    Object.assign(this.clip.style, {
      left: `${this.offset[0]}px`,
      top: `${this.offset[1]}px`,
      width: `${w}px`,
      height: `${h}px`,
    });
    const ratio = window.devicePixelRatio || 1;
    this.events.onWidth(w * ratio);
    this.overlay.width = Math.round(width * ratio);
    this.overlay.height = Math.round(height * ratio);
    this.applyTransform();
    this.redraw();
  }

  private applyTransform(): void {
    const h = this.homography;
    if (!h) {
      this.image.style.transform = "";
      return;
    }
    const s = this.scale;
    // S H S^-1 in CSS pixels, column by column.
    const m = [
      h[0], h[3], 0, h[6] / s,
      h[1], h[4], 0, h[7] / s,
      0, 0, 1, 0,
      h[2] * s, h[5] * s, 0, h[8],
    ];
    this.image.style.transform = `matrix3d(${m.map((v) => v.toFixed(10)).join(",")})`;
  }

  // Image pixels to CSS pixels of the pane.
  private readonly toView = (p: Vec2): Vec2 => {
    const [x, y] = this.homography ? applyHomography(this.homography, p[0], p[1]) : p;
    return [x * this.scale + this.offset[0], y * this.scale + this.offset[1]];
  };

  private fromView(x: number, y: number): Vec2 {
    const px = (x - this.offset[0]) / this.scale;
    const py = (y - this.offset[1]) / this.scale;
    const [u, v] = this.homography ? applyHomography(invert3(this.homography), px, py) : [px, py];
    return [Math.min(this.size[0], Math.max(0, u)), Math.min(this.size[1], Math.max(0, v))];
  }

  redraw(): void {
    const c = this.overlay.getContext("2d")!;
    const ratio = window.devicePixelRatio || 1;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, this.overlay.width, this.overlay.height);
    const colors = this.colors;
    if (!colors) return;
    c.save();
    c.beginPath();
    c.rect(this.offset[0], this.offset[1], this.size[0] * this.scale, this.size[1] * this.scale);
    c.clip();
    if (this.shown) {
      drawOverlay(c, {
        record: this.shown.record,
        camera: this.camera,
        colors,
        options: this.options,
        toView: this.toView,
        selected: this.selected,
      });
    }
    this.drawPending(c, colors);
    c.restore();
  }

  private drawPending(c: CanvasRenderingContext2D, colors: Record<Token, string>): void {
    const box = this.pendingBox();
    if (box && box.width > 0 && box.height > 0) {
      const [ax, ay] = this.toView([box.x, box.y]);
      const [bx, by] = this.toView([box.x + box.width, box.y + box.height]);
      c.fillStyle = "rgba(255, 255, 255, 0.12)";
      c.fillRect(ax, ay, bx - ax, by - ay);
      c.lineWidth = 2;
      c.strokeStyle = colors.accent;
      c.strokeRect(ax, ay, bx - ax, by - ay);
      drawLabel(c, ax, ay - 4, `${Math.round(box.width)} × ${Math.round(box.height)} px`, colors.accent);
    }
    if (this.crosshair) {
      const [x, y] = this.toView(this.crosshair);
      c.strokeStyle = colors.accent;
      c.lineWidth = 1;
      c.beginPath();
      c.moveTo(x - 16, y);
      c.lineTo(x + 16, y);
      c.moveTo(x, y - 16);
      c.lineTo(x, y + 16);
      c.stroke();
    }
  }

  private pendingBox(): Box2 | null {
    const drag = this.drag;
    if (!drag) return null;
    if (drag.target) {
      const { box } = drag.target;
      return { ...box, x: box.x + drag.to[0] - drag.from[0], y: box.y + drag.to[1] - drag.from[1] };
    }
    return {
      x: Math.min(drag.from[0], drag.to[0]),
      y: Math.min(drag.from[1], drag.to[1]),
      width: Math.abs(drag.to[0] - drag.from[0]),
      height: Math.abs(drag.to[1] - drag.from[1]),
    };
  }

  // The smallest target box around a point.
  private hit(p: Vec2): { id: string; box: Box2 } | null {
    let best: { id: string; box: Box2 } | null = null;
    for (const t of this.shown?.record.result.targets ?? []) {
      const b = t.box;
      if (!b || p[0] < b.x || p[1] < b.y || p[0] > b.x + b.width || p[1] > b.y + b.height) continue;
      if (!best || b.width * b.height < best.box.width * best.box.height) {
        best = { id: t.targetId, box: { x: b.x, y: b.y, width: b.width, height: b.height } };
      }
    }
    return best;
  }

  private finish(): void {
    const box = this.pendingBox();
    const target = this.drag?.target;
    this.drag = null;
    this.crosshair = null;
    this.redraw();
    if (!box) return;
    if (target) this.events.onMoved(target.id, box);
    else if (box.width >= MIN_BOX_PX && box.height >= MIN_BOX_PX) this.events.onDrawn(box);
  }

  private listen(): void {
    const at = (event: PointerEvent): Vec2 => {
      const rect = this.element.getBoundingClientRect();
      return this.fromView(event.clientX - rect.left, event.clientY - rect.top);
    };
    this.element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      const p = at(event);
      const target = this.hit(p);
      if (this.mode === "look") {
        const mover = !target && this.options.movers && this.shown ? moverAt(this.shown.record, p) : null;
        if (mover) this.events.onMover(mover);
        else this.events.onSelect(target?.id ?? null);
        return;
      }
      if (this.mode === "move" && !target) return;
      this.drag = { from: p, to: p, ...(this.mode === "move" && target ? { target } : {}) };
      this.element.setPointerCapture(event.pointerId);
      event.preventDefault();
      this.element.focus({ preventScroll: true });
    });
    this.element.addEventListener("pointermove", (event) => {
      if (!this.drag || !this.element.hasPointerCapture(event.pointerId)) return;
      this.drag.to = at(event);
      this.redraw();
    });
    this.element.addEventListener("pointerup", (event) => {
      if (this.drag && this.element.hasPointerCapture(event.pointerId)) this.finish();
    });
    this.element.addEventListener("pointercancel", () => {
      this.drag = null;
      this.redraw();
    });
    this.element.addEventListener("keydown", (event) => this.onKey(event));
  }

  private onKey(event: KeyboardEvent): void {
    if (this.mode === "look" || event.ctrlKey || event.metaKey || event.altKey) return;
    const step = event.shiftKey ? 1 : KEY_STEP_PX;
    const moves: Record<string, Vec2> = {
      ArrowLeft: [-step, 0],
      ArrowRight: [step, 0],
      ArrowUp: [0, -step],
      ArrowDown: [0, step],
    };
    const move = moves[event.key];
    if (move) {
      const p = this.crosshair ?? [0.5 * this.size[0], 0.5 * this.size[1]];
      this.crosshair = [
        Math.min(this.size[0], Math.max(0, p[0] + move[0])),
        Math.min(this.size[1], Math.max(0, p[1] + move[1])),
      ];
      if (this.drag) this.drag.to = this.crosshair;
      this.redraw();
    } else if (event.key === "Enter") {
      if (this.drag) {
        this.finish();
      } else {
        const p: Vec2 = this.crosshair ?? [0.5 * this.size[0], 0.5 * this.size[1]];
        const target = this.mode === "move" ? this.hit(p) : null;
        if (this.mode === "draw" || target) {
          this.crosshair = p;
          this.drag = { from: p, to: p, ...(target ? { target } : {}) };
          this.redraw();
        }
      }
    } else if (event.key === "Escape") {
      this.events.onCancel();
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
  }

  private describe(): void {
    const how = {
      look: "Camera image. Press B to draw a box around a target, M to move one. A click on what moves makes it a target.",
      draw: "Draw a box: drag, or move the cross with the arrow keys and press Enter at two corners. Escape ends.",
      move: "Move a target: drag its box, or move the cross with the arrow keys, press Enter on it, and Enter again where it is. Escape ends.",
    }[this.mode];
    this.element.setAttribute("aria-label", how);
  }
}
