// SPDX-License-Identifier: Apache-2.0
// The start page: what there is, and what to do when there is nothing.
import type { JSX } from "preact";
import type { App } from "../app/app";
import { Button, Empty } from "./controls";
import { count } from "./format";
import { RecordingRow, SessionRow } from "./sessions_dialog";

const MAX_ROWS = 8;

export function Home({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const known = model.sessionsKnown.value;
  return (
    <main class="home">
      <h1 class="visually-hidden">Groundlock</h1>
      <section class="home-card" aria-labelledby="home-sessions">
        <header><h2 id="home-sessions">Sessions</h2><Button icon="plus" onClick={() => (app.dialog.value = "start")}>New</Button></header>
        {!known ? (
          <p class="muted" role="status">Asking the server…</p>
        ) : model.sessions.value.length === 0 ? (
          <Empty icon="live" title="No session is open">
            <p>Start one from a video, or stream to the server:</p>
            <code>groundlock track VIDEO --map NAME --camera camera.json --init-box X,Y,W,H --realtime</code>
          </Empty>
        ) : (
          <ul class="items">{model.sessions.value.slice(0, MAX_ROWS).map((e) => <SessionRow key={e.session?.sessionId} app={app} entry={e} />)}</ul>
        )}
      </section>
      <section class="home-card" aria-labelledby="home-recordings">
        <header><h2 id="home-recordings">Recordings</h2></header>
        {model.recordings.value.length === 0 ? (
          <Empty icon="film" title="Nothing has been recorded"><p>Open a session and press R.</p></Empty>
        ) : (
          <ul class="items">{model.recordings.value.slice(0, MAX_ROWS).map((r) => <RecordingRow key={r.name} app={app} recording={r} />)}</ul>
        )}
      </section>
      <section class="home-card" aria-labelledby="home-maps">
        <header><h2 id="home-maps">Maps</h2><Button icon="upload" onClick={() => (app.dialog.value = "maps")}>Manage</Button></header>
        {model.maps.value.length === 0 ? (
          <Empty icon="map" title="There is no map yet"><p>Upload a reconstruction or a video of the place. Without a map targets are tracked in the image only.</p></Empty>
        ) : (
          <ul class="items">
            {model.maps.value.slice(0, MAX_ROWS).map((m) => (
              <li class="item" key={m.name}>
                <button type="button" class="item-main" onClick={() => (app.dialog.value = "maps")}>
                  <span class="item-name">{m.name}</span>
                  <span class="muted">{count(m.numLandmarks)} landmarks · {m.metric ? "metric" : "not aligned"}</span>
                </button>
              </li>
            ))}
          </ul>
        )}
      </section>
    </main>
  );
}
