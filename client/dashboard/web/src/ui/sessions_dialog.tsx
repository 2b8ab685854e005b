// SPDX-License-Identifier: Apache-2.0
// Sessions and recordings: to open, end and delete.
import type { JSX } from "preact";
import type { App } from "../app/app";
import { RecordingInfo_State, type RecordingInfo, type SessionEntry } from "../gen/groundlock/dashboard/v1/dashboard_pb";
import { recordingUrl } from "../link/http";
import { clock } from "../data/timeline";
import { Button, Dialog, Dot, Empty, IconButton } from "./controls";
import { bytes, count, when } from "./format";
import { Icon } from "./icons";

export function SessionRow({ app, entry }: { app: App; entry: SessionEntry }): JSX.Element | null {
  const s = entry.session;
  if (!s) return null;
  const remove = () => {
    if (!confirm(`End session ${s.sessionId}? Its targets and results are lost.`)) return;
    void app.model.attempt(`Session ${s.sessionId} could not be ended`, () =>
      app.model.connection.request("done", { case: "deleteSession", value: { sessionId: s.sessionId } }),
    );
  };
  return (
    <li class="item">
      <button type="button" class="item-main" onClick={() => app.go({ kind: "live", id: s.sessionId })}>
        <Dot tone={s.streaming ? "good" : "idle"} />
        <span class="item-name">{s.sessionId}</span>
        <span class="muted">
          {[s.mapName || "no map", `${count(s.framesProcessed)} frames`, `${s.targetIds.length} target${s.targetIds.length === 1 ? "" : "s"}`,
            s.streaming ? "streaming" : "no client", entry.recording ? "recording" : ""].filter(Boolean).join(" · ")}
        </span>
      </button>
      <IconButton icon="drop" label={`End session ${s.sessionId}`} tone="bad" onClick={remove} />
    </li>
  );
}

export function RecordingRow({ app, recording: r }: { app: App; recording: RecordingInfo }): JSX.Element {
  const remove = () => {
    if (!confirm(`Delete recording ${r.name}?`)) return;
    void app.model.attempt(`Recording ${r.name} could not be deleted`, () =>
      app.model.connection.request("done", { case: "deleteRecording", value: { name: r.name } }),
    );
  };
  const note = {
    [RecordingInfo_State.RECORDING]: "being written",
    [RecordingInfo_State.INTERRUPTED]: "broken off",
    [RecordingInfo_State.FAILED]: r.message || "failed",
  }[r.state as number];
  return (
    <li class="item">
      <button type="button" class="item-main" onClick={() => app.go({ kind: "replay", id: r.name })}>
        <Icon name="film" />
        <span class="item-name">{r.name}</span>
        <span class="muted">
          {[when(r.startTime), clock(r.durationS), `${count(r.frames)} frames`, bytes(r.sizeBytes), note].filter(Boolean).join(" · ")}
        </span>
      </button>
      <a class="icon-button" href={recordingUrl(r.name)} download={`${r.name}.mcap`} aria-label={`Download recording ${r.name}`} title="Download (MCAP)"><Icon name="download" /></a>
      <IconButton icon="drop" label={`Delete recording ${r.name}`} tone="bad" disabled={r.state === RecordingInfo_State.RECORDING} onClick={remove} />
    </li>
  );
}

export function SessionsDialog({ app }: { app: App }): JSX.Element {
  const { model } = app;
  return (
    <Dialog
      title="Sessions and recordings"
      wide
      onClose={() => (app.dialog.value = null)}
      footer={<Button kind="primary" icon="plus" onClick={() => (app.dialog.value = "start")}>New session</Button>}
    >
      <h3>Sessions</h3>
      {model.sessions.value.length === 0 ? (
        <Empty icon="live" title="No session is open"><p>Start one here, or stream with <code>groundlock track</code>.</p></Empty>
      ) : (
        <ul class="items">{model.sessions.value.map((e) => <SessionRow key={e.session?.sessionId} app={app} entry={e} />)}</ul>
      )}
      <h3>Recordings {model.freeBytes.value > 0n ? <small class="muted">{bytes(model.freeBytes.value)} free</small> : null}</h3>
      {model.recordings.value.length === 0 ? (
        <Empty icon="film" title="Nothing has been recorded"><p>Press R while a session is shown.</p></Empty>
      ) : (
        <ul class="items">{model.recordings.value.map((r) => <RecordingRow key={r.name} app={app} recording={r} />)}</ul>
      )}
    </Dialog>
  );
}
