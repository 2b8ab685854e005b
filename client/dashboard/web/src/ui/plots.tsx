// SPDX-License-Identifier: Apache-2.0
// The grid of plots. All share the timeline's span, cursor and hover.
import type { JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { effect, signal } from "@preact/signals";
import type { App } from "../app/app";
import { drawPlot, plotTime } from "../plots/draw_plot";
import { indexAtTime, plotData, PLOTS, type PlotData, type PlotId } from "../plots/series";
import { palette } from "./theme";

// Plots need not follow every frame.
const REDRAW_MS = 250;
// Of the time, drawing one takes no more than one part in so many.
const DRAWING_SHARE = 50;

function fit(canvas: HTMLCanvasElement): CanvasRenderingContext2D | null {
  const { clientWidth: w, clientHeight: h } = canvas;
  if (w === 0 || h === 0) return null;
  const ratio = window.devicePixelRatio || 1;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const c = canvas.getContext("2d");
  c?.setTransform(ratio, 0, 0, ratio, 0, 0);
  return c;
}

// Calls draw when anything it reads changes, at most every so many ms and less
// often where drawing is slow; at once for what the user does.
export function useThrottledEffect(app: App, read: () => boolean, draw: () => void, ms: number): void {
  useEffect(() => {
    let last = -Infinity;
    let cost = 0;
    let callOff: (() => void) | undefined;
    const run = () => {
      last = performance.now();
      callOff = undefined;
      draw();
      cost += 0.2 * (performance.now() - last - cost);
    };
    const stop = effect(() => {
      const urgent = read();
      const wait = last + Math.max(ms, DRAWING_SHARE * cost) - performance.now();
      if (urgent || last === -Infinity) {
        callOff?.();
        run();
      } else {
        callOff ??= app.beat.after(Math.max(0, wait), run);
      }
    });
    return () => {
      stop();
      callOff?.();
    };
  }, []);
}

export function valuesAt(data: PlotData, t: number): string {
  const i = indexAtTime(data.times, t + 1e-6);
  if (i < 0) return "";
  return data.lines
    .map((line) => {
      const v = line.values[i]!;
      return `${line.name} ${Number.isFinite(v) ? v.toFixed(line.digits) : "none"}${line.unit ? ` ${line.unit}` : ""}`;
    })
    .join(", ");
}

function Plot({ app, id, title }: { app: App; id: PlotId; title: string }): JSX.Element {
  const canvas = useRef<HTMLCanvasElement>(null);
  const legend = useRef<HTMLSpanElement>(null);
  const { player } = app.model;
  const size = useRef(signal(0)).current;

  useEffect(() => {
    const observer = new ResizeObserver(() => size.value++);
    observer.observe(canvas.current!);
    return () => observer.disconnect();
  }, []);

  const draw = () => {
    const element = canvas.current;
    const c = element && fit(element);
    if (!element || !c) return;
    const { from, to } = app.time.range.peek();
    const data = plotData(id, player.history, from, to, app.targetOrder.peek());
    const cursor = player.cursor.peek();
    const hover = app.time.hover.peek();
    const colors = palette.peek() as Record<string, string>;
    drawPlot(c, data, {
      width: element.clientWidth,
      height: element.clientHeight,
      from, to, cursor, hover,
      color: (token) => colors[token] ?? "#888",
    });
    const at = hover ?? cursor ?? to;
    const i = indexAtTime(data.times, at + 1e-6);
    legend.current!.replaceChildren(
      ...data.lines.map((line) => {
        const item = document.createElement("span");
        const swatch = document.createElement("i");
        swatch.style.background = colors[line.token] ?? "#888";
        const v = i >= 0 ? line.values[i]! : NaN;
        // Large numbers without decimals, that all find room.
        const digits = Math.abs(v) < 10 ? line.digits : Math.max(0, line.digits - 1);
        const text = Number.isFinite(v) ? `${v.toFixed(digits)}${line.unit ? ` ${line.unit}` : ""}` : "–";
        const value = document.createElement("b");
        value.textContent = text;
        item.append(swatch, data.lines.length > 1 || id === "confidence" ? `${line.name} ` : "", value);
        return item;
      }),
    );
    element.setAttribute("aria-label", `${title}: ${valuesAt(data, at) || "no data"}`);
  };

  useThrottledEffect(
    app,
    () => {
      const moved = player.cursor.value !== null || app.time.hover.value !== null;
      app.time.range.value;
      app.targetOrder.value;
      palette.value;
      size.value;
      return moved;
    },
    draw,
    REDRAW_MS,
  );

  const timeAt = (event: PointerEvent) => {
    const element = canvas.current!;
    const { from, to } = app.time.range.peek();
    const x = event.clientX - element.getBoundingClientRect().left;
    return Math.min(to, Math.max(from, plotTime({ width: element.clientWidth, from, to }, x)));
  };
  return (
    <figure class="plot">
      <figcaption>
        <span class="plot-title">{title}</span>
        <span class="plot-legend" ref={legend} />
      </figcaption>
      <canvas
        ref={canvas}
        role="img"
        aria-label={title}
        onPointerMove={(e) => (app.time.hover.value = timeAt(e))}
        onPointerLeave={() => (app.time.hover.value = null)}
        onPointerDown={(e) => app.jump(timeAt(e))}
      />
    </figure>
  );
}

export function Plots({ app }: { app: App }): JSX.Element {
  return (
    <section class="plots" aria-label="Plots over time">
      {PLOTS.map((p) => (
        <Plot key={p.id} app={app} id={p.id} title={p.title} />
      ))}
    </section>
  );
}
