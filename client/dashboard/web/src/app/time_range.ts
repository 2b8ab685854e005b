// SPDX-License-Identifier: Apache-2.0
// The span of time that plots and timeline show.
import { computed, signal } from "@preact/signals";
import type { Player } from "./player";

export type Span = 30 | 60 | 300 | "all";

export interface Range {
  readonly from: number;
  readonly to: number;
}

const MIN_SPAN_S = 2;

export class TimeRange {
  readonly span = signal<Span>(60);
  readonly hover = signal<number | null>(null);
  private readonly custom = signal<Range | null>(null);

  constructor(private readonly player: Player) {}

  readonly range = computed<Range>(() => {
    this.player.grown.value;
    const { first, last } = this.player.history;
    if (!first || !last) return { from: 0, to: 60 };
    const custom = this.custom.value;
    const cursor = this.player.cursor.value;
    if (custom && cursor !== null) return this.around(custom, cursor);
    const span = this.span.value;
    if (span === "all") return { from: first.timeS, to: Math.max(last.timeS, first.timeS + MIN_SPAN_S) };
    if (cursor === null) return { from: last.timeS - span, to: last.timeS };
    return this.around({ from: last.timeS - span, to: last.timeS }, cursor);
  });

  // The same width, moved so that the cursor is inside.
  private around(range: Range, cursor: number): Range {
    const width = range.to - range.from;
    if (cursor < range.from) return { from: cursor, to: cursor + width };
    if (cursor > range.to) return { from: cursor - width, to: cursor };
    return range;
  }

  setSpan(span: Span): void {
    this.custom.value = null;
    this.span.value = span;
  }

  // Keeps what is shown while the cursor is in the past.
  freeze(): void {
    this.custom.value = this.range.peek();
  }

  follow(): void {
    this.custom.value = null;
  }

  zoom(factor: number, about: number): void {
    const { first, last } = this.player.history;
    const { from, to } = this.range.peek();
    if (!first || !last) return;
    const width = Math.min(Math.max((to - from) * factor, MIN_SPAN_S), Math.max(MIN_SPAN_S, last.timeS - first.timeS));
    const share = (about - from) / (to - from);
    const start = Math.min(Math.max(about - share * width, first.timeS), Math.max(first.timeS, last.timeS - width));
    this.custom.value = { from: start, to: start + width };
    if (this.player.cursor.peek() === null) this.player.seek(about);
  }
}
