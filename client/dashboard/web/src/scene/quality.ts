// SPDX-License-Identifier: Apache-2.0
// How much the machine can draw. A fence tells how long a frame of the scene
// really takes: fewer points and pixels when that is long, more again when it
// is not; and never another frame before the last one is done, so that the
// image beside the scene keeps its rate. Without a GPU the processor draws, and
// the scene takes a small share of it.

const SLOW_MS = 28;
const FAST_MS = 12;
const MIN_POINTS = 60_000;
const MAX_POINTS = 2_000_000;
const START_POINTS = 1_000_000;
const SOFTWARE_POINTS = 40_000;
const SOFTWARE_PERIOD_MS = 150;
const MAX_SOFTWARE_PERIOD_MS = 1000;
// Of the time, without a GPU: drawing takes one part in so many.
const SOFTWARE_SHARE = 6;
// Judged over so many frames, so that one hiccup changes nothing.
const WINDOW = 12;
// A fence that never comes (a lost context) must not stop the scene.
const FENCE_PATIENCE_MS = 4000;

// True if WebGL is done by the processor.
export function softwareRendering(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl && info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(name);
}

export class Quality {
  pointBudget: number;
  pixelRatio: number;
  // Of the last frames, ms; null before the first one is done.
  cost: number | null = null;
  private readonly fullRatio: number;
  private fence: WebGLSync | null = null;
  private started = 0;
  private notBefore = 0;
  private sum = 0;
  private count = 0;

  constructor(
    private readonly gl: WebGL2RenderingContext,
    private readonly software: boolean,
    private readonly onDone: () => void,
  ) {
    this.fullRatio = software ? 1 : Math.min(2, window.devicePixelRatio || 1);
    this.pixelRatio = this.fullRatio;
    this.pointBudget = software ? SOFTWARE_POINTS : START_POINTS;
  }

  // False while the last frame is being drawn, or the scene has had its share.
  mayDraw(now: number): boolean {
    if (this.fence) {
      const done = this.gl.getSyncParameter(this.fence, this.gl.SYNC_STATUS) === this.gl.SIGNALED;
      if (!done && now - this.started < FENCE_PATIENCE_MS) return false;
      this.gl.deleteSync(this.fence);
      this.fence = null;
      this.finished(now);
      this.onDone();
    }
    return now >= this.notBefore;
  }

  // The user has changed something, and does not wait.
  hurry(): void {
    this.notBefore = 0;
  }

  // Call after a frame was given to the GPU.
  drawn(now: number): void {
    this.started = now;
    this.fence = this.gl.fenceSync(this.gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.gl.flush();
  }

  // True if the pixel ratio is to change; it has then.
  adapt(): boolean {
    if (this.software || this.count < WINDOW) return false;
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

  private finished(now: number): void {
    const cost = now - this.started;
    this.cost = this.cost === null ? cost : 0.7 * this.cost + 0.3 * cost;
    this.sum += cost;
    this.count++;
    if (this.software) {
      const period = Math.max(SOFTWARE_PERIOD_MS, SOFTWARE_SHARE * this.cost);
      this.notBefore = this.started + Math.min(period, MAX_SOFTWARE_PERIOD_MS);
    }
  }
}
