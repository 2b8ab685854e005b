// SPDX-License-Identifier: Apache-2.0
// How a long call tells how far it is.
import type { OnProgress, Progress } from "./types.js";

// How often a progress callback is called while the server works.
const POLL_MS = 100;

/** All that is known of an alignment before it is done. */
export const ALIGNING: Progress = { stage: "aligning", fraction: 0, note: "", bytesDone: 0, bytesTotal: 0 };

/** Does the work, and tells its progress meanwhile. */
export async function whileTelling<T>(
  progress: () => Progress,
  onProgress: OnProgress | undefined,
  cancel: () => void,
  work: () => Promise<T>,
): Promise<T> {
  let failure: { error: unknown } | undefined;
  const tell = (): void => {
    if (failure) return;
    try {
      onProgress?.(progress());
    } catch (error) {
      failure = { error };
      cancel();
    }
  };
  const timer = onProgress && setInterval(tell, POLL_MS);
  try {
    const result = await work();
    if (failure) throw failure.error;
    return result;
  } catch (error) {
    if (failure) throw failure.error;
    cancel(); // of a file that cannot be read
    throw error;
  } finally {
    clearInterval(timer);
  }
}
