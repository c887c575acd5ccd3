/** Finds frames by following packet headers, and by searching past damage (SPEC section 7, "Damage"). */

import { StreamError, isDamage, refuse } from "../container/errors";
import { readEnd } from "../container/indexPacket";
import type { Limits } from "../container/limits";
import {
  KIND,
  PACKET_HEADER_BYTES,
  PACKET_OVERHEAD,
  SYNC,
  checkOrder,
  checkSync,
  frameKind,
  readPacketHeader,
  readPayload,
  type PacketHeader,
} from "../container/packets";
import type { FrameTable } from "./frameTable";
import type { ByteSource } from "./sources";

/** Places that are damaged, before a file counts as no stream at all. */
const MAX_DAMAGED_PLACES = 4096;
/** How often, on average, bytes may be part of a payload whose checksum is wrong: forged headers nest. */
const MAX_TIMES_CHECKED = 4;
const CHECKED_AT_LEAST = 1 << 20;
const SEARCH_CHUNK = 1 << 16;

interface Passed extends PacketHeader {
  readonly offset: number;
}

/** How a step went: on to the next packet, no further with what is there, or the stream's end. */
type Progress = "on" | "waiting" | "ended";

/** A walk along the packets of a source that starts at the first one behind the header packet. */
export class Walk {
  /** Whether the end packet was passed. */
  ended = false;
  /** Whether there was nothing more to walk along, but no end packet either. */
  waits = false;
  /** Damage that costs no frame as far as is known. */
  readonly notices: StreamError[] = [];
  /** Whether what is there ends inside a packet. */
  stopsInside = false;
  private previous: Passed | null = null;
  private searching = false;
  /** Damage since the last frame packet: what frames that are missing are missing for. */
  private damage: StreamError | null = null;
  private damages = 0;
  private checkedInVain = 0;

  /** `follows`: the source may grow, so that a packet that is not whole is no damage. */
  constructor(
    private readonly source: ByteSource,
    private readonly table: FrameTable,
    private offset: number,
    private readonly limits: Limits,
    private readonly follows: boolean,
    private readonly onMetrics: (header: PacketHeader, payload: Uint8Array) => void,
  ) {}

  /** Goes on until so many frames are known, or up to an offset, or until there is nothing more. */
  async until(frames: number, offset: number, signal?: AbortSignal): Promise<void> {
    while (this.table.length < frames && this.offset < offset) {
      signal?.throwIfAborted();
      const progress = await this.step(signal);
      this.waits = progress === "waiting";
      if (progress !== "on") return;
    }
  }

  private async step(signal?: AbortSignal): Promise<Progress> {
    if (this.searching) return this.search(signal);
    const head = await this.source.read(this.offset, PACKET_HEADER_BYTES, signal);
    if (this.ended) return this.afterEnd(head);
    try {
      return await this.packet(head, signal);
    } catch (error) {
      if (!isDamage(error)) throw error instanceof StreamError ? error.at(null, this.offset) : error;
      await this.damaged(error.at(null, this.offset), signal);
      return "on";
    }
  }

  private afterEnd(head: Uint8Array): Progress {
    if (head.length > 0 && this.damage?.reason !== "trailing-data") {
      this.damage = new StreamError("trailing-data", "bytes follow the end packet").at(null, this.offset);
      this.notices.push(this.damage);
    }
    return "ended";
  }

  private async packet(head: Uint8Array, signal?: AbortSignal): Promise<Progress> {
    checkSync(head);
    this.stopsInside = head.length > 0;
    if (head.length < PACKET_HEADER_BYTES) return "waiting";
    const header = readPacketHeader(head, this.limits.payloadBytes);
    checkOrder(header.kind, false);
    const bytes = PACKET_OVERHEAD + header.length;
    if (!(await this.hasBytes(bytes, signal))) return this.unfinishedPacket(signal);
    await this.pass({ ...header, offset: this.offset }, signal);
    this.offset += bytes;
    this.stopsInside = false;
    return "on";
  }

  private async hasBytes(bytes: number, signal?: AbortSignal): Promise<boolean> {
    if (this.source.size !== null) return this.offset + bytes <= this.source.size;
    return (await this.source.read(this.offset, bytes, signal)).length === bytes;
  }

