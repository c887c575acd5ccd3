/** The packet of a frame, read from where the table says that it lies. */

import { StreamError, refuse } from "../container/errors";
import type { Limits } from "../container/limits";
import {
  PACKET_HEADER_BYTES,
  PACKET_OVERHEAD,
  checkOrder,
  frameKind,
  readPacketHeader,
  readPayload,
  type PacketHeader,
} from "../container/packets";
import type { FramePacket } from "../state/decoder";
import type { FrameTable } from "./frameTable";
import type { ByteSource } from "./sources";

/** Told of each packet behind the frame's own. */
export type OnBeside = (header: PacketHeader, payload: Uint8Array) => void;

/** Raises StreamError, located: "index-mismatch" when another packet lies there. */
export async function readFramePacket(
  source: ByteSource,
  table: FrameTable,
  frame: number,
  limits: Limits,
  onBeside: OnBeside,
  signal?: AbortSignal,
): Promise<FramePacket> {
  const offset = table.offset(frame);
  const { kind, bytes } = table.entries[frame];
  try {
    const data = await source.read(offset, bytes, signal);
    const { header, payload } = readPacket(data, limits);
    const actual = frameKind(header.kind);
    if (actual === null || actual !== kind || header.frame !== frame) {
      refuse("index-mismatch", `the index says that frame ${frame} lies elsewhere`);
    }
    readBeside(data.subarray(PACKET_OVERHEAD + header.length), limits, onBeside);
    return { kind: actual, frame, payload };
  } catch (error) {
    throw error instanceof StreamError ? error.at(null, offset) : error;
  }
}

function readPacket(data: Uint8Array, limits: Limits): { header: PacketHeader; payload: Uint8Array } {
  if (data.length < PACKET_HEADER_BYTES) refuse("truncated", "the stream stops inside a packet header");
  const header = readPacketHeader(data.subarray(0, PACKET_HEADER_BYTES), limits.payloadBytes);
  checkOrder(header.kind, false);
  return { header, payload: readPayload(data, header.length) };
}

/** Reads the packets behind a frame's own, for which the index has no entry; what is wrong with them costs nothing. */
export async function findBeside(
  source: ByteSource,
  table: FrameTable,
  frame: number,
  limits: Limits,
  onBeside: OnBeside,
): Promise<void> {
  const offset = table.offset(frame);
  const next = frame + 1 < table.length ? table.offset(frame + 1) : -1;
  const bytes = next >= 0 ? next - offset : table.entries[frame].bytes;
  const head = await source.read(offset, PACKET_HEADER_BYTES);
  if (head.length < PACKET_HEADER_BYTES) return;
  let own: number;
  try {
    own = PACKET_OVERHEAD + readPacketHeader(head, limits.payloadBytes).length;
  } catch (error) {
    if (error instanceof StreamError) return; // the frame will say so itself
    throw error;
  }
  if (own < bytes) readBeside(await source.read(offset + own, bytes - own), limits, onBeside);
}

/** What is wrong in packets that hold no frame costs none. */
function readBeside(data: Uint8Array, limits: Limits, onBeside: OnBeside): void {
  try {
    for (let rest = data; rest.length > 0; ) {
      const { header, payload } = readPacket(rest, limits);
      onBeside(header, payload);
      rest = rest.subarray(PACKET_OVERHEAD + header.length);
    }
  } catch (error) {
    if (!(error instanceof StreamError)) throw error;
  }
}

/** Whether the packet headers lead from the frame before, or from the start, to where the table says that one lies. */
export async function leadsTo(
  source: ByteSource,
  table: FrameTable,
  frame: number,
  start: number,
  limits: Limits,
  signal?: AbortSignal,
): Promise<boolean> {
  const end = table.offset(frame);
  let offset = frame === 0 ? start : table.offset(frame - 1);
  try {
    while (offset < end) {
      const head = await source.read(offset, PACKET_HEADER_BYTES, signal);
      if (head.length < PACKET_HEADER_BYTES) return false;
      const header = readPacketHeader(head, limits.payloadBytes);
      if (frameKind(header.kind) !== null && header.frame !== frame - 1) return false;
      offset += PACKET_OVERHEAD + header.length;
    }
  } catch (error) {
    if (!(error instanceof StreamError) || error.reason === null) throw error;
    return false;
  }
  return offset === end;
}
