// SPDX-License-Identifier: Apache-2.0
// The 3D scene. Draws when something changed and as often as the machine keeps
// up with; the image beside it is never held back by it.
import {
  BufferAttribute,
  BufferGeometry,
  Color,
  PerspectiveCamera,
  Points,
  PointsMaterial,
  Scene,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { box3, worldFromCamera, type FrameRecord } from "../data/frame";
import type { FrameHistory } from "../data/history";
import type { Camera } from "../math/camera";
import { rotate, type Rigid, type Vec3 } from "../math/pose";
import { reducedMotion, targetToken, type Token } from "../ui/theme";
import { LiveFrustum, MapCameras, type MapCamera } from "./camera_glyphs";
import { GroundGrid } from "./ground_grid";
import type { CloudInput, CloudOutput } from "./octree.worker";
import { MoverGlyphs } from "./mover_glyphs";
import { PointCloud } from "./point_cloud";
import { Quality, softwareRendering } from "./quality";
import { Readback } from "./readback";
import { Segments } from "./segments";
import { TargetGlyph } from "./target_glyph";
import { TargetLabels } from "./target_labels";
import { trailsUpTo } from "./trails";

export type ViewMode = "orbit" | "follow" | "top";

export interface SceneLayers {
  points: boolean;
  mapCameras: boolean;
  trails: boolean;
  landmarks: boolean;
  movers: boolean;
}

export interface SceneFrame {
  readonly record: FrameRecord;
  readonly history: FrameHistory;
  readonly camera: Camera | null;
  readonly withImage: boolean;
  readonly order: readonly string[]; // of the targets: their colours
}

export interface CloudData extends CloudInput {
  cameras: readonly MapCamera[];
}

// Width of the image in the frustum.
const PICTURE_PX = 960;
const SMALL_PICTURE_PX = 256;
const FOV_DEG = 50;
// How fast the view swings to where it should be, 1/s.
const VIEW_RATE = 4;
// A view is not taken anew before so long.
const REFRAME_MS = 3000;
// A click takes the map's point that is so near; a press that moves is a drag.
const PICK_PX = 14;
const DRAG_PX = 4;

export class SceneView {
  readonly element: HTMLElement;
  layers: SceneLayers = { points: true, mapCameras: true, trails: true, landmarks: true, movers: true };
  onStats: (text: string) => void = () => undefined;
  // A point of the map that was clicked while picking; null = none was near.
  onPick: (point: Vec3 | null) => void = () => undefined;
  private picking = false;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly view = new PerspectiveCamera(FOV_DEG, 1, 0.05, 2000);
  private readonly controls: OrbitControls;
  private readonly cloud = new PointCloud();
  private readonly grid = new GroundGrid();
  private readonly frustum: LiveFrustum;
  private readonly mapCameras = new MapCameras();
  private readonly cameraTrail = new Segments(2, "#fff", 0.9);
  private readonly landmarks: Points<BufferGeometry, PointsMaterial>;
  private readonly picked: Points<BufferGeometry, PointsMaterial>;
  private readonly targets = new Map<string, TargetGlyph>();
  private readonly labels = new TargetLabels();
  private readonly movers = new MoverGlyphs();
  private readonly quality: Quality;
  private readonly readback: Readback | null;
  private readonly observer: ResizeObserver;
  private readonly worker = new Worker(new URL("./octree.worker.ts", import.meta.url), { type: "module" });
  private colors: Record<Token, string> | null = null;
  private mode: ViewMode = "orbit";
  private size = 10; // of what there is to see, map units
  private framed = false;
  private framedPose = false;
  private turned = false; // by the user, who then keeps the view
  private framedAt = 0;
  private coming: SceneFrame | null = null; // not built yet
  private pose: Rigid | null = null;
  private dirty = true;
  private lastTick = 0;
  private handle = 0;
  private width = 1;
  private height = 1;
  private clouds = 0;
  private resized = true;

  // Throws if the browser has no WebGL 2.
  constructor(image: HTMLCanvasElement) {
    const software = softwareRendering();
    this.renderer = new WebGLRenderer({ antialias: !software, powerPreference: "high-performance" });
    this.renderer.debug.checkShaderErrors = import.meta.env.DEV;
    const gl = this.renderer.getContext() as WebGL2RenderingContext;
    this.readback = software ? new Readback(gl) : null;
    this.quality = new Quality(gl, software, () => {
      if (!this.readback) return;
      this.readback.show();
      this.placeLabels();
    });
    this.element = document.createElement("div");
    this.element.className = "scene-view";
    const canvas = this.readback?.canvas ?? this.renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute(
      "aria-label",
      "3D scene: map points, cameras and targets. Drag to turn, right-drag or two fingers to shift, wheel or pinch to zoom.",
    );
    this.element.append(canvas, this.labels.element);

    this.view.up.set(0, 0, 1);
    this.view.position.set(6, -8, 6);
    this.controls = new OrbitControls(this.view, canvas);
    this.controls.enableDamping = !reducedMotion.matches;
    this.controls.dampingFactor = 0.12;
    this.controls.zoomToCursor = true;
    this.controls.maxPolarAngle = 0.495 * Math.PI;
    this.controls.addEventListener("change", () => this.change());
    this.controls.addEventListener("start", () => (this.framedPose = this.turned = true));

    this.frustum = new LiveFrustum(image, software ? SMALL_PICTURE_PX : PICTURE_PX);
    this.landmarks = new Points(
      new BufferGeometry(),
      new PointsMaterial({ size: 4, sizeAttenuation: false, depthTest: false, transparent: true, opacity: 0.9 }),
    );
    this.landmarks.frustumCulled = false;
    this.landmarks.renderOrder = 2;
    this.picked = new Points(
      new BufferGeometry(),
      new PointsMaterial({ size: 11, sizeAttenuation: false, depthTest: false, transparent: true }),
    );
    this.picked.frustumCulled = false;
    this.picked.renderOrder = 3;
    this.setPicked([]);
    this.scene.add(
      this.grid.mesh,
      this.cloud.object,
      this.mapCameras.object,
      this.frustum.object,
      this.cameraTrail.object,
      this.movers.lines.object,
      this.landmarks,
      this.picked,
    );
    this.listenForPicks(canvas);
    this.frustum.set(null, null, 1, false);
    this.worker.onmessage = (event: MessageEvent<CloudOutput & { id?: number }>) => this.showCloud(event.data);
    this.observer = new ResizeObserver(() => this.resize());
    this.observer.observe(this.element);
    this.handle = requestAnimationFrame(this.tick);
  }

  dispose(): void {
    cancelAnimationFrame(this.handle);
    this.observer.disconnect();
    this.worker.terminate();
    this.controls.dispose();
    this.clear();
    this.cloud.dispose();
    this.grid.dispose();
    this.frustum.dispose();
    this.mapCameras.dispose();
    this.cameraTrail.dispose();
    this.movers.dispose();
    this.readback?.dispose();
    this.renderer.dispose();
    this.element.remove();
  }

  setColors(colors: Record<Token, string>, dark: boolean): void {
    this.colors = colors;
    this.scene.background = new Color(colors.scene);
    this.grid.setColor(colors.grid);
    this.frustum.lines.setColor(colors.frustum);
    this.mapCameras.object.material.color.set(colors.mapcam);
    this.cameraTrail.setColor(colors.trail);
    this.landmarks.material.color.set(colors.landmark);
    this.picked.material.color.set(colors.box);
    this.cloud.setGain(dark ? 1.12 : 0.9);
    this.change();
  }

  setMode(mode: ViewMode): void {
    const before = this.mode;
    this.mode = mode;
    this.controls.enabled = mode !== "follow";
    this.controls.enableRotate = mode !== "top";
    this.controls.screenSpacePanning = true;
    if (mode === "top" && before !== "top") this.lookDown();
    if (mode === "orbit" && before !== "orbit") this.frame();
    this.change();
  }

  // While picking, clicks are told to onPick; dragging turns the view as ever.
  setPicking(on: boolean): void {
    this.picking = on;
    this.element.classList.toggle("picking", on);
  }

  // Marks places in the scene.
  setPicked(points: readonly Vec3[]): void {
    this.picked.geometry.dispose();
    this.picked.geometry = new BufferGeometry();
    this.picked.geometry.setAttribute("position", new BufferAttribute(new Float32Array(points.flat()), 3));
    this.picked.visible = points.length > 0;
    this.change();
  }

  private listenForPicks(canvas: HTMLCanvasElement): void {
    let [downX, downY] = [0, 0];
    canvas.addEventListener("pointerdown", (event) => ([downX, downY] = [event.clientX, event.clientY]));
    canvas.addEventListener("click", (event) => {
      if (!this.picking || Math.hypot(event.clientX - downX, event.clientY - downY) > DRAG_PX) return;
      const box = canvas.getBoundingClientRect();
      this.view.updateMatrixWorld();
      const at = [event.clientX - box.left, event.clientY - box.top] as const;
      this.onPick(this.cloud.nearest(this.view, box.width, box.height, at, PICK_PX));
    });
  }

  setGround(normal: Vec3, d: number): void {
    this.grid.setPlane(normal, d);
    this.change();
  }

  // A map's points and cameras; the octree is built by a worker.
  setCloud(data: CloudData | null): void {
    this.cloud.clear();
    this.framed = false;
    this.framedPose = false;
    this.turned = false;
    this.dirty = true;
    this.mapCameras.set([], 1);
    this.cameras = data?.cameras ?? [];
    if (!data) return;
    this.clouds++;
    const { positions, colors } = data;
    this.worker.postMessage({ positions, colors } satisfies CloudInput, [positions.buffer, colors.buffer]);
  }
  private cameras: readonly MapCamera[] = [];

  clear(): void {
    for (const glyph of this.targets.values()) {
      glyph.dispose();
      this.scene.remove(glyph.object);
    }
    this.targets.clear();
    this.labels.clear();
    this.cameraTrail.setPath([]);
    this.movers.set([], 1, "#fff");
    this.setLandmarks([]);
    this.frustum.set(null, null, 1, false);
    this.coming = null;
    this.pose = null;
    this.dirty = true;
  }

  // Shows a frame; trails end at it. Built when the scene is drawn next, which
  // may be less often than frames come.
  show(frame: SceneFrame): void {
    this.coming = frame;
    this.dirty = true;
  }

  private build({ record, history, camera, withImage, order }: SceneFrame): void {
    const colors = this.colors;
    if (!colors) return;
    this.pose = worldFromCamera(record);
    if (withImage) this.frustum.imageChanged();
    this.frustum.set(camera, this.pose, this.frustumDepth(record), withImage);
    const trails = trailsUpTo(record, history);
    this.cameraTrail.setPath(trails.get("") ?? []);
    this.cameraTrail.object.visible = this.layers.trails && (trails.get("")?.length ?? 0) > 1;
    const ids = new Set([...record.result.targets.map((t) => t.targetId), ...[...trails.keys()].filter((k) => k !== "")]);
    for (const [id, glyph] of this.targets) {
      if (ids.has(id)) continue;
      glyph.dispose();
      this.scene.remove(glyph.object);
      this.targets.delete(id);
      this.labels.remove(id);
    }
    for (const id of ids) {
      let glyph = this.targets.get(id);
      if (!glyph) {
        glyph = new TargetGlyph();
        for (const line of glyph.lines) line.resize(this.width, this.height);
        this.targets.set(id, glyph);
        this.scene.add(glyph.object);
      }
      const own = colors[targetToken(Math.max(0, order.indexOf(id)))];
      glyph.set(record.result.targets.find((t) => t.targetId === id), trails.get(id) ?? [], colors, own);
      glyph.trail.object.visible = this.layers.trails && (trails.get(id)?.length ?? 0) > 1;
    }
    this.movers.set(this.layers.movers ? record.result.movers : [], 0.012 * this.size, colors.mover);
    this.setLandmarks(this.layers.landmarks ? (record.result.camera?.matchXyzM ?? []) : []);
    if (!this.framedPose && this.pose && this.cloudReady()) {
      this.framedPose = true;
      if (this.mode === "orbit") this.frame();
    } else if (this.hasLeftView()) {
      this.frame();
    }
  }

  // The camera has gone out of a view that nobody has chosen.
  private hasLeftView(): boolean {
    return this.mode === "orbit" && !this.turned && this.pose !== null && this.cloudReady() &&
      performance.now() - this.framedAt > REFRAME_MS && !this.inView(this.pose.translation);
  }

  private inView(p: Vec3): boolean {
    this.view.updateMatrixWorld();
    const { x, y, z } = new Vector3(...p).project(this.view);
    return Math.abs(x) < 0.94 && Math.abs(y) < 0.9 && z < 1;
  }

  refresh(): void {
    this.cloud.object.visible = this.layers.points;
    this.mapCameras.object.visible = this.layers.mapCameras;
    this.landmarks.visible = this.layers.landmarks;
    this.change();
  }

  // Takes everything of interest into view.
  frame(): void {
    const target = this.interest();
    this.turned = false;
    this.framedAt = performance.now();
    const forward = this.pose ? rotate(this.pose.rotation, [0, 0, 1]) : ([0.6, 0.8, 0] as Vec3);
    const flat = Math.hypot(forward[0], forward[1]) || 1;
    // From behind the camera and from one side, looking down.
    const [fx, fy] = [forward[0] / flat, forward[1] / flat];
    const direction = new Vector3(-0.8 * fx + 0.45 * fy, -0.8 * fy - 0.45 * fx, 0.62).normalize();
    this.controls.target.copy(target);
    const wanted = this.wanted();
    for (let distance = 0.72 * this.size; distance < 3 * this.size; distance *= 1.15) {
      this.view.position.copy(target).addScaledVector(direction, distance);
      this.controls.update();
      if (wanted.every((p) => this.inView(p))) break;
    }
    if (this.mode === "top") this.lookDown();
    this.dirty = true;
  }

  // By the user: drawn at once.
  private change(): void {
    this.dirty = true;
    this.quality.hurry();
  }

  private cloudReady(): boolean {
    return this.framed || this.clouds === 0;
  }

  private showCloud(cloud: CloudOutput): void {
    if (--this.clouds > 0) return; // a newer one is on its way
    const bounds = cloud.bounds;
    if (bounds) {
      const extent = [0, 1, 2].map((k) => bounds.high[k]! - bounds.low[k]!) as [number, number, number];
      this.size = Math.max(1e-3, Math.hypot(extent[0], extent[1]));
      this.center.set(
        0.5 * (bounds.low[0]! + bounds.high[0]!),
        0.5 * (bounds.low[1]! + bounds.high[1]!),
        bounds.low[2]! + 0.15 * extent[2],
      );
      this.view.near = this.size / 2000;
      this.view.far = this.size * 40;
      this.view.updateProjectionMatrix();
    }
    // The mean spacing if the points covered the bounds' floor evenly.
    const count = Math.max(1, cloud.positions.length / 3);
    this.cloud.set(cloud, (0.9 * this.size) / Math.sqrt(count));
    this.mapCameras.set(this.cameras, 0.018 * this.size);
    this.framed = true;
    this.frame();
  }
  private readonly center = new Vector3();

  // The camera and the targets.
  private wanted(): Vec3[] {
    const points = this.pose ? [this.pose.translation] : [];
    for (const glyph of this.targets.values()) if (glyph.anchor) points.push(glyph.anchor);
    return points;
  }

  // Between what the camera sees and where it is.
  private interest(): Vector3 {
    if (!this.pose) return this.center.clone();
    const points = this.wanted();
    const middle = new Vector3();
    for (const p of points) middle.add(new Vector3(...p));
    return middle.divideScalar(points.length).lerp(this.center, 0.6);
  }

  private lookDown(): void {
    const target = this.interest();
    this.controls.target.copy(target);
    this.view.position.set(target.x, target.y - 1e-3 * this.size, target.z + 1.15 * this.size);
    this.controls.update();
  }

  private frustumDepth(record: FrameRecord): number {
    // Short of the nearest target, so that the image does not hide it.
    let depth = 0.12 * this.size;
    const pose = worldFromCamera(record);
    for (const t of record.result.targets) {
      const box = box3(t.boxWorld);
      if (!box || !pose) continue;
      const p = box.worldFromObject.translation;
      const range = Math.hypot(p[0] - pose.translation[0], p[1] - pose.translation[1], p[2] - pose.translation[2]);
      depth = Math.min(depth, 0.45 * range);
    }
    return depth;
  }

  private setLandmarks(xyz: readonly number[]): void {
    const geometry = this.landmarks.geometry;
    const have = geometry.getAttribute("position") as BufferAttribute | undefined;
    if (!have || have.array.length < xyz.length) {
      geometry.dispose();
      this.landmarks.geometry = new BufferGeometry();
      this.landmarks.geometry.setAttribute("position", new BufferAttribute(new Float32Array(Math.max(1536, 2 * xyz.length)), 3));
    }
    const position = this.landmarks.geometry.getAttribute("position") as BufferAttribute;
    (position.array as Float32Array).set(xyz);
    position.needsUpdate = true;
    this.landmarks.geometry.setDrawRange(0, Math.floor(xyz.length / 3));
  }

  private resize(): void {
    this.width = Math.max(1, this.element.clientWidth);
    this.height = Math.max(1, this.element.clientHeight);
    this.resized = true;
    this.change();
  }

  // Empties the canvas: only just before it is drawn again.
  private applySize(): void {
    this.resized = false;
    this.renderer.setPixelRatio(this.quality.pixelRatio);
    this.renderer.setSize(this.width, this.height, false);
    this.view.aspect = this.width / this.height;
    this.view.updateProjectionMatrix();
    for (const line of [this.cameraTrail, this.frustum.lines, this.movers.lines]) line.resize(this.width, this.height);
    for (const glyph of this.targets.values()) {
      for (const line of glyph.lines) line.resize(this.width, this.height);
    }
  }

  private readonly tick = (now: number): void => {
    this.handle = requestAnimationFrame(this.tick);
    const dt = Math.min(0.1, (now - this.lastTick) / 1000);
    if (document.hidden || !this.quality.mayDraw(now)) return;
    this.lastTick = now;
    if (this.coming) {
      const frame = this.coming;
      this.coming = null;
      this.build(frame);
    }
    if (this.mode === "follow" && this.pose) this.follow(this.pose, dt);
    else if (this.controls.enabled) this.controls.update();
    if (!this.dirty) return;
    this.dirty = false;
    if (this.quality.adapt() || this.resized) this.applySize();
    this.frustum.beforeDrawing();
    const distance = this.view.position.distanceTo(this.controls.target);
    this.grid.update(this.controls.target, Math.max(distance, 0.2 * this.size));
    this.cloud.budget = this.quality.pointBudget;
    this.view.updateMatrixWorld();
    this.cloud.update(this.view, this.height, this.quality.pixelRatio);
    this.renderer.render(this.scene, this.view);
    if (this.readback) this.readback.fetch();
    else this.placeLabels();
    this.quality.drawn(now);
    this.onStats(
      this.cloud.total > 0
        ? `${compact(this.cloud.drawn)} of ${compact(this.cloud.total)} points · grid ${formatStep(this.grid.step)}`
        : `grid ${formatStep(this.grid.step)}`,
    );
  };

  private placeLabels(): void {
    this.labels.place(this.targets, this.view, this.width, this.height);
  }

  // Behind and above the camera, looking where it looks.
  private follow(pose: Rigid, dt: number): void {
    const forward = rotate(pose.rotation, [0, 0, 1]);
    const c = new Vector3(...pose.translation);
    const f = new Vector3(...forward);
    const position = c.clone().addScaledVector(f, -0.16 * this.size).add(new Vector3(0, 0, 0.07 * this.size));
    const target = c.clone().addScaledVector(f, 0.3 * this.size);
    const share = reducedMotion.matches ? 1 : 1 - Math.exp(-VIEW_RATE * dt);
    if (this.view.position.distanceTo(position) > 1e-4 * this.size) {
      this.view.position.lerp(position, share);
      this.controls.target.lerp(target, share);
      this.dirty = true;
    }
    this.view.lookAt(this.controls.target);
  }
}

function compact(n: number): string {
  return n >= 1e6 ? `${(n / 1e6).toFixed(2)} M` : n >= 1e4 ? `${Math.round(n / 1e3)} k` : String(n);
}

function formatStep(step: number): string {
  return step >= 1000 ? `${step / 1000} km` : step >= 1 ? `${step} m` : `${Math.round(step * 100)} cm`;
}
