// SPDX-License-Identifier: Apache-2.0
// Short messages at the edge of the page.
import { signal } from "@preact/signals";

export interface Toast {
  readonly id: number;
  readonly tone: "info" | "good" | "bad";
  readonly text: string;
}

const SHOWN_MS = { info: 4000, good: 4000, bad: 10_000 } as const;
const MAX_TOASTS = 4;

export const toasts = signal<readonly Toast[]>([]);
let next = 1;

export function toast(tone: Toast["tone"], text: string): void {
  const id = next++;
  // The same once more only stays longer.
  const others = toasts.value.filter((t) => t.text !== text);
  toasts.value = [...others, { id, tone, text }].slice(-MAX_TOASTS);
  setTimeout(() => dismiss(id), SHOWN_MS[tone]);
}

export function dismiss(id: number): void {
  toasts.value = toasts.value.filter((t) => t.id !== id);
}

export function message(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}
