// SPDX-License-Identifier: Apache-2.0
// The panes of the image and of the 3D scene, with their tools.
import type { ComponentChildren, JSX } from "preact";
import { useEffect, useRef } from "preact/hooks";
import { useComputed } from "@preact/signals";
import type { App } from "../app/app";
import { SubscriptionState_State } from "../gen/groundlock/dashboard/v1/dashboard_pb";
import { BodyKind } from "../gen/groundlock/v1/tracking_pb";
import { BODY_KINDS, kindWord } from "./format";
import { Button, Empty, IconButton, ProgressBar, Segmented } from "./controls";

function Host({ element }: { element: HTMLElement }): JSX.Element {
  const host = useRef<HTMLDivElement>(null);
  useEffect(() => {
    host.current!.append(element);
    return () => element.remove();
  }, [element]);
  return <div class="host" ref={host} />;
}

function Toggle(props: { app: App; layer: "landmarks" | "boxes2d" | "boxes3d" | "movers" | "points" | "mapCameras" | "trails"; children: ComponentChildren }): JSX.Element {
  const { app, layer } = props;
  return (
    <button type="button" class="layer" aria-pressed={app.layers.value[layer]} onClick={() => app.toggleLayer(layer)}>
      {props.children}
    </button>
  );
}

// What is going to be marked, for who knows it: the 3D box is right sooner.
function KindChoice({ app }: { app: App }): JSX.Element {
  return (
    <select
      aria-label="Kind of target"
      value={app.bodyKind.value}
      onChange={(event) => {
        app.bodyKind.value = Number(event.currentTarget.value);
        app.image.element.focus({ preventScroll: true });
      }}
    >
      <option value={BodyKind.UNSPECIFIED}>of any kind</option>
      {BODY_KINDS.map((kind) => <option key={kind} value={kind}>{kindWord(kind)}</option>)}
    </select>
  );
}

export function ImagePane({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const empty = useComputed(() => model.player.current.value === null).value;
  const mode = app.mode.value;
  const live = model.view.value?.kind === "live";
  return (
    <section class="pane image-pane" aria-label="Camera image">
      <Host element={app.image.element} />
      {empty ? <ImageEmpty app={app} /> : null}
      <div class="pane-tools top-left" role="toolbar" aria-label="Image tools">
        {live ? (
          <>
            <IconButton icon="box" label="Draw a box around a target" shortcut="B" pressed={mode === "draw"} onClick={() => app.setMode(mode === "draw" ? "look" : "draw")} />
            <IconButton icon="move" label="Move a target's box" shortcut="M" pressed={mode === "move"} onClick={() => app.setMode(mode === "move" ? "look" : "move")} />
          </>
        ) : null}
        <IconButton icon="steady" label="Stabilised view" shortcut="V" pressed={app.stabilized.value} onClick={() => (app.stabilized.value = !app.stabilized.value)} />
      </div>
      <div class="pane-tools bottom-left" role="group" aria-label="Image layers">
        <Toggle app={app} layer="landmarks"><i style={{ background: "var(--landmark)" }} />landmarks</Toggle>
        <Toggle app={app} layer="boxes2d"><i style={{ background: "#fff" }} />2D</Toggle>
        <Toggle app={app} layer="boxes3d"><i style={{ background: "var(--box)" }} />3D</Toggle>
        <Toggle app={app} layer="movers"><i style={{ background: "var(--mover)" }} />moving</Toggle>
      </div>
      {mode !== "look" ? (
        <div class="pane-hint" role="status">
          {mode === "draw"
            ? app.redraws.value ? `Draw ${app.redraws.value} anew` : "Drag a box around the target"
            : "Drag a box to where the target is"}
          {mode === "draw" ? <KindChoice app={app} /> : null}
          <span> · Esc</span>
        </div>
      ) : app.stabilized.value && !empty ? <div class="pane-hint quiet">stabilised</div> : null}
    </section>
  );
}

function ImageEmpty({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const state = model.subscription.value;
  const view = model.view.value;
  if (view?.kind === "replay") {
    return model.replayProgress.value === null ? (
      <Empty icon="warning" title="This recording cannot be shown">
        <p>It has been deleted, or holds no frames.</p>
        <p><a href="#/">To the start page</a></p>
      </Empty>
    ) : (
      <Empty icon="film" title="Reading the recording">
        <ProgressBar value={model.replayProgress.value} label="Reading the recording" />
      </Empty>
    );
  }
  if (state?.state === SubscriptionState_State.FAILED || (model.sessionsKnown.value && !model.entry.value)) {
    return (
      <Empty icon="warning" title={`There is no session ${view?.id ?? ""}`}>
        <p>It has ended, or has not begun. Choose another one, or start one.</p>
        <p><a href="#/">To the start page</a></p>
      </Empty>
    );
  }
  return (
    <Empty icon="live" title="Waiting for frames">
      <p>
        {model.entry.value?.session?.streaming
          ? "A client is attached; the first result is on its way."
          : "No client is attached. Stream frames to this session:"}
      </p>
      {model.entry.value?.session?.streaming ? null : <code>groundlock track VIDEO --session {view?.id}</code>}
    </Empty>
  );
}

function GroundPanel({ app: { ground } }: { app: App }): JSX.Element {
  return (
    <div class="ground-panel" role="group" aria-label="The map's ground">
      <span role="status">{ground.hint.value}</span>
      <Button disabled={ground.places.value.length === 0} onClick={() => ground.levelHere()}>Level here</Button>
      <Button kind="primary" disabled={ground.plane.value === null || ground.busy.value} onClick={() => void ground.apply()}>Set the ground</Button>
      <Button onClick={() => ground.clear()}>Cancel</Button>
    </div>
  );
}

export function ScenePane({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const progress = model.cloudProgress.value;
  const session = model.session.value;
  return (
    <section class="pane scene-pane" aria-label="3D scene">
      {app.scene ? <Host element={app.scene.element} /> : <Empty icon="warning" title={app.sceneError.value} />}
      <div class="pane-tools top-left" role="toolbar" aria-label="Scene views">
        <Segmented
          label="View"
          value={app.viewMode.value}
          options={[
            { value: "orbit", label: "Orbit", icon: "orbit", title: "Orbit (O)" },
            { value: "follow", label: "Follow the camera", icon: "follow", title: "Follow the camera (C)" },
            { value: "top", label: "From above", icon: "top", title: "From above (U)" },
          ]}
          onChange={(v) => (app.viewMode.value = v)}
        />
        <IconButton icon="fit" label="Show everything" shortcut="F" onClick={() => app.scene?.frame()} />
        {app.scene && session?.mapName && model.view.value?.kind === "live" ? (
          <IconButton icon="ground" label="Set the map's ground" shortcut="G" pressed={app.ground.active.value} onClick={() => app.ground.toggle()} />
        ) : null}
      </div>
      <div class="pane-tools bottom-left" role="group" aria-label="Scene layers">
        <Toggle app={app} layer="points">points</Toggle>
        <Toggle app={app} layer="mapCameras">map cameras</Toggle>
        <Toggle app={app} layer="trails">trails</Toggle>
      </div>
      <div class="scene-stats" aria-hidden="true">{app.sceneStats.value}</div>
      {app.ground.active.value ? <GroundPanel app={app} /> : progress !== null ? (
        <div class="pane-hint quiet"><ProgressBar value={progress} label="Loading the map's points" /> loading points</div>
      ) : session && !session.mapName ? (
        <div class="pane-hint quiet">no map: targets are tracked in 2D only</div>
      ) : null}
    </section>
  );
}
