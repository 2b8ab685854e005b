// SPDX-License-Identifier: Apache-2.0
// A new session: from a source of the server's side or an uploaded video.
import type { JSX } from "preact";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import { message } from "../app/toasts";
import { CameraModelId } from "../gen/groundlock/v1/geometry_pb";
import { Source_Kind, type Source } from "../gen/groundlock/dashboard/v1/dashboard_pb";
import { FlowMode } from "../gen/groundlock/v1/tracking_pb";
import { upload } from "../link/http";
import { parseCameraJson, type CameraParams } from "../math/camera";
import { Button, Dialog, Empty, Field, ProgressBar } from "./controls";
import { bytes } from "./format";
import { Icon } from "./icons";

const KIND: Record<number, string> = {
  [Source_Kind.FILE]: "video",
  [Source_Kind.FOLDER]: "images",
  [Source_Kind.UPLOAD]: "uploaded",
  [Source_Kind.STREAM]: "stream",
};
const SOURCE_PATIENCE_MS = 15_000;

async function sourceOfUpload(app: App, uploadId: string): Promise<Source> {
  const until = performance.now() + SOURCE_PATIENCE_MS;
  for (;;) {
    const source = app.model.sources.value.find((s) => s.uploadId === uploadId);
    if (source) return source;
    if (performance.now() > until) throw new Error("the dashboard cannot read this video");
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
}

export function StartDialog({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const source = useSignal(model.sources.value[0]?.sourceId ?? "");
  const file = useSignal<File | null>(null);
  const map = useSignal(model.maps.value[0]?.name ?? "");
  const camera = useSignal<CameraParams | null>(null);
  const cameraError = useSignal("");
  const name = useSignal("");
  const tracker = useSignal("");
  const localizer = useSignal("");
  const loop = useSignal(false);
  const paused = useSignal(false);
  const movers = useSignal(true);
  const busy = useSignal("");
  const fraction = useSignal<number | null>(null);
  const error = useSignal("");
  const abort = useSignal<AbortController | null>(null);

  const chosen = model.sources.value.find((s) => s.sourceId === source.value);
  const needsCamera = camera.value === null && !(file.value ? false : chosen?.camera);
  const ready = (file.value !== null || chosen !== undefined) && !needsCamera;

  const start = async () => {
    error.value = "";
    try {
      let sourceId = source.value;
      if (file.value) {
        busy.value = "Uploading the video";
        abort.value = new AbortController();
        const video = file.value;
        const id = await upload("video", video.name, [{ path: video.name, file: video }],
          (sent, total) => (fraction.value = total > 0 ? sent / total : null), abort.value.signal);
        sourceId = (await sourceOfUpload(app, id)).sourceId;
      }
      busy.value = "Starting";
      fraction.value = null;
      const own = camera.value;
      const reply = await model.connection.request("sessionStarted", {
        case: "startSession",
        value: {
          sourceId,
          paused: paused.value,
          loop: loop.value,
          session: {
            sessionId: name.value,
            mapName: map.value,
            ...(own ? { camera: { model: own.model as number as CameraModelId, widthPx: own.width, heightPx: own.height, params: [...own.params] } } : {}),
            options: { tracker: tracker.value, localizer: localizer.value, flowMode: FlowMode.LIVE, reportMatches: true, reportMovers: movers.value && map.value !== "" },
          },
        },
      });
      if (reply.session) app.go({ kind: "live", id: reply.session.sessionId });
    } catch (e) {
      error.value = message(e);
    } finally {
      busy.value = "";
      abort.value = null;
    }
  };

  const readCamera = async (input: HTMLInputElement) => {
    camera.value = null;
    cameraError.value = "";
    const chosenFile = input.files?.[0];
    if (!chosenFile) return;
    try {
      camera.value = parseCameraJson(await chosenFile.text());
    } catch (e) {
      cameraError.value = message(e);
    }
  };

  const uploads = model.hello.value?.uploadsEnabled ?? false;
  return (
    <Dialog
      title="New session"
      onClose={() => {
        abort.value?.abort();
        app.dialog.value = null;
      }}
      footer={
        <>
          {busy.value ? <div class="grow"><span>{busy.value}</span><ProgressBar value={fraction.value} label={busy.value} /></div> : <p class="form-error grow" role="alert">{error.value}</p>}
          <Button kind="primary" icon="play" disabled={!ready || busy.value !== ""} onClick={() => void start()}>Start</Button>
        </>
      }
    >
      <fieldset class="choices">
        <legend>Source</legend>
        {model.sources.value.length === 0 && !uploads ? (
          <Empty icon="film" title="There are no sources">
            <p>Start the dashboard with <code>--sources FOLDER</code>, or stream with <code>groundlock track</code>.</p>
          </Empty>
        ) : null}
        {model.sources.value.map((s) => (
          <label class="choice" key={s.sourceId}>
            <input
              type="radio"
              name="source"
              checked={!file.value && source.value === s.sourceId}
              onChange={() => {
                source.value = s.sourceId;
                file.value = null;
              }}
            />
            <span class="choice-name">{s.name}</span>
            <span class="muted">{KIND[s.kind] ?? ""}{s.sizeBytes > 0n ? ` · ${bytes(s.sizeBytes)}` : ""}{s.camera ? "" : " · no camera.json"}</span>
          </label>
        ))}
        {uploads ? (
          <label class="choice upload">
            <Icon name="upload" />
            <span class="choice-name">{file.value ? file.value.name : "Upload a video…"}</span>
            {file.value ? <span class="muted">{bytes(file.value.size)}</span> : null}
            <input class="visually-hidden" type="file" accept="video/*,.mkv,.mp4,.avi,.mov" onChange={(e) => (file.value = e.currentTarget.files?.[0] ?? null)} />
          </label>
        ) : null}
      </fieldset>
      <div class="row">
        <Field label="Map" hint={map.value ? "" : "Without a map targets are tracked in the image only."}>
          {(id) => (
            <select id={id} value={map.value} onChange={(e) => (map.value = e.currentTarget.value)}>
              <option value="">none</option>
              {model.maps.value.map((m) => <option key={m.name} value={m.name}>{m.name}</option>)}
            </select>
          )}
        </Field>
        <Field label="Camera" hint={cameraError.value || (chosen?.camera && !file.value ? "The source has its own camera.json; another one may be chosen." : "camera.json: the lens that took the video.")}>
          {(id) => <input id={id} type="file" accept=".json,application/json" aria-invalid={cameraError.value !== ""} onChange={(e) => void readCamera(e.currentTarget)} />}
        </Field>
      </div>
      <label class="check"><input type="checkbox" checked={movers.value} disabled={map.value === ""} onChange={(e) => (movers.value = e.currentTarget.checked)} /> show what moves by itself, to make it a target by a click</label>
      <details>
        <summary>More</summary>
        <div class="row">
          <Field label="Name" hint="Letters, digits, . _ -; empty: made up.">
            {(id) => <input id={id} value={name.value} pattern="[A-Za-z0-9._\-]*" maxLength={64} onInput={(e) => (name.value = e.currentTarget.value)} />}
          </Field>
          <Field label="Tracker">
            {(id) => (
              <select id={id} value={tracker.value} onChange={(e) => (tracker.value = e.currentTarget.value)}>
                {["", "dcf", "act", "kcf", "csrt"].map((t) => <option key={t} value={t}>{t || "the server's default"}</option>)}
              </select>
            )}
          </Field>
          <Field label="Localiser">
            {(id) => (
              <select id={id} value={localizer.value} onChange={(e) => (localizer.value = e.currentTarget.value)}>
                {["", "fast", "baseline"].map((t) => <option key={t} value={t}>{t || "the server's default"}</option>)}
              </select>
            )}
          </Field>
        </div>
        <label class="check"><input type="checkbox" checked={loop.value} onChange={(e) => (loop.value = e.currentTarget.checked)} /> start anew at the end</label>
        <label class="check"><input type="checkbox" checked={paused.value} onChange={(e) => (paused.value = e.currentTarget.checked)} /> stop at the first frame, to mark a target in it</label>
      </details>
    </Dialog>
  );
}
