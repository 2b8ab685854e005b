// SPDX-License-Identifier: Apache-2.0
// What is drawn over the image: landmarks, boxes in 2D and 3D, confidence and
// state in words. In image pixels; `toView` takes them to the canvas.
import {
  box3, cameraState, CameraState, TargetState, worldFromCamera, type FrameRecord, type Mover, type TargetResult,
} from "../data/frame";
import { speedOf } from "../data/movers";
import { targetWords } from "../data/timeline";
import type { Camera } from "../math/camera";
import { projectBox } from "../math/box3";
import type { Rigid, Vec2 } from "../math/pose";
import type { Token } from "../ui/theme";

export interface OverlayOptions {
  landmarks: boolean;
  boxes2d: boolean;
  boxes3d: boolean;
  movers: boolean;
}

export interface OverlayInput {
  readonly record: FrameRecord;
  readonly camera: Camera | null;
  readonly colors: Record<Token, string>;
  readonly options: OverlayOptions;
  readonly toView: (p: Vec2) => Vec2;
  readonly selected: string | null;
}

const FONT = '600 11px "Inter", system-ui, sans-serif';

export function drawOverlay(c: CanvasRenderingContext2D, input: OverlayInput): void {
  const { record, camera, options } = input;
  c.lineJoin = "round";
  if (options.landmarks) drawLandmarks(c, input);
  if (options.movers) for (const mover of record.result.movers) drawMover(c, input, mover);
  const pose = worldFromCamera(record);
  for (const target of record.result.targets) {
    // A held or lost pose is still the best there is; its boxes are drawn.
    if (options.boxes3d && camera && pose) drawBox3(c, input, target, camera, pose);
    if (options.boxes2d) drawBox2(c, input, target);
  }
}

function drawLandmarks(c: CanvasRenderingContext2D, { record, colors, toView }: OverlayInput): void {
  const xy = record.result.camera?.matchXyPx;
  if (!xy || xy.length === 0) return;
  c.fillStyle = colors.landmark;
  c.strokeStyle = "rgba(10, 6, 20, 0.55)";
  c.lineWidth = 1;
  c.beginPath();
  for (let i = 0; i + 1 < xy.length; i += 2) {
    const [x, y] = toView([xy[i]!, xy[i + 1]!]);
    c.moveTo(x + 2.2, y);
    c.arc(x, y, 2.2, 0, 2 * Math.PI);
  }
  c.fill();
  c.stroke();
}

function path(c: CanvasRenderingContext2D, points: readonly Vec2[], close: boolean): void {
  c.beginPath();
  points.forEach(([x, y], i) => (i === 0 ? c.moveTo(x, y) : c.lineTo(x, y)));
  if (close) c.closePath();
}

function drawBox3(
  c: CanvasRenderingContext2D,
  { colors, toView }: OverlayInput,
  target: TargetResult,
  camera: Camera,
  pose: Rigid,
): void {
  const box = box3(target.boxWorld);
  if (!box) return;
  const projected = projectBox(camera, pose, box);
  const seen = target.state === TargetState.TRACKED;
  c.save();
  c.globalAlpha = target.state === TargetState.LOST ? 0.35 : 1;
  if (projected.front) {
    path(c, projected.front.map(toView), true);
    c.globalAlpha *= seen ? 0.3 : 0.14;
    c.fillStyle = colors.front;
    c.fill();
    c.globalAlpha = target.state === TargetState.LOST ? 0.35 : 1;
  }
  c.setLineDash(seen ? [] : [6, 5]);
  c.lineWidth = 1.75;
  c.strokeStyle = seen ? colors.box : colors.ghost;
  c.beginPath();
  for (const [a, b] of projected.edges) {
    const [ax, ay] = toView(a);
    const [bx, by] = toView(b);
    c.moveTo(ax, ay);
    c.lineTo(bx, by);
  }
  c.stroke();
  if (projected.front) {
    path(c, projected.front.map(toView), true);
    c.strokeStyle = colors.front;
    c.lineWidth = 2;
    c.stroke();
  }
  c.setLineDash([]);
  if (projected.center) {
    const [x, y] = toView(projected.center);
    c.beginPath();
    c.arc(x, y, 3.5, 0, 2 * Math.PI);
    c.fillStyle = colors.front;
    c.fill();
    c.lineWidth = 1.25;
    c.strokeStyle = "rgba(0, 0, 0, 0.6)";
    c.stroke();
  }
  c.restore();
}

