/** Streams put together from packets of others, for what no conformance stream is large or damaged enough for. */

import { crc32 } from "../../src/kernel/blocks";
import { KIND, PACKET_OVERHEAD, PROLOGUE_BYTES } from "../../src/container/packets";
import { joined } from "../../src/stream/bytes";

export interface Packet {
  readonly kind: number;
  readonly frame: number;
  readonly offset: number;
  readonly bytes: Uint8Array;
}

/** The packets of an intact stream. */
export function packetsOf(stream: Uint8Array): Packet[] {
  const view = new DataView(stream.buffer, stream.byteOffset);
  const packets: Packet[] = [];
  for (let offset = PROLOGUE_BYTES; offset < stream.length; ) {
    const end = offset + PACKET_OVERHEAD + view.getUint32(offset + 12, true);
    const bytes = stream.slice(offset, end);
    packets.push({ kind: bytes[4], frame: view.getUint32(offset + 8, true), offset, bytes });
    offset = end;
  }
  return packets;
}

export function packet(kind: number, frame: number, payload: Uint8Array): Uint8Array {
  const bytes = new Uint8Array(PACKET_OVERHEAD + payload.length);
  const view = new DataView(bytes.buffer);
  bytes.set([0x44, 0x47, 0x53, 0x50, kind, kind <= KIND.SKIP ? 1 : 0]);
  view.setUint32(8, frame, true);
  view.setUint32(12, payload.length, true);
  view.setUint32(16, crc32(bytes.subarray(0, 16)), true);
  bytes.set(payload, 20);
  view.setUint32(20 + payload.length, crc32(payload), true);
  return bytes;
}

/** A stream of these packets behind the prologue, with an index and an end packet. */
export function finished(prologue: Uint8Array, packets: readonly Uint8Array[]): Uint8Array {
  const parts = [prologue, ...packets];
  const entries: [number, Uint8Array][] = [];
  let offset = prologue.length;
  for (const bytes of packets) {
    if (bytes[4] >= KIND.KEY && bytes[4] <= KIND.SKIP) entries.push([offset, bytes]);
    offset += bytes.length;
  }
  const index = new DataView(new ArrayBuffer(4 + 16 * entries.length));
  index.setUint32(0, entries.length, true);
  entries.forEach(([place, bytes], i) => {
    index.setBigUint64(4 + 16 * i, BigInt(place), true);
    index.setUint32(12 + 16 * i, new DataView(bytes.buffer, bytes.byteOffset).getUint32(8, true), true);
    index.setUint8(16 + 16 * i, bytes[4]);
  });
  const end = new DataView(new ArrayBuffer(12));
  end.setUint32(0, entries.length, true);
  end.setBigUint64(4, BigInt(offset), true);
  parts.push(packet(KIND.INDEX, 0, new Uint8Array(index.buffer)), packet(KIND.END, 0, new Uint8Array(end.buffer)));
  return joined(parts);
}

/** The same frames, with a PSNR of 30 dB and the frame's number behind each. */
export function measured(stream: Uint8Array): Uint8Array {
  const packets = packetsOf(stream).filter(({ kind }) => kind <= KIND.SKIP);
  const figures = (frame: number): Uint8Array => packet(KIND.METRICS, frame, new TextEncoder().encode(`{"psnr": ${30 + frame}}`));
  return finished(
    stream.slice(0, PROLOGUE_BYTES),
    packets.flatMap(({ bytes, kind, frame }) => (kind === KIND.HEADER ? [bytes] : [bytes, figures(frame)])),
  );
}

/** The same frames, with so many bytes that nobody needs behind each. */
export function padded(stream: Uint8Array, bytes: number): Uint8Array {
  const packets = packetsOf(stream).filter(({ kind }) => kind <= KIND.SKIP);
  const filling = packet(200, 0, new Uint8Array(bytes));
  return finished(
    stream.slice(0, PROLOGUE_BYTES),
    packets.flatMap(({ bytes: own, kind }) => (kind === KIND.HEADER ? [own] : [own, filling])),
  );
}
