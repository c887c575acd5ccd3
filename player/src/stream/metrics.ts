/** PSNR of frames from METRICS packets. */

import type { FrameMetrics } from "../scene";

const MAX_BYTES = 4096;

/**
 * SPEC.md gives METRICS packets no meaning; where one is a JSON object with a number `psnr`, that is shown for the frame
 * that the packet is about. Anything else is passed over.
 */
export function readMetricsPayload(payload: Uint8Array): FrameMetrics | null {
  if (payload.length > MAX_BYTES) return null;
  try {
    const told: unknown = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(payload));
    if (typeof told !== "object" || told === null || !("psnr" in told)) return null;
    return typeof told.psnr === "number" && Number.isFinite(told.psnr) ? { psnr: told.psnr } : null;
  } catch {
    return null;
  }
}
