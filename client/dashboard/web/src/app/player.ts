// SPDX-License-Identifier: Apache-2.0
// Where in time the page is: following what comes in, or somewhere in the past,
// standing or playing. Hands frames to the views.
import { batch, signal } from "@preact/signals";
import type { FrameRecord } from "../data/frame";
import { FrameHistory } from "../data/history";
import { Presenter, type Shown } from "../image/presenter";
import { RateMeter } from "./rate_meter";

// An image this many frames older than the result is still shown with it.
const MAX_IMAGE_LAG = 12;

export interface ImageLoader {
  // Makes images from a record on available in the history; resolves when the
  // record's own is there or is known to be missing.
  load(record: FrameRecord): Promise<void>;
  // The record is being played past: what follows will be wanted soon.
  ahead(record: FrameRecord): void;
}

export class Player {
  history = new FrameHistory();
  // Raised whenever the history grew; at most once per animation frame.
  readonly grown = signal(0);
  readonly current = signal<FrameRecord | null>(null);
  // Seconds on the history's axis; null = following.
  readonly cursor = signal<number | null>(null);
  readonly playing = signal(false);
  readonly rate = signal(1);
  readonly shownRate = new RateMeter();
  readonly resultRate = new RateMeter();
  onShow: (shown: Shown) => void = () => undefined;
  private presenter = new Presenter((shown) => this.show(shown));
  private loader: ImageLoader | null = null;
  private live = true;
  private announced = false;
  private playFrom = { at: 0, timeS: 0 };
  private shownPast = -1;

  // Starts anew, empty. live: results come by append().
  reset(live: boolean, loader: ImageLoader | null): void {
    this.presenter.clear();
    this.history = new FrameHistory();
    this.loader = loader;
    this.live = live;
    this.shownPast = -1;
    this.shownRate.clear();
    this.resultRate.clear();
    batch(() => {
      this.current.value = null;
      this.cursor.value = live ? null : 0;
      this.playing.value = false;
      this.grown.value++;
    });
  }

  get isLive(): boolean {
    return this.live;
  }

  append(record: FrameRecord): void {
    const last = this.history.last;
    // Numbers that start anew mean that the session did.
    if (last && record.sequence + 600 < last.sequence) this.reset(true, null);
    this.history.append(record);
    this.resultRate.add(performance.now());
    this.announce();
    if (this.live && this.cursor.value === null) this.presenter.offerResult(record);
  }

  // True if the image is going to be shown, or another one in its place.
  addImage(sequence: number, data: Uint8Array): boolean {
    this.history.images.set(sequence, data);
    const record = this.history.at(this.history.indexOf(sequence));
    if (!record || !this.live || this.cursor.value !== null) return false;
    this.presenter.offerImage(record, data);
    return true;
  }

  merge(records: readonly FrameRecord[]): void {
    this.history.merge(records);
    this.announce();
    const last = this.history.last;
    if (this.live && this.cursor.value === null && !this.current.value && last) {
      this.presenter.offerResult(last);
    }
  }

  // Jumps to a time; null follows again (live) or goes to the end.
  seek(timeS: number | null): void {
    const { first, last } = this.history;
    if (!first || !last) return;
    if (timeS === null && this.live) {
      batch(() => {
        this.cursor.value = null;
        this.playing.value = false;
      });
      this.presenter.reset();
      this.showRecord(last);
      return;
    }
    const clamped = Math.min(last.timeS, Math.max(first.timeS, timeS ?? last.timeS));
    this.cursor.value = clamped;
    this.playFrom = { at: performance.now(), timeS: clamped };
    this.showPast(clamped);
  }

  // By frames.
  step(frames: number): void {
    const index =
      this.cursor.value === null ? this.history.length - 1 : this.history.indexAt(this.cursor.value);
    const record = this.history.at(Math.min(this.history.length - 1, Math.max(0, index + frames)));
    if (!record) return;
    this.playing.value = false;
    this.seek(record.timeS);
  }

  togglePlay(): void {
    if (this.playing.value) {
      this.playing.value = false;
    } else if (this.cursor.value === null) {
      this.seek(this.history.last?.timeS ?? null); // a live view stands still
    } else {
      const last = this.history.last;
      if (!last) return;
      if (!this.live && this.cursor.value >= last.timeS - 1e-3) {
        this.seek(this.history.first!.timeS);
      }
      this.playFrom = { at: performance.now(), timeS: this.cursor.value };
      this.playing.value = true;
      requestAnimationFrame(this.advance);
    }
  }

  setRate(rate: number): void {
    this.rate.value = rate;
    this.playFrom = { at: performance.now(), timeS: this.cursor.value ?? 0 };
  }

  private readonly advance = (): void => {
    if (!this.playing.value || this.cursor.value === null) return;
    const now = performance.now();
    const timeS = this.playFrom.timeS + ((now - this.playFrom.at) / 1000) * this.rate.value;
    const end = this.history.last?.timeS ?? 0;
    if (timeS >= end) {
      this.playing.value = false;
      this.seek(this.live ? null : end);
      return;
    }
    this.cursor.value = timeS;
    this.showPast(timeS);
    requestAnimationFrame(this.advance);
  };

  private showPast(timeS: number): void {
    const record = this.history.at(this.history.indexAt(timeS + 1e-6));
    if (!record || record.sequence === this.shownPast) return;
    this.showRecord(record);
  }

  private showRecord(record: FrameRecord): void {
    this.shownPast = record.sequence;
    const { images } = this.history;
    const near = images.atOrBefore(record.sequence, MAX_IMAGE_LAG);
    void this.presenter.showPast(record, near ?? -1, near === null ? null : images.get(near)!);
    if (this.playing.peek()) this.loader?.ahead(record);
    if (near !== record.sequence && this.loader) {
      void this.loader.load(record).then(() => {
        if (this.shownPast !== record.sequence) return;
        const data = images.get(record.sequence);
        if (data) void this.presenter.showPast(record, record.sequence, data);
      });
    }
  }

  private show(shown: Shown): void {
    this.shownRate.add(performance.now());
    this.onShow(shown);
    this.current.value = shown.record;
  }

  private announce(): void {
    if (this.announced) return;
    this.announced = true;
    requestAnimationFrame(() => {
      this.announced = false;
      this.grown.value++;
    });
  }
}
