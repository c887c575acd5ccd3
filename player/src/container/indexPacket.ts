/** Index and end packet (SPEC section 3). */

import { refuse } from "./errors";
import { Fields } from "./fields";
import { PACKET_OVERHEAD, frameKind } from "./packets";

export interface IndexEntry {
  /** Stream offset of the packet's first byte. */
  readonly offset: number;
  readonly frame: number;
  readonly kind: number;
}

export interface EndFields {
  readonly frames: number;
  /** Stream offset of the index packet, 0 for none. */
  readonly indexOffset: number;
}

/** The entries of the index packet that lies at `ownOffset`; offsets must rise and lie before it. */
export function readIndex(payload: Uint8Array, ownOffset: number): IndexEntry[] {
  const fields = new Fields(payload);
  const count = fields.u32();
  if (count * 16 !== fields.rest) refuse("bad-payload", `${count} index entries do not fill their payload`);
  const entries: IndexEntry[] = [];
  for (let i = 0; i < count; i++) entries.push(readEntry(fields));
  for (let i = 0; i < count; i++) {
    const next = i + 1 < count ? entries[i + 1].offset : ownOffset;
    if (entries[i].offset + PACKET_OVERHEAD > next) refuse("index-mismatch", "the index is not in stream order");
  }
  return entries;
}

/** The entries of a layers packet: as those of an index, with the layer in place of the kind. */
export function readLayersIndex(payload: Uint8Array): IndexEntry[] {
  const fields = new Fields(payload);
  const count = fields.u32();
  if (count * 16 !== fields.rest) refuse("bad-payload", `${count} index entries do not fill their payload`);
  const entries: IndexEntry[] = [];
  for (let i = 0; i < count; i++) entries.push(readFields(fields));
  return entries;
}

function readFields(fields: Fields): IndexEntry {
  // Above 2^53 the number is rounded, and lies behind the index packet all the same.
  const entry = { offset: Number(fields.u64()), frame: fields.u32(), kind: fields.u8() };
  fields.take(3);
  return entry;
}

function readEntry(fields: Fields): IndexEntry {
  const entry = readFields(fields);
  if (frameKind(entry.kind) === null) refuse("index-mismatch", "the index lists a packet that holds no frame");
  return entry;
}

export function readEnd(payload: Uint8Array): EndFields {
  const fields = new Fields(payload);
  const end = { frames: fields.u32(), indexOffset: Number(fields.u64()) };
  fields.finish();
  return end;
}
