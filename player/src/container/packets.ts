/** Prologue and packets (SPEC section 3). */

import { crc32 } from "../kernel/blocks";
import type { FrameKind } from "../scene";
import { refuse } from "./errors";

export const KIND = { HEADER: 1, KEY: 2, DELTA: 3, SKIP: 4, INDEX: 5, END: 6, METRICS: 7, SOUND: 8, REFINE: 9, LAYERS: 10 } as const;

export const PROLOGUE_BYTES = 16;
export const PACKET_HEADER_BYTES = 20;
/** Of a packet: all but the payload. */
export const PACKET_OVERHEAD = 24;
export const END_PACKET_BYTES = 36;

/** "DGSP". */
export const SYNC: readonly number[] = [0x44, 0x47, 0x53, 0x50];
const SIGNATURE = [0x8b, 0x44, 0x47, 0x53, 0x0d, 0x0a, 0x1a, 0x0a];
const AS_TEXT = [
  [0x8b, 0x44, 0x47, 0x53, 0x0a, 0x1a, 0x0a],
  [0x8b, 0x44, 0x47, 0x53, 0x0d, 0x0d, 0x0a, 0x1a, 0x0d, 0x0a],
  [0x0b, 0x44, 0x47, 0x53, 0x0d, 0x0a, 0x1a, 0x0a],
];
const FRAME_KINDS: ReadonlyMap<number, FrameKind> = new Map([
  [KIND.KEY, "key"],
  [KIND.DELTA, "delta"],
  [KIND.SKIP, "skip"],
]);

export interface PacketHeader {
  readonly kind: number;
  readonly frame: number;
  /** Bytes of the payload. */
  readonly length: number;
}

/** null for a packet that holds no frame. */
export function frameKind(kind: number): FrameKind | null {
  return FRAME_KINDS.get(kind) ?? null;
}

/** Checks the stream's first bytes; fewer than 16 are a stream that stops there. */
export function checkPrologue(head: Uint8Array): void {
  checkSignature(head.subarray(0, 8));
  if (head.length < PROLOGUE_BYTES) refuse("truncated", "the stream stops inside its first 16 bytes");
  const view = viewOf(head);
  if (crc32(head.subarray(0, 12)) !== view.getUint32(12, true)) {
    refuse("bad-header-crc", "the checksum of the first 16 bytes is wrong");
  }
  const [major, minor] = [view.getUint8(8), view.getUint8(9)];
  if (major !== 1) refuse("unsupported-version", `bitstream version ${major}.${minor} is not known to this player`);
  if (view.getUint16(10, true) !== 0) refuse("reserved-bits", "reserved bits of the prologue are set");
}

function checkSignature(head: Uint8Array): void {
  if (beginAlike(head, SIGNATURE)) return;
  if (head.length >= 6 && AS_TEXT.some((form) => beginAlike(head, form))) {
    refuse("text-damage", "the file was transferred as text; transfer it again as binary");
  }
  refuse("bad-signature", "this is not a .dgs stream");
}

/** The header of a packet from its first 20 bytes, all of its fields checked. */
export function readPacketHeader(head: Uint8Array, maxPayload: number): PacketHeader {
  checkSync(head);
  const view = viewOf(head);
  if (crc32(head.subarray(0, 16)) !== view.getUint32(16, true)) {
    refuse("bad-header-crc", "the checksum of a packet header is wrong");
  }
  const kind = view.getUint8(4);
  const flags = view.getUint8(5);
  const frame = view.getUint32(8, true);
  const length = view.getUint32(12, true);
  if (flags > 1 || view.getUint16(6, true) !== 0 || frame >= 2 ** 31) {
    refuse("reserved-bits", "reserved bits of a packet header are set");
  }
  checkCritical(kind, flags);
  if (length > maxPayload) refuse("too-large", `a payload of ${length} bytes is above the limit of ${maxPayload}`);
  return { kind, frame, length };
}

/** What is there of a packet must begin as one does. */
export function checkSync(head: Uint8Array): void {
  if (!beginAlike(head, SYNC)) refuse("bad-sync", "no packet starts where one must");
}

function checkCritical(kind: number, critical: number): void {
  const defined = kind >= KIND.HEADER && kind <= KIND.SOUND;
  if (!defined && critical) refuse("unknown-critical", `packets of kind ${kind} are not known and must not be ignored`);
  if (defined && critical !== Number(kind <= KIND.SKIP)) refuse("reserved-bits", "a packet's critical bit is wrong");
}

/** The payload of a whole packet, its checksum verified. */
export function readPayload(packet: Uint8Array, length: number): Uint8Array {
  const end = PACKET_HEADER_BYTES + length;
  if (packet.length < end + 4) refuse("truncated", "the stream stops inside a packet");
  const payload = packet.subarray(PACKET_HEADER_BYTES, end);
  if (crc32(payload) !== viewOf(packet).getUint32(end, true)) {
    refuse("bad-payload-crc", "the checksum of a payload is wrong");
  }
  return payload;
}

/** The header packet comes first, and no other does (`first`: whether this is the stream's first packet). */
export function checkOrder(kind: number, first: boolean): void {
  if ((kind === KIND.HEADER) !== first) refuse("misplaced-packet", "a stream has one header packet, which comes first");
}

function beginAlike(bytes: Uint8Array, expected: readonly number[]): boolean {
  const length = Math.min(bytes.length, expected.length);
  for (let i = 0; i < length; i++) if (bytes[i] !== expected[i]) return false;
  return true;
}

function viewOf(bytes: Uint8Array): DataView {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}
