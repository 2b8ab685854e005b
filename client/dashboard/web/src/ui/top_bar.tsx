// SPDX-License-Identifier: Apache-2.0
// The bar at the top: what is being looked at, how it fares, and what can be
// done.
import type { JSX } from "preact";
import { useEffect } from "preact/hooks";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import { cameraState } from "../data/frame";
import { cameraTone, cameraWords, lensWords } from "../data/timeline";
import { SourceRun_State } from "../gen/groundlock/dashboard/v1/dashboard_pb";
import { Dot, IconButton } from "./controls";
import { Icon } from "./icons";
import { chooseTheme, theme } from "./theme";

function Chips({ app }: { app: App }): JSX.Element | null {
  const { model } = app;
  // Numbers that change with every frame are read out twice a second.
  const tick = useSignal(0);
  useEffect(() => {
    const timer = setInterval(() => tick.value++, 500);
    return () => clearInterval(timer);
  }, []);
  tick.value;
  const record = model.player.current.peek();
  if (!record) return null;
  const state = cameraState(record);
  const lens = lensWords(record.result.camera?.lensContradiction);
  const now = performance.now();
  const latency = app.latency.median.value;
  const dropped = Number(model.entry.value?.session?.framesDropped ?? 0);
  return (
    <div class="chips" role="status" aria-label="State" aria-live="off">
      <span class="chip" data-tone={cameraTone(state)}>
        <Dot tone={cameraTone(state)} /> camera {cameraWords(state)}
      </span>
      {lens ? (
        <span class="chip" data-tone="warn" title="In this map the frames show another lens than the session's: poses and boxes are off">
          <Dot tone="warn" /> {lens}
        </span>
      ) : null}
      <span class="chip plain"><b>{model.player.shownRate.perSecond(now).toFixed(0)}</b> images/s</span>
      {latency !== null && app.live.value ? (
        <span class="chip plain" title={app.latency.fromCapture.value ? "From capture to this page, median" : "From the dashboard to this page, median"}>
          <b>{latency.toFixed(0)}</b> ms{app.latency.fromCapture.value ? "" : " here"}
        </span>
      ) : null}
      {dropped > 0 ? <span class="chip plain"><b>{dropped}</b> dropped</span> : null}
    </div>
  );
}

function SourceControl({ app }: { app: App }): JSX.Element | null {
  const { model } = app;
  const run = model.entry.value?.sourceRun;
  const id = model.view.value?.id;
  if (!run || !id) return null;
  const control = (action: number, what: string) =>
    void model.attempt(what, () =>
      model.connection.request("done", { case: "controlSource", value: { sessionId: id, action } }),
    );
  const playing = run.state === SourceRun_State.PLAYING;
  if (playing) return <IconButton icon="pause" label="Pause the source" onClick={() => control(2, "The source cannot be paused")} />;
  if (run.state === SourceRun_State.PAUSED) {
    return (
      <>
        <IconButton icon="play" label="Let the source run" filled onClick={() => control(1, "The source cannot go on")} />
        <IconButton icon="forward" label="One frame of the source" onClick={() => control(4, "The source cannot step")} />
      </>
    );
  }
  return <span class="chip plain">{run.state === SourceRun_State.FAILED ? `source failed: ${run.message}` : "source ended"}</span>;
}

export function TopBar({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const view = model.view.value;
  const recording = model.entry.value?.recording;
  const live = view?.kind === "live";
  return (
    <header class="top-bar">
      <a class="brand" href="#/" aria-label="Groundlock, start page">
        <svg viewBox="0 0 32 32" width="24" height="24" aria-hidden="true">
          <g fill="none" stroke-linecap="round" stroke-linejoin="round" stroke-width="2.4">
            <path d="M4 10V6a2 2 0 0 1 2-2h4M22 4h4a2 2 0 0 1 2 2v4M28 22v4a2 2 0 0 1-2 2h-4M10 28H6a2 2 0 0 1-2-2v-4" stroke="var(--muted)" />
            <path d="M9.500 19.500 16 23l6.500-3.500v-7L16 9l-6.500 3.500z" stroke="var(--frustum)" />
            <path d="M16 23v-7l6.500-3.500M16 16l-6.500-3.500" stroke="var(--good)" />
          </g>
        </svg>
        <span class="brand-name">Groundlock</span>
      </a>
      <button type="button" class="picker" onClick={() => (app.dialog.value = "sessions")} aria-haspopup="dialog" title="Sessions and recordings (S)">
        <Icon name={view?.kind === "replay" ? "film" : "list"} />
        <span class="picker-name">{view ? view.id : "Choose a session"}</span>
        {view?.kind === "replay" ? <span class="badge">replay</span> : null}
        {model.session.value?.mapName ? <span class="picker-map">{model.session.value.mapName}</span> : null}
      </button>
      <Chips app={app} />
      <div class="spacer" />
      <SourceControl app={app} />
      {live ? (
        <IconButton
          icon="record"
          label={recording ? "End the recording" : "Record"}
          shortcut="R"
          pressed={!!recording}
          filled={!!recording}
          tone="bad"
          disabled={model.hello.value ? !model.hello.value.recordingsEnabled : true}
          onClick={() => void model.toggleRecording()}
        />
      ) : null}
      {view ? <IconButton icon="export" label="Export trajectories" shortcut="E" onClick={() => (app.dialog.value = "export")} /> : null}
      <IconButton icon="map" label="Maps" shortcut="P" onClick={() => (app.dialog.value = "maps")} />
      <IconButton icon="plus" label="New session" shortcut="N" onClick={() => (app.dialog.value = "start")} />
      <span class="divider" />
      <IconButton
        icon={theme.value === "dark" ? "sun" : "moon"}
        label={theme.value === "dark" ? "Light colours" : "Dark colours"}
        shortcut="T"
        onClick={() => chooseTheme(theme.value === "dark" ? "light" : "dark")}
      />
      <IconButton icon="help" label="Keys and help" shortcut="?" onClick={() => (app.dialog.value = "help")} />
      {model.loginRequired.value ? <IconButton icon="exit" label="Log out" onClick={() => void model.logOut()} /> : null}
    </header>
  );
}
