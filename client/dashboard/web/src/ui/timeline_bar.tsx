// SPDX-License-Identifier: Apache-2.0
// The timeline: lanes coloured by the states of the camera and the targets,
// with the cursor. A slider to the keyboard and to screen readers.
import type { JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { signal } from "@preact/signals";
import type { App } from "../app/app";
import type { Span } from "../app/time_range";
import { buildLanes, cameraWords, clock, tickStep } from "../data/timeline";
import { cameraState } from "../data/frame";
import { IconButton, Segmented } from "./controls";
import { useReadout } from "./readout";
import { palette } from "./theme";
import { useThrottledEffect } from "./plots";

const LABEL_WIDTH = 74;
const LANE_HEIGHT = 12;
const LANE_GAP = 4;
const AXIS_HEIGHT = 16;
const MAX_LANES = 6;
const RATES = [0.25, 0.5, 1, 2, 4] as const;
const REDRAW_MS = 200;

export function TimelineBar({ app }: { app: App }): JSX.Element {
  const canvas = useRef<HTMLCanvasElement>(null);
  const { player } = app.model;
  const size = useRef(signal(0)).current;
  const lanes = Math.min(MAX_LANES, 1 + app.targetOrder.value.length);
  const height = lanes * (LANE_HEIGHT + LANE_GAP) + AXIS_HEIGHT;

  useEffect(() => {
    const observer = new ResizeObserver(() => size.value++);
    observer.observe(canvas.current!);
    return () => observer.disconnect();
  }, []);

  const span = () => {
    const { from, to } = app.time.range.peek();
    const width = Math.max(1, (canvas.current?.clientWidth ?? 1) - LABEL_WIDTH - 4);
    return { from, to, width };
  };
  const draw = () => {
    const element = canvas.current;
    if (!element || element.clientWidth === 0) return;
    const ratio = window.devicePixelRatio || 1;
    element.width = Math.round(element.clientWidth * ratio);
    element.height = Math.round(element.clientHeight * ratio);
    const c = element.getContext("2d")!;
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    const colors = palette.peek() as Record<string, string>;
    const { from, to, width } = span();
    const x = (t: number) => LABEL_WIDTH + ((t - from) / (to - from)) * width;
    const start = player.history.first?.timeS ?? 0;
    c.font = '11px "Inter", system-ui, sans-serif';
    c.textBaseline = "middle";
    const order = app.targetOrder.peek();
    const built = buildLanes(player.history, from, to);
    ["", ...order].slice(0, MAX_LANES).forEach((id, row) => {
      const y = row * (LANE_HEIGHT + LANE_GAP) + 2;
      c.fillStyle = colors.muted!;
      c.fillText(shorten(c, id === "" ? "camera" : id, LABEL_WIDTH - 10), 2, y + LANE_HEIGHT / 2 + 0.5);
      c.fillStyle = colors.raised!;
      c.fillRect(LABEL_WIDTH, y, width, LANE_HEIGHT);
      c.save();
      c.beginPath();
      c.rect(LABEL_WIDTH, y, width, LANE_HEIGHT);
      c.clip();
      for (const run of built.find((l) => l.id === id)?.runs ?? []) {
        c.fillStyle = colors[run.tone]!;
        c.globalAlpha = run.tone === "good" ? 0.75 : 0.95;
        c.fillRect(x(run.fromS), y, Math.max(1, x(run.toS) - x(run.fromS)), LANE_HEIGHT);
      }
      c.restore();
    });
    const base = lanesHeight();
    const step = tickStep(to - from, width / 90);
    c.fillStyle = colors.faint!;
    c.strokeStyle = colors.line!;
    c.textAlign = "center";
    for (let t = Math.ceil((from - start) / step) * step; t <= to - start; t += step) {
      const at = x(t + start);
      if (t < 0 || at < LABEL_WIDTH) continue;
      c.beginPath();
      c.moveTo(Math.round(at) + 0.5, base);
      c.lineTo(Math.round(at) + 0.5, base + 3);
      c.stroke();
      c.fillText(step < 1 ? t.toFixed(1) : clock(t), Math.min(at, element.clientWidth - 16), base + 9);
    }
    const cursor = player.cursor.peek() ?? player.history.last?.timeS ?? null;
    for (const [t, color, w] of [
      [app.time.hover.peek(), colors.faint!, 1],
      [cursor, colors.accent!, 2],
    ] as const) {
      if (t === null || t < from || t > to + 1e-3) continue;
      const at = Math.min(x(t), element.clientWidth - 1);
      c.fillStyle = color;
      c.fillRect(at - w / 2, 0, w, base);
      if (w === 2) {
        c.beginPath();
        c.moveTo(at - 5, 0);
        c.lineTo(at + 5, 0);
        c.lineTo(at, 7);
        c.fill();
      }
    }
    function lanesHeight() {
      return Math.min(MAX_LANES, 1 + order.length) * (LANE_HEIGHT + LANE_GAP);
    }
  };
  useThrottledEffect(
    app,
    () => {
      app.time.range.value;
      app.targetOrder.value;
      palette.value;
      size.value;
      return player.cursor.value !== null || app.time.hover.value !== null;
    },
    draw,
    REDRAW_MS,
  );

  const timeAt = (event: { clientX: number }) => {
    const { from, to, width } = span();
    const left = canvas.current!.getBoundingClientRect().left + LABEL_WIDTH;
    return from + (Math.min(1, Math.max(0, (event.clientX - left) / width))) * (to - from);
  };
  const onWheel = (event: WheelEvent) => {
    event.preventDefault();
    app.time.zoom(Math.exp(event.deltaY * 0.0015), timeAt(event));
  };
  useEffect(() => {
    const element = canvas.current!;
    element.addEventListener("wheel", onWheel, { passive: false });
    return () => element.removeEventListener("wheel", onWheel);
  }, []);

  const cursor = player.cursor.value;
  const live = player.isLive && cursor === null;
  const first = player.history.first?.timeS ?? 0;
  const current = useReadout(app);
  const now = current ? current.timeS - first : 0;
  const total = Math.max(0, (player.history.last?.timeS ?? first) - first);
  return (
    <section class="timeline" aria-label="Timeline">
      <div class="transport" role="group" aria-label="Playback">
        <IconButton icon="back" label="One frame back" shortcut="←" onClick={() => app.step(-1)} />
        <IconButton
          icon={live || player.playing.value ? "pause" : "play"}
          label={live ? "Stand still" : player.playing.value ? "Pause" : "Play"}
          shortcut="space"
          filled={!live && !player.playing.value}
          onClick={() => app.togglePlay()}
        />
        <IconButton icon="forward" label="One frame on" shortcut="→" onClick={() => app.step(1)} />
        {player.isLive ? (
          <button type="button" class="live-button" aria-pressed={live} title="Follow what comes in (L)" onClick={() => app.goLive()}>
            Live
          </button>
        ) : (
          <select
            aria-label="Speed"
            class="rate"
            value={player.rate.value}
            onChange={(e) => player.setRate(Number(e.currentTarget.value))}
          >
            {RATES.map((r) => (
              <option key={r} value={r}>{`${r}×`}</option>
            ))}
          </select>
        )}
        <span class="clock" aria-label="Time">
          {clock(now)}
          <small>.{Math.floor((now % 1) * 10)}</small>
          <span class="clock-total"> / {clock(total)}</span>
        </span>
      </div>
      <canvas
        ref={canvas}
        class="timeline-canvas"
        style={{ height: `${height}px` }}
        role="slider"
        tabIndex={0}
        aria-label="Position in time"
        aria-valuemin={0}
        aria-valuemax={Math.round(total * 10) / 10}
        aria-valuenow={Math.round(now * 10) / 10}
        aria-valuetext={`${clock(now)} of ${clock(total)}${live ? ", live" : ""}${current ? `, camera ${cameraWords(cameraState(current))}` : ""}`}
        onPointerDown={(e) => {
          e.currentTarget.setPointerCapture(e.pointerId);
          app.jump(timeAt(e));
        }}
        onPointerMove={(e) => {
          if (e.currentTarget.hasPointerCapture(e.pointerId)) app.jump(timeAt(e));
          else app.time.hover.value = timeAt(e);
        }}
        onPointerLeave={() => (app.time.hover.value = null)}
      />
      <Segmented<string>
        label="Span"
        value={String(app.time.span.value)}
        options={[
          { value: "30", label: "30 s" },
          { value: "60", label: "1 min" },
          { value: "300", label: "5 min" },
          { value: "all", label: "All" },
        ]}
        onChange={(v) => app.time.setSpan((v === "all" ? "all" : Number(v)) as Span)}
      />
    </section>
  );
}

function shorten(c: CanvasRenderingContext2D, text: string, width: number): string {
  if (c.measureText(text).width <= width) return text;
  let short = text;
  while (short.length > 1 && c.measureText(`${short}…`).width > width) short = short.slice(0, -1);
  return `${short}…`;
}
