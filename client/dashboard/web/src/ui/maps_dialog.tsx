// SPDX-License-Identifier: Apache-2.0
// Maps: list, inspect, check, upload, build, align, delete.
import type { JSX } from "preact";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import { message, toast } from "../app/toasts";
import { GroundState, type MapInfo } from "../gen/groundlock/v1/maps_pb";
import { AlignForm } from "./align_form";
import { Button, Dialog, Empty } from "./controls";
import { bytes, count, when } from "./format";
import { MapUploadForm } from "./map_upload_form";

type Pane = { kind: "map"; name: string } | { kind: "upload" } | { kind: "align"; name: string };

export function MapsDialog({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const maps = model.maps.value;
  const pane = useSignal<Pane>(maps[0] ? { kind: "map", name: maps[0].name } : { kind: "upload" });
  const p = pane.value;
  const shown = p.kind === "upload" ? undefined : maps.find((m) => m.name === p.name);
  return (
    <Dialog title="Maps" wide onClose={() => (app.dialog.value = null)}>
      <div class="split">
        <nav aria-label="Maps">
          <ul class="items">
            {maps.map((m) => (
              <li class="item" key={m.name}>
                <button type="button" class="item-main" aria-current={shown?.name === m.name} onClick={() => (pane.value = { kind: "map", name: m.name })}>
                  <span class="item-name">{m.name}</span>
                  <span class="muted">{count(m.numLandmarks)} landmarks · version {String(m.version)}</span>
                </button>
              </li>
            ))}
          </ul>
          <Button icon="upload" onClick={() => (pane.value = { kind: "upload" })}>Upload or build</Button>
        </nav>
        <div class="split-main">
          {p.kind === "upload" ? (
            <MapUploadForm app={app} onDone={(name) => (pane.value = { kind: "map", name })} />
          ) : !shown ? (
            <Empty icon="map" title="This map is gone" />
          ) : p.kind === "align" ? (
            <AlignForm app={app} map={shown} onDone={() => (pane.value = { kind: "map", name: shown.name })} />
          ) : (
            <MapDetails key={shown.name} app={app} map={shown} onAlign={() => (pane.value = { kind: "align", name: shown.name })} />
          )}
        </div>
      </div>
    </Dialog>
  );
}

// As `groundlock map show` says it.
function groundText(m: MapInfo): string {
  const height = m.groundHeightSigma > 0
    ? `; the cameras' height above it ± ${(100 * m.groundHeightSigma).toFixed(1)} %`
    : "";
  const sigma = m.groundSigmaDeg > 0 ? ` (± ${m.groundSigmaDeg.toFixed(1)}°${height})` : "";
  const relief = m.groundReliefM > 0
    ? `, uneven by ${m.groundReliefM.toFixed(2)} ${m.metric ? "m" : "units"}${m.groundReliefGiven ? " as its terrain says" : ""}`
    : "";
  switch (m.groundState) {
    case GroundState.MEASURED:
      return `measured${sigma}${relief}`;
    case GroundState.ESTIMATED:
      return `estimated${sigma}${relief}`;
    case GroundState.UNKNOWN:
      return "unknown: no boxes in the world. Set it in the 3D scene (G), or align the map";
    default:
      return "not told";
  }
}

function MapDetails(props: { app: App; map: MapInfo; onAlign: () => void }): JSX.Element {
  const { app, map: m } = props;
  const { model } = app;
  const check = useSignal<"" | "busy" | readonly string[]>("");
  const origin = m.origin;
  const runCheck = async () => {
    check.value = "busy";
    try {
      const reply = await model.connection.request("mapChecked", { case: "checkMap", value: { name: m.name } });
      check.value = reply.problems;
    } catch (e) {
      check.value = "";
      toast("bad", `Map ${m.name}: ${message(e)}`);
    }
  };
  const remove = () => {
    if (!confirm(`Delete all versions of map ${m.name}? Sessions that use it go on.`)) return;
    void model.attempt(`Map ${m.name} could not be deleted`, () =>
      model.connection.request("done", { case: "deleteMap", value: { name: m.name } }),
    );
  };
  return (
    <div>
      <h3>{m.name} <small class="muted">version {String(m.version)}, {when(m.createTime)}</small></h3>
      <dl class="facts">
        <dt>From</dt><dd>{m.sourceFormat}</dd>
        <dt>Landmarks</dt><dd>{count(m.numLandmarks)} in {count(m.numViews)} views by {count(m.numCameras)} camera{m.numCameras === 1n ? "" : "s"}</dd>
        <dt>Reprojection</dt><dd>{m.meanReprojectionErrorPx.toFixed(2)} px over {count(m.numObservations)} observations</dd>
        <dt>Unit</dt><dd>{m.metric ? "metres" : "its own: align it to get metres"}</dd>
        <dt>Ground</dt><dd>{groundText(m)}</dd>
        <dt>On Earth</dt><dd>{origin ? `${origin.latitudeDeg.toFixed(6)}, ${origin.longitudeDeg.toFixed(6)}, ${origin.heightM.toFixed(1)} m` : "not georeferenced"}</dd>
        <dt>Localising</dt><dd>{m.hasDescriptors ? "possible" : "impossible: the map has no descriptors"}</dd>
        <dt>Size</dt><dd>{bytes(m.fileBytes)}</dd>
      </dl>
      {check.value === "busy" ? <p role="status">Reading the map…</p> : null}
      {Array.isArray(check.value) ? (
        check.value.length === 0 ? <p class="ok" role="status">The map is sound.</p> : (
          <ul class="problems" role="alert">{check.value.map((text) => <li key={text}>{text}</li>)}</ul>
        )
      ) : null}
      <div class="actions">
        <Button icon="check" onClick={() => void runCheck()}>Check</Button>
        <Button icon="fit" onClick={props.onAlign}>Align</Button>
        <Button icon="drop" kind="danger" onClick={remove}>Delete</Button>
      </div>
    </div>
  );
}
