// SPDX-License-Identifier: Apache-2.0
// The camera and the targets in numbers and words.
import type { JSX } from "preact";
import type { App } from "../app/app";
import { cameraState, TargetState, vec3, worldFromCamera, type FrameRecord, type TargetResult } from "../data/frame";
import { moversWords, speedOf } from "../data/movers";
import { cameraTone, cameraWords, targetTone, targetWords } from "../data/timeline";
import { BodyKind } from "../gen/groundlock/v1/tracking_pb";
import { ellipseOf, poseSigmas, SIGMAS_95 } from "../math/ellipse";
import { distance } from "../math/pose";
import { Dot, IconButton, Meter } from "./controls";
import { degrees, kindWord, length } from "./format";
import { useReadout } from "./readout";
import { targetToken } from "./theme";

export function Targets({ app }: { app: App }): JSX.Element {
  const { model } = app;
  const r = useReadout(app);
  const metric = model.cloudMap.value?.metric ?? true;
  return (
    <section class="targets" aria-label="Camera and targets" tabIndex={0}>
      {r ? <CameraCard record={r} metric={metric} /> : null}
      {r?.result.targets.map((t) => <TargetCard key={t.targetId} app={app} record={r} target={t} metric={metric} />)}
      {r && r.result.targets.length === 0 ? (
        <div class="card hint-card">
          <p><b>No target yet.</b></p>
          <p>{app.canMark() ? "Press B and draw a box around something that moves." : "Nothing was marked in this frame."}</p>
        </div>
      ) : null}
      {r ? <Movers app={app} record={r} metric={metric} /> : null}
      {r?.result.targetErrors.map((e) => (
        <div class="card error-card" key={e.targetId} role="alert"><b>{e.targetId}</b> {e.message}</div>
      ))}
    </section>
  );
}

// No more than fit without the page jumping; the image shows all.
const MOVERS_LISTED = 3;

// The same as a click on the image, for keys and screen readers.
function Movers({ app, record, metric }: { app: App; record: FrameRecord; metric: boolean }): JSX.Element | null {
  const { movers, moversState } = record.result;
  const why = moversWords(moversState);
  if (movers.length === 0 && !why) return null;
  return (
    <article class="card movers-card" aria-label="What else moves">
      <header><span class="swatch" aria-hidden="true" style={{ background: "var(--mover)" }} /><h2>moving</h2><span class="state">{movers.length}</span></header>
      {why ? <p class="muted">{why}</p> : null}
      {movers.slice(0, MOVERS_LISTED).map((m) => {
        const words = `${speedOf(m).toFixed(1)} ${metric ? "m/s" : "u/s"}`;
        return app.canMark() ? (
          <button type="button" class="mover" key={String(m.moverId)} aria-label={`Make mover ${m.moverId} a target, ${words}`} onClick={() => app.takeMover(m.moverId)}>
            {String(m.moverId)} · {words}
          </button>
        ) : <p key={String(m.moverId)}>{String(m.moverId)} · {words}</p>;
      })}
    </article>
  );
}

function CameraCard({ record, metric }: { record: FrameRecord; metric: boolean }): JSX.Element {
  const camera = record.result.camera;
  const state = cameraState(record);
  const sigma = poseSigmas(camera?.covariance ?? []);
  const pose = worldFromCamera(record);
  return (
    <article class="card" aria-label="Camera">
      <header><Dot tone={cameraTone(state)} /><h2>camera</h2><span class="state" data-tone={cameraTone(state)}>{cameraWords(state)}</span></header>
      <dl>
        <dt>inliers</dt><dd>{camera?.numInliers ?? 0}</dd>
        <dt>error</dt><dd>{pose ? `${(camera?.meanReprojectionErrorPx ?? 0).toFixed(2)} px` : "–"}</dd>
        <dt>± position</dt><dd>{sigma ? length(sigma.position, metric) : "–"}</dd>
        <dt>± rotation</dt><dd>{sigma ? degrees(sigma.rotation, 2) : "–"}</dd>
        <dt>at</dt><dd class="wide">{pose ? pose.translation.map((v) => v.toFixed(2)).join("  ") : "–"}</dd>
      </dl>
    </article>
  );
}

// How well the heading and the size are known.
function headingWords(t: TargetResult): string {
  const covariance = t.sizeCovarianceM2;
  if (!t.boxWorld || covariance.length !== 9) return "";
  const size = [t.boxWorld.sizeM?.x ?? 0, t.boxWorld.sizeM?.y ?? 0, t.boxWorld.sizeM?.z ?? 0]
    .map((extent, i) => `${extent.toFixed(2)} ± ${Math.sqrt(covariance[4 * i]!).toFixed(2)}`)
    .join(" × ");
  return `± ${degrees(t.headingSigmaRad, 0)}${t.frontKnown ? "" : ", or the opposite way"}; size ${size}`;
}

function TargetCard(props: { app: App; record: FrameRecord; target: TargetResult; metric: boolean }): JSX.Element {
  const { app, record, target: t, metric } = props;
  const { model } = app;
  const tone = targetTone(t.state);
  const place = vec3(t.groundCenterM);
  const pose = worldFromCamera(record);
  const velocity = vec3(t.velocityWorldMS);
  const ellipse = ellipseOf(t.groundCovarianceM2);
  const live = app.canMark();
  const own = targetToken(Math.max(0, app.targetOrder.value.indexOf(t.targetId)));
  return (
    <article
      class="card"
      aria-label={`Target ${t.targetId}`}
      data-selected={model.selectedTarget.value === t.targetId}
      style={{ "--own": `var(--${own})` }}
      onClick={() => (model.selectedTarget.value = t.targetId)}
    >
      <header>
        <span class="swatch" aria-hidden="true" /><h2>{t.targetId}</h2>{t.bodyKind !== BodyKind.UNSPECIFIED ? <small class="kind">{kindWord(t.bodyKind)}</small> : null}
        <span class="state" data-tone={tone}>{targetWords(t.state, t.ageS)}</span>
      </header>
      <div class="confidence">
        <Meter value={t.confidence} label={`Confidence of ${t.targetId}`} />
        <b>{t.confidence.toFixed(2)}</b>
      </div>
      <dl>
        <dt>distance</dt><dd>{place && pose ? length(distance(place, pose.translation), metric) : "–"}</dd>
        <dt>speed</dt><dd>{velocity && place ? `${Math.hypot(...velocity).toFixed(2)} ${metric ? "m/s" : "u/s"}` : "–"}</dd>
        <dt>heading</dt><dd title={headingWords(t)}>{t.boxWorld ? degrees(t.headingRad, 0) : "–"}</dd>
        <dt>± 95 %</dt><dd>{ellipse && place ? length(SIGMAS_95 * ellipse.major, metric) : "–"}</dd>
        <dt>at</dt><dd class="wide">{place ? `${place[0].toFixed(2)}  ${place[1].toFixed(2)}` : "2D only"}</dd>
      </dl>
      {live ? (
        <footer>
          <IconButton icon="box" label={`Draw ${t.targetId} anew`} onClick={() => app.setMode("draw", t.targetId)} />
          <IconButton icon="move" label={`Move ${t.targetId}`} disabled={t.state === TargetState.UNSPECIFIED} onClick={() => app.setMode("move")} />
          <IconButton icon="drop" label={`Drop ${t.targetId}`} tone="bad" onClick={() => void model.dropTarget(t.targetId)} />
        </footer>
      ) : null}
    </article>
  );
}