function drawBox2(c: CanvasRenderingContext2D, input: OverlayInput, target: TargetResult): void {
  const { colors, toView, selected } = input;
  const box = target.box;
  if (!box) return;
  const corners = (
    [[0, 0], [1, 0], [1, 1], [0, 1]] as const
  ).map(([u, v]) => toView([box.x + u * box.width, box.y + v * box.height]));
  const seen = target.state === TargetState.TRACKED;
  c.save();
  c.globalAlpha = target.state === TargetState.LOST ? 0.5 : 1;
  path(c, corners, true);
  c.lineWidth = 3.5;
  c.strokeStyle = "rgba(0, 0, 0, 0.35)";
  c.setLineDash(seen ? [] : [5, 4]);
  c.stroke();
  c.lineWidth = target.targetId === selected ? 2.5 : 1.5;
  c.strokeStyle = seen ? "#ffffff" : colors.ghost;
  c.stroke();
  c.setLineDash([]);

  // The confidence along the lower edge.
  const [, , [rx, ry], [lx, ly]] = corners as [Vec2, Vec2, Vec2, Vec2];
  const share = Math.min(1, Math.max(0, target.confidence));
  c.lineCap = "butt";
  c.lineWidth = 5;
  c.strokeStyle = "rgba(0, 0, 0, 0.5)";
  c.beginPath();
  c.moveTo(lx, ly + 5);
  c.lineTo(rx, ry + 5);
  c.stroke();
  c.strokeStyle = colors.confidence;
  c.beginPath();
  c.moveTo(lx, ly + 5);
  c.lineTo(lx + share * (rx - lx), ly + 5 + share * (ry - ly));
  c.stroke();
  c.restore();

  const top = corners.reduce((a, b) => (b[1] < a[1] ? b : a));
  const left = Math.min(...corners.map((p) => p[0]));
  drawLabel(c, left, top[1] - 6, `${target.targetId} · ${targetWords(target.state, target.ageS)}`, seen ? colors.good : target.state === TargetState.LOST ? colors.bad : colors.warn);
}

// Thin and dashed: a suggestion, not a target.
function drawMover(c: CanvasRenderingContext2D, { colors, toView }: OverlayInput, mover: Mover): void {
  const box = mover.box;
  if (!box) return;
  const corners = (
    [[0, 0], [1, 0], [1, 1], [0, 1]] as const
  ).map(([u, v]) => toView([box.x + u * box.width, box.y + v * box.height]));
  c.save();
  path(c, corners, true);
  c.lineWidth = 3;
  c.strokeStyle = "rgba(0, 0, 0, 0.4)";
  c.stroke();
  c.setLineDash([4, 3]);
  c.lineWidth = 1.25;
  c.strokeStyle = colors.mover;
  c.stroke();
  c.restore();
  const top = Math.min(...corners.map((p) => p[1]));
  const left = Math.min(...corners.map((p) => p[0]));
  drawLabel(c, left, top - 4, `${speedOf(mover).toFixed(1)} m/s`, colors.mover);
}

// A pill whose lower left corner is at (x, y), kept inside the canvas.
export function drawLabel(c: CanvasRenderingContext2D, x: number, y: number, text: string, color: string): void {
  c.save();
  c.font = FONT;
  const width = c.measureText(text).width + 22;
  const view = c.getTransform().a || 1;
  const left = Math.max(2, Math.min(x, c.canvas.width / view - width - 2));
  const top = Math.max(2, y - 18);
  c.fillStyle = "rgba(12, 15, 20, 0.78)";
  c.beginPath();
  c.roundRect(left, top, width, 18, 9);
  c.fill();
  c.fillStyle = color;
  c.beginPath();
  c.arc(left + 9, top + 9, 3.2, 0, 2 * Math.PI);
  c.fill();
  c.fillStyle = "#f2f5f9";
  c.textBaseline = "middle";
  c.fillText(text, left + 16, top + 9.5);
  c.restore();
}

export function cameraIsUncertain(record: FrameRecord): boolean {
  const state = cameraState(record);
  return state === CameraState.HELD || state === CameraState.LOST;
}