  /** Inside a packet that will not become whole, another may start: then bytes are missing. */
  private async unfinishedPacket(signal?: AbortSignal): Promise<Progress> {
    if (this.follows) return "waiting";
    const start = this.offset;
    this.offset++;
    const progress = await this.search(signal);
    if (progress === "on") this.note(new StreamError("truncated", "a packet is not there in full").at(null, start));
    else this.offset = start;
    this.searching = false;
    return progress;
  }

  private async pass(packet: Passed, signal?: AbortSignal): Promise<void> {
    const kind = frameKind(packet.kind);
    if (kind !== null) {
      this.checkOrder(packet.frame);
      this.table.add(kind, packet.offset, PACKET_OVERHEAD + packet.length);
      this.damage = null;
    } else if (packet.kind === KIND.END) {
      const end = readEnd(await this.payload(packet, signal));
      if (end.frames > this.table.length) this.table.addLost(end.frames, this.missing(end.frames - 1));
      else if (end.frames < this.table.length) refuse("index-mismatch", "the end packet counts fewer frames");
      this.ended = true;
    } else if (packet.kind === KIND.METRICS) {
      this.onMetrics(packet, await this.payload(packet, signal));
    }
    this.previous = packet;
  }

  private async payload({ offset, length }: Passed, signal?: AbortSignal): Promise<Uint8Array> {
    return readPayload(await this.source.read(offset, PACKET_OVERHEAD + length, signal), length);
  }

  /** Frames that are missing before this one are lost; one that is not the next is passed over. */
  private checkOrder(frame: number): void {
    const expected = this.table.length;
    if (frame < expected) refuse("frame-order", `frame ${frame} comes where frame ${expected} must`);
    if (frame > expected) this.table.addLost(frame, this.missing(expected));
  }

  private missing(frame: number): StreamError {
    if (this.damage !== null) return this.damage;
    const error = new StreamError("frame-order", `the packet of frame ${frame} is missing`).at(null, this.offset);
    this.note(error);
    return error;
  }

  private async damaged(error: StreamError, signal?: AbortSignal): Promise<void> {
    const before = await this.damagedBefore(error, signal);
    this.note(before?.error ?? error);
    this.offset = (before?.offset ?? this.offset) + 1;
    this.searching = true;
  }

  /** Where no packet starts, the one before may have lost bytes: then its payload's checksum is wrong. */
  private async damagedBefore(
    { reason }: StreamError,
    signal?: AbortSignal,
  ): Promise<{ error: StreamError; offset: number } | null> {
    const { previous } = this;
    this.previous = null;
    if (previous === null || (reason !== "bad-sync" && reason !== "bad-header-crc")) return null;
    try {
      await this.payload(previous, signal);
      return null;
    } catch (error) {
      if (!isDamage(error)) throw error;
      this.checkedInVain += previous.length;
      if (this.checkedInVain > CHECKED_AT_LEAST + MAX_TIMES_CHECKED * (previous.offset + previous.length)) {
        refuse("too-large", "too many damaged packets overlap");
      }
      if (frameKind(previous.kind) !== null) this.table.removeLast();
      return { error: error.at(null, previous.offset), offset: previous.offset };
    }
  }

  private note(error: StreamError): void {
    this.damage = error;
    this.notices.push(error);
    if (++this.damages > MAX_DAMAGED_PLACES) refuse("too-large", "the stream is damaged in too many places");
  }

  /** Looks for the next intact packet header, byte by byte. */
  private async search(signal?: AbortSignal): Promise<Progress> {
    for (;;) {
      const chunk = await this.source.read(this.offset, SEARCH_CHUNK, signal);
      const start = this.headerIn(chunk);
      if (start !== null) {
        this.offset += start;
        this.searching = false;
        return "on";
      }
      if (chunk.length < SEARCH_CHUNK) return "waiting";
      this.offset += chunk.length - PACKET_HEADER_BYTES + 1;
    }
  }

  private headerIn(chunk: Uint8Array): number | null {
    const last = chunk.length - PACKET_HEADER_BYTES;
    for (let at = chunk.indexOf(SYNC[0]); at >= 0 && at <= last; at = chunk.indexOf(SYNC[0], at + 1)) {
      if (chunk[at + 1] === SYNC[1] && this.isHeader(chunk.subarray(at, at + PACKET_HEADER_BYTES))) return at;
    }
    return null;
  }

  private isHeader(head: Uint8Array): boolean {
    try {
      readPacketHeader(head, this.limits.payloadBytes);
      return true;
    } catch (error) {
      // What may not be concealed is met again, and raised, when the walk goes on here.
      return !isDamage(error);
    }
  }
}
