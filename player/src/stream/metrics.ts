/** PSNR of frames from METRICS packets. */

import type { Limits } from "../container/limits";
import { KIND, type PacketHeader } from "../container/packets";
import type { FrameMetrics } from "../scene";
import { findBeside } from "./framePackets";
import type { FrameTable } from "./frameTable";
import { Pauses } from "./pauses";
import type { ByteSource } from "./sources";

const MAX_BYTES = 4096;

/**
 * SPEC.md gives METRICS packets no meaning; where one is a JSON object with a number `psnr`, that is shown for the frame
 * that the packet is about. Anything else is passed over.
 */
export function readMetricsPayload(payload: Uint8Array): FrameMetrics | null {
  if (payload.length > MAX_BYTES) return null;
  try {
    const value: unknown = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(payload));
    if (typeof value !== "object" || value === null || !("psnr" in value)) return null;
    return typeof value.psnr === "number" && Number.isFinite(value.psnr) ? { psnr: value.psnr } : null;
  } catch {
    return null;
  }
}

export class Metrics {
  readonly byFrame = new Map<number, FrameMetrics>();
  /** Frames behind which was looked already. */
  private readonly sought = new Set<number>();

  /** Notes what a packet says, of whatever kind. */
  readonly note = (header: PacketHeader, payload: Uint8Array): void => {
    const metrics = header.kind === KIND.METRICS ? readMetricsPayload(payload) : null;
    if (metrics !== null) this.byFrame.set(header.frame, metrics);
  };

  /** Looks for those of frames from one on that lie before an offset, while that `goesOn`. */
  async find(source: ByteSource, table: FrameTable, from: number, end: number, limits: Limits, goesOn: () => boolean): Promise<void> {
    const pauses = new Pauses();
    for (let frame = from; frame < table.length && table.offset(frame) < end; frame++) {
      if (this.sought.has(frame)) continue;
      await pauses.take();
      if (!goesOn()) return;
      this.sought.add(frame);
      await findBeside(source, table, frame, limits, this.note);
    }
  }
}
