/** A stream's beginning, and the index at its end. */

import { StreamError, isDamage, refuse } from "../container/errors";
import { readHeader } from "../container/header";
import { readEnd, readIndex, readLayersIndex, type IndexEntry } from "../container/indexPacket";
import { MAX_HEADER_BYTES, type Limits } from "../container/limits";
import {
  END_PACKET_BYTES,
  KIND,
  PACKET_HEADER_BYTES,
  PACKET_OVERHEAD,
  PROLOGUE_BYTES,
  checkOrder,
  checkPrologue,
  checkSync,
  frameKind,
  readPacketHeader,
  readPayload,
} from "../container/packets";
import { startKernel } from "../kernel/module";
import type { StreamHeader } from "../scene";
import { FrameTable } from "./frameTable";
import type { ByteSource } from "./sources";

export interface Opening {
  readonly header: StreamHeader;
  /** Stream offset behind the header packet. */
  readonly end: number;
}

/** Prologue and header packet. */
export async function readOpening(source: ByteSource, limits: Limits, signal?: AbortSignal): Promise<Opening> {
  const [head] = await Promise.all([source.read(0, PROLOGUE_BYTES + PACKET_HEADER_BYTES, signal), startKernel()]);
  located(null, 0, () => {
    checkPrologue(head.subarray(0, PROLOGUE_BYTES));
  });
  const length = located(0, PROLOGUE_BYTES, () => headerLength(head.subarray(PROLOGUE_BYTES), limits));
  const packet = await source.read(PROLOGUE_BYTES, PACKET_OVERHEAD + length, signal);
  const header = located(0, PROLOGUE_BYTES, () => readHeader(readPayload(packet, length)));
  return { header, end: PROLOGUE_BYTES + PACKET_OVERHEAD + length };
}

function headerLength(head: Uint8Array, limits: Limits): number {
  checkSync(head);
  if (head.length < PACKET_HEADER_BYTES) refuse("truncated", "the stream stops before its header is complete");
  const { kind, length } = readPacketHeader(head, limits.payloadBytes);
  checkOrder(kind, true);
  if (length > MAX_HEADER_BYTES) refuse("too-large", `a header of ${length} bytes is above the limit`);
  return length;
}

function located<T>(packet: number | null, offset: number, step: () => T): T {
  try {
    return step();
  } catch (error) {
    throw error instanceof StreamError ? error.at(packet, offset) : error;
  }
}

/** The frames that the index at the stream's end lists; null when there is none that can be used. */
export async function readIndexAtEnd(
  source: ByteSource,
  opening: Opening,
  limits: Limits,
  signal?: AbortSignal,
): Promise<FrameTable | null> {
  const { size } = source;
  if (size === null || size < opening.end + END_PACKET_BYTES) return null;
  try {
    const end = await packetOf(source, KIND.END, size - END_PACKET_BYTES, END_PACKET_BYTES, limits, signal);
    const { frames, indexOffset } = readEnd(end);
    const room = size - END_PACKET_BYTES - indexOffset;
    if (indexOffset < opening.end || room < PACKET_OVERHEAD) return null;
    const payload = await packetOf(source, KIND.INDEX, indexOffset, room, limits, signal);
    const layersOffset = indexOffset + PACKET_OVERHEAD + payload.length;
    const layers = opening.header.layers.length > 0 ? await layersAt(source, layersOffset, size - END_PACKET_BYTES, limits, signal) : [];
    return tableOf(readIndex(payload, indexOffset), layers, frames, opening.end, indexOffset);
  } catch (error) {
    if (isDamage(error) || (error instanceof StreamError && error.reason === "reserved-bits")) return null;
    throw error;
  }
}

async function packetOf(
  source: ByteSource,
  kind: number,
  offset: number,
  room: number,
  limits: Limits,
  signal?: AbortSignal,
): Promise<Uint8Array> {
  const head = await source.read(offset, PACKET_HEADER_BYTES, signal);
  if (head.length < PACKET_HEADER_BYTES) refuse("truncated", "the stream stops inside a packet header");
  const header = readPacketHeader(head, limits.payloadBytes);
  if (header.kind !== kind || PACKET_OVERHEAD + header.length > room) refuse("index-mismatch", "no index is here");
  return readPayload(await source.read(offset, PACKET_OVERHEAD + header.length, signal), header.length);
}

/** Where refinements lie; none where that cannot be read, since the base plays without. */
async function layersAt(source: ByteSource, offset: number, end: number, limits: Limits, signal?: AbortSignal): Promise<IndexEntry[]> {
  if (offset + PACKET_OVERHEAD > end) return [];
  try {
    return readLayersIndex(await packetOf(source, KIND.LAYERS, offset, end - offset, limits, signal));
  } catch (error) {
    if (isDamage(error) || (error instanceof StreamError && error.reason !== null)) return [];
    throw error;
  }
}

/** A frame's bytes are taken to reach up to the next packet that is listed: what stands between them is read with it. */
function tableOf(
  index: readonly IndexEntry[],
  layers: readonly IndexEntry[],
  frames: number,
  start: number,
  end: number,
): FrameTable | null {
  const table = new FrameTable();
  if (index.length !== frames || (frames > 0 && index[0].offset < start)) return null;
  const listed = Float64Array.from([...index, ...layers], ({ offset }) => offset).sort();
  const next = new Map(Array.from(listed, (offset, i) => [offset, listed[i + 1] ?? end] as const));
  for (const [i, { offset, frame, kind }] of index.entries()) {
    if (frame !== i) return null;
    table.add(frameKind(kind)!, offset, next.get(offset)! - offset);
  }
  const first = layers.filter(({ kind, offset, frame }) => kind === 1 && frame < frames && offset >= start && offset < end);
  table.refinements = new Map(first.map(({ offset, frame }) => [frame, { offset, bytes: next.get(offset)! - offset }]));
  return table;
}
