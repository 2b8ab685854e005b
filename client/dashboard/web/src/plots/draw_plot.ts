// SPDX-License-Identifier: Apache-2.0
// Draws one plot. Where frames are closer than pixels, a column shows the span
// of their values.
import { tickStep } from "../data/timeline";
import { niceTop, type Line, type PlotData } from "./series";

export interface PlotFrame {
  readonly width: number;
  readonly height: number;
  readonly from: number;
  readonly to: number;
  readonly cursor: number | null;
  readonly hover: number | null;
  readonly color: (token: string) => string;
}

const LEFT = 30;
const RIGHT = 4;
const TOP = 5;
const BOTTOM = 4;

export function plotX(f: Pick<PlotFrame, "width" | "from" | "to">, t: number): number {
  return LEFT + ((t - f.from) / (f.to - f.from)) * (f.width - LEFT - RIGHT);
}

export function plotTime(f: Pick<PlotFrame, "width" | "from" | "to">, x: number): number {
  return f.from + ((x - LEFT) / (f.width - LEFT - RIGHT)) * (f.to - f.from);
}

// Spikes above the 98th percentile by more than this are cut off.
const HEADROOM = 1.5;
const PERCENTILE = 0.98;

function top98(values: number[]): number {
  if (values.length === 0) return 0;
  values.sort((a, b) => a - b);
  const usual = values[Math.floor(PERCENTILE * (values.length - 1))]!;
  return Math.min(values[values.length - 1]!, usual > 0 ? HEADROOM * usual : Infinity);
}

function stackTop(data: PlotData): number {
  const sums: number[] = [];
  for (let i = 0; i < data.times.length; ++i) {
    let sum = 0;
    for (const line of data.lines) {
      const v = line.values[i]!;
      if (Number.isFinite(v)) sum += v;
    }
    sums.push(sum);
  }
  return top98(sums);
}

function lineTop(data: PlotData): number {
  return Math.max(0, ...data.lines.map((l) => top98([...l.values].filter(Number.isFinite))));
}

export function drawPlot(c: CanvasRenderingContext2D, data: PlotData, f: PlotFrame): void {
  const { width, height, color } = f;
  c.clearRect(0, 0, width, height);
  const top = data.top ?? niceTop(data.stacked ? stackTop(data) : lineTop(data));
  const y = (v: number) => height - BOTTOM - (v / top) * (height - TOP - BOTTOM);

  c.font = '10px "Inter", system-ui, sans-serif';
  c.textAlign = "right";
  c.textBaseline = "middle";
  c.lineWidth = 1;
  for (const share of [0, 0.5, 1]) {
    const at = Math.round(y(share * top)) + 0.5;
    c.strokeStyle = color("line");
    c.beginPath();
    c.moveTo(LEFT, at);
    c.lineTo(width - RIGHT, at);
    c.stroke();
    if (share > 0) {
      c.fillStyle = color("faint");
      c.fillText(axisLabel(share * top), LEFT - 5, Math.max(at, 6));
    }
  }
  const step = tickStep(f.to - f.from, Math.max(2, width / 90));
  c.strokeStyle = color("line");
  for (let t = Math.ceil(f.from / step) * step; t <= f.to; t += step) {
    const x = Math.round(plotX(f, t)) + 0.5;
    c.beginPath();
    c.moveTo(x, TOP);
    c.lineTo(x, height - BOTTOM);
    c.stroke();
  }

  c.save();
  c.beginPath();
  c.rect(LEFT, 0, width - LEFT - RIGHT, height);
  c.clip();
  if (data.mark !== null) {
    c.setLineDash([3, 3]);
    c.strokeStyle = color("faint");
    c.beginPath();
    c.moveTo(LEFT, y(data.mark));
    c.lineTo(width, y(data.mark));
    c.stroke();
    c.setLineDash([]);
  }
  if (data.stacked) drawStack(c, data, f, y);
  else if (data.bars) drawBars(c, data, f, y);
  else for (const line of data.lines) drawLine(c, data.times, line, f, y);
  c.restore();

  for (const [t, token] of [[f.hover, "faint"], [f.cursor, "accent"]] as const) {
    if (t === null || t < f.from || t > f.to) continue;
    const x = Math.round(plotX(f, t)) + 0.5;
    c.strokeStyle = color(token);
    c.lineWidth = token === "accent" ? 1.5 : 1;
    c.beginPath();
    c.moveTo(x, 0);
    c.lineTo(x, height);
    c.stroke();
  }
}

function axisLabel(v: number): string {
  return v >= 1000 ? `${v / 1000}k` : v >= 10 ? v.toFixed(0) : String(Number(v.toPrecision(2)));
}

function drawLine(c: CanvasRenderingContext2D, times: Float64Array, line: Line, f: PlotFrame, y: (v: number) => number): void {
  c.strokeStyle = f.color(line.token);
  c.lineWidth = 1.5;
  c.lineJoin = "round";
  c.beginPath();
  let pen = false;
  let column = -1;
  let low = 0;
  let high = 0;
  const flush = () => {
    // The span of a column that held several frames.
    if (high - low > 1) {
      c.moveTo(column, low);
      c.lineTo(column, high);
    }
  };
  for (let i = 0; i < times.length; ++i) {
    const v = line.values[i]!;
    const gap = i > 0 && times[i]! - times[i - 1]! > 1;
    if (!Number.isFinite(v)) {
      pen = false;
      continue;
    }
    const x = plotX(f, times[i]!);
    const at = y(v);
    if (pen && !gap && Math.round(x) === column) {
      low = Math.min(low, at);
      high = Math.max(high, at);
      continue;
    }
    if (pen) flush();
    if (pen && !gap) c.lineTo(x, at);
    else c.moveTo(x, at);
    pen = true;
    column = Math.round(x);
    low = high = at;
    c.moveTo(x, at);
  }
  if (pen) flush();
  c.stroke();
}

function drawStack(c: CanvasRenderingContext2D, data: PlotData, f: PlotFrame, y: (v: number) => number): void {
  const below = new Float64Array(data.times.length);
  for (const line of data.lines) {
    c.fillStyle = f.color(line.token);
    c.beginPath();
    for (let i = 0; i < data.times.length; ++i) c.lineTo(plotX(f, data.times[i]!), y(below[i]!));
    for (let i = data.times.length - 1; i >= 0; --i) {
      const v = line.values[i]!;
      if (Number.isFinite(v)) below[i]! += v;
      c.lineTo(plotX(f, data.times[i]!), y(below[i]!));
    }
    c.closePath();
    c.globalAlpha = 0.75;
    c.fill();
    c.globalAlpha = 1;
  }
}

function drawBars(c: CanvasRenderingContext2D, data: PlotData, f: PlotFrame, y: (v: number) => number): void {
  for (const line of data.lines) {
    c.fillStyle = f.color(line.token);
    for (let i = 0; i < data.times.length; ++i) {
      const v = line.values[i]!;
      if (v > 0) c.fillRect(plotX(f, data.times[i]!) - 1, y(v), 2, y(0) - y(v));
    }
  }
}
