// SPDX-License-Identifier: Apache-2.0
// How much the machine can draw: fewer points and pixels when frames take long,
// more again when they do not; without a GPU also fewer frames, so that the
// image beside the scene keeps its rate.
import type { WebGLRenderer } from "three";

const SLOW_MS = 36; // below 28 frames/s
const FAST_MS = 20;
const MIN_POINTS = 60_000;
const MAX_POINTS = 1_500_000;
const SOFTWARE_POINTS = 120_000;
const SOFTWARE_PERIOD_MS = 80;
// Judged over so many frames, so that one hiccup changes nothing.
const WINDOW = 12;

export class Quality {
  readonly software: boolean;
  pointBudget: number;
  pixelRatio: number;
  private readonly fullRatio: number;
  private last = 0;
  private previous: number | null = null;
  private sum = 0;
  private count = 0;

  constructor(renderer: WebGLRenderer) {
    const gl = renderer.getContext();
    const info = gl.getExtension("WEBGL_debug_renderer_info");
    const name = info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
    this.software = /swiftshader|llvmpipe|software|basic render/i.test(name);
    this.fullRatio = this.software ? 1 : Math.min(2, window.devicePixelRatio || 1);
    this.pixelRatio = this.fullRatio;
    this.pointBudget = this.software ? SOFTWARE_POINTS : 1_000_000;
  }

  mayDraw(now: number): boolean {
    return !this.software || now - this.last >= SOFTWARE_PERIOD_MS;
  }

  // Nothing was drawn: the time to the next frame says nothing.
  idle(): void {
    this.previous = null;
  }

  // True if the pixel ratio changed.
  drawn(now: number): boolean {
    this.last = now;
    const before = this.previous;
    this.previous = now;
    if (this.software || before === null) return false;
    this.sum += now - before;
    if (++this.count < WINDOW) return false;
    const mean = this.sum / this.count;
    this.sum = 0;
    this.count = 0;
    const ratio = this.pixelRatio;
    if (mean > SLOW_MS) {
      this.pointBudget = Math.max(MIN_POINTS, 0.7 * this.pointBudget);
      if (this.pointBudget < 300_000) this.pixelRatio = Math.max(0.75, 0.85 * ratio);
    } else if (mean < FAST_MS) {
      this.pointBudget = Math.min(MAX_POINTS, 1.15 * this.pointBudget);
      if (this.pointBudget > 500_000) this.pixelRatio = Math.min(this.fullRatio, 1.1 * ratio);
    }
    return ratio !== this.pixelRatio;
  }
}
