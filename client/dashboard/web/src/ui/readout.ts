// SPDX-License-Identifier: Apache-2.0
// The frame whose numbers are shown: eight times a second is as fast as they
// can be read; at once for who moves through time.
import { useEffect } from "preact/hooks";
import { useSignal } from "@preact/signals";
import type { App } from "../app/app";
import type { FrameRecord } from "../data/frame";

const REFRESH_MS = 125;

export function useReadout(app: App): FrameRecord | null {
  const { player } = app.model;
  const record = useSignal<FrameRecord | null>(player.current.peek());
  useEffect(() => {
    let callOff = () => {};
    const read = () => {
      record.value = player.current.peek();
      callOff = app.beat.after(REFRESH_MS, read);
    };
    read();
    return () => callOff();
  }, []);
  const now = record.value;
  return player.cursor.value === null ? now : player.current.value;
}
