/** Tracks of sound in the header, and the SOUND packets that hold them (SPEC sections 4 and 6). */
import { JsonNumber, type JsonValue } from "./json";
import type { SoundPacket, SoundTrack } from "../scene";
import type { Vector } from "../geometry/vectors";

/** Samples a second. */
export const RATE = 48_000;
/** Samples of a block. */
export const BLOCK = 960;
/** Samples before a place from which a decoder is to be run to be right there. */
export const PRE_ROLL = 10 * BLOCK;
/** Samples by which a packet may miss the end of the one before and still go on with it. */
export const CONTINUES = 48;
const MAX_TRACKS = 16;
const MAX_TITLE = 65_536;
const MAX_COORDINATE = 1e12;
const MAX_BLOCK_BYTES = 1276;
const MAX_BLOCKS = 1024;
/** Packets of a frame that are looked at. */
export const MAX_PACKETS = 64;
const SLOWEST = 1;

/** The list in the header; empty where it, or any entry, is out of bounds. */
export function readSoundTracks(value: JsonValue | undefined, fps: number | null): SoundTrack[] {
  if (!Array.isArray(value) || value.length > MAX_TRACKS || fps === null || fps < SLOWEST) return [];
  const tracks = value.flatMap((entry) => trackOf(entry) ?? []);
  return tracks.length === value.length ? tracks : [];
}

function trackOf(entry: JsonValue): SoundTrack | null {
  if (!(entry instanceof Map)) return null;
  const [codec, channels, position, title] = ["codec", "channels", "position", "title"].map((name) => entry.get(name));
  const count = channels instanceof JsonNumber && channels.integer ? channels.value : 0;
  if (codec !== "opus" || (count !== 1 && count !== 2)) return null;
  if (title !== undefined && (typeof title !== "string" || Array.from(title).length > MAX_TITLE)) return null;
  if (position === undefined) return { channels: count, position: null };
  if (!Array.isArray(position) || position.length !== 3) return null;
  const coordinates = position.flatMap((each) => (each instanceof JsonNumber && Math.abs(each.value) <= MAX_COORDINATE ? [each.value] : []));
  return coordinates.length === 3 ? { channels: count, position: coordinates as unknown as Vector } : null;
}

/** null for a packet that is damaged, or of a track that there is not. Bytes are the packet's own, copied. */
export function readSoundPacket(payload: Uint8Array, tracks: number): SoundPacket | null {
  const view = new DataView(payload.buffer, payload.byteOffset, payload.byteLength);
  if (payload.length < 5 || payload[0] >= tracks) return null;
  const blocks: Uint8Array<ArrayBuffer>[] = [];
  for (let at = 5; at < payload.length; ) {
    if (at + 2 > payload.length) return null;
    const length = view.getUint16(at, true);
    if (blocks.length === MAX_BLOCKS || length < 1 || length > MAX_BLOCK_BYTES || at + 2 + length > payload.length) return null;
    blocks.push(payload.slice(at + 2, at + 2 + length));
    at += 2 + length;
  }
  return blocks.length > 0 ? { track: payload[0], offset: view.getInt32(1, true), blocks } : null;
}

/** The sample with which a frame begins. */
export function frameStart(frame: number, fps: number): number {
  return Math.floor((frame * RATE) / fps + 0.5);
}

/** How many frames before a place have to be read for what is heard there. */
export function framesBefore(fps: number): number {
  return Math.ceil(((PRE_ROLL + BLOCK) * fps) / RATE);
}
