/** A stream read in its order from the first byte to the last, strictly: what conformance is measured with. */

import { createHash } from "node:crypto";
import { StreamError, refuse } from "../../src/container/errors";
import { readHeader } from "../../src/container/header";
import { readEnd, readIndex, type IndexEntry } from "../../src/container/indexPacket";
import { DEFAULT_LIMITS, type Limits } from "../../src/container/limits";
import {
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
} from "../../src/container/packets";
import { Decoder, type Step } from "../../src/state/decoder";
import { combine } from "../../src/state/digest";
import type { CameraCorrection, StreamHeader } from "../../src/scene";
import type { ExpectedFrame } from "./vectors";

export interface Outcome {
  readonly frames: ExpectedFrame[];
  readonly failure: StreamError | null;
  readonly indexes: boolean[];
  readonly header: StreamHeader | null;
}

interface Reading {
  header: StreamHeader | null;
  decoder: Decoder | null;
  readonly frames: ExpectedFrame[];
  readonly entries: IndexEntry[];
  readonly indexes: boolean[];
}

export function readInOrder(data: Uint8Array, limits: Limits = DEFAULT_LIMITS): Outcome {
  const reading: Reading = { header: null, decoder: null, frames: [], entries: [], indexes: [] };
  let failure: StreamError | null = null;
  try {
    readPackets(data, limits, reading);
  } catch (error) {
    if (!(error instanceof StreamError)) throw error;
    failure = error;
  }
  return { frames: reading.frames, failure, indexes: reading.indexes, header: reading.header };
}

function readPackets(data: Uint8Array, limits: Limits, reading: Reading): void {
  located(null, 0, () => {
    checkPrologue(data);
  });
  let offset = PROLOGUE_BYTES;
  let ended = false;
  for (let number = 0; number === 0 || offset < data.length; number++) {
    const { kind, payload, frame } = located(number, offset, () => {
      if (ended) refuse("trailing-data", "bytes follow the end packet");
      const packet = readPacket(data.subarray(offset), limits, number === 0);
      take(packet, offset, limits, reading);
      return packet;
    });
    if (frameKind(kind) !== null) reading.entries.push({ offset, frame, kind });
    ended = kind === KIND.END;
    offset += PACKET_OVERHEAD + payload.length;
  }
}

function located<T>(packet: number | null, offset: number, step: () => T): T {
  try {
    return step();
  } catch (error) {
    throw error instanceof StreamError ? error.at(packet, offset) : error;
  }
}

interface Packet {
  readonly kind: number;
  readonly frame: number;
  readonly payload: Uint8Array;
}

function readPacket(data: Uint8Array, limits: Limits, first: boolean): Packet {
  checkSync(data.subarray(0, 4));
  if (data.length < PACKET_HEADER_BYTES) refuse("truncated", "the stream stops inside a packet header");
  const { kind, frame, length } = readPacketHeader(data.subarray(0, PACKET_HEADER_BYTES), limits.payloadBytes);
  checkOrder(kind, first);
  return { kind, frame, payload: readPayload(data, length) };
}

function take({ kind, frame, payload }: Packet, offset: number, limits: Limits, reading: Reading): void {
  const named = frameKind(kind);
  if (kind === KIND.HEADER) {
    reading.header = readHeader(payload);
    reading.decoder = new Decoder(reading.header, limits);
  } else if (kind === KIND.INDEX) {
    reading.indexes.push(isRight(payload, offset, reading.entries));
  } else if (kind === KIND.END) {
    if (readEnd(payload).frames !== reading.entries.length) refuse("index-mismatch", "the end packet counts others");
  } else if (named !== null) {
    const step = reading.decoder!.apply({ kind: named, frame, payload });
    reading.frames.push(hashes(reading.decoder!, step, reading.header!));
  }
}

function isRight(payload: Uint8Array, offset: number, entries: readonly IndexEntry[]): boolean {
  try {
    const listed = readIndex(payload, offset);
    return listed.every((entry, i) => {
      const { offset: place, frame, kind } = entries[i];
      return entry.offset === place && entry.frame === frame && entry.kind === kind;
    });
  } catch {
    return false;
  }
}

/** As tests/conformance/README.md defines them. */
export function hashes(decoder: Decoder, step: Pick<Step, "corrections">, header: StreamHeader): ExpectedFrame {
  const state = decoder.integers!;
  const { count, width } = state;
  const places = Uint32Array.from({ length: count }, (_, row) => (state.inOrder ? row : state.order[row]));
  const rowBytes = 8 + 4 * width;
  const integers = new DataView(new ArrayBuffer(12 + rowBytes * count));
  integers.setBigUint64(0, state.nextId, true);
  integers.setUint32(8, count, true);
  places.forEach((place, row) => {
    let at = 12 + rowBytes * row;
    integers.setBigUint64(at, state.id(row), true);
    at += 8;
    for (let c = 0; c < width; c++, at += 4) integers.setInt32(at, state.integers[width * place + c], true);
  });
  const corrections = told(step, header);
  return {
    ...(corrections ? { corrections } : {}),
    gaussians: count,
    digest: combine(state.sum, count, state.nextId).toString(16).padStart(16, "0"),
    integers: sha256(integers),
    floats: floatsHash(decoder, places),
  };
}

/** The hash of a frame's floats, in the order of its rows. */
export function hashOf({ gaussians }: Pick<Decoder, "gaussians">): string {
  const places = gaussians.order ?? Uint32Array.from({ length: gaussians.count }, (_, row) => row);
  return floatsHash({ gaussians }, places);
}

function floatsHash(decoder: Pick<Decoder, "gaussians">, places: Uint32Array): string {
  const { means, logScales, quaternions, opacityLogits, sh, count } = decoder.gaussians;
  const arrays: [Float32Array, number][] = [
    [means, 3],
    [logScales, 3],
    [quaternions, 4],
    [opacityLogits, 1],
    [sh, count === 0 ? 0 : shWidth(sh, opacityLogits)],
  ];
  const width = arrays.reduce((sum, [, channels]) => sum + channels, 0);
  const floats = new Float32Array(width * count);
  places.forEach((place, row) => {
    let at = width * row;
    for (const [array, channels] of arrays) {
      for (let c = 0; c < channels; c++) floats[at++] = array[channels * place + c];
    }
  });
  return sha256(floats);
}

function shWidth(sh: Float32Array, opacityLogits: Float32Array): number {
  return sh.length / opacityLogits.length;
}

const FIELDS: Record<string, readonly (readonly [string, keyof CameraCorrection])[]> = {
  exposure_drift: [["exposure", "exposure"]],
  white_balance_drift: [["red", "red"], ["blue", "blue"]],
  camera_shake: [["yaw", "yaw"], ["pitch", "pitch"], ["roll", "roll"]],
  lamp_flicker: [["lamp_phase", "lampPhase"], ["lamp_amplitude", "lampAmplitude"]],
};

/** Numbers that the stream tells; those that it does not must be 0. */
function told({ corrections }: Pick<Step, "corrections">, { corrected }: StreamHeader): ExpectedFrame["corrections"] {
  if (corrections.size === 0) return undefined;
  const numbers: Record<string, Record<string, number>> = {};
  for (const [name, correction] of corrections) {
    numbers[name] = {};
    for (const [effect, fields] of Object.entries(FIELDS)) {
      const isTold = corrected.get(effect)?.includes(name) === true;
      for (const [told, field] of fields) {
        if (isTold) numbers[name][told] = correction[field];
        else if (correction[field] !== 0) throw new Error(`${name} has ${field}, of which nothing is told`);
      }
    }
  }
  return numbers;
}

function sha256(data: NodeJS.ArrayBufferView): string {
  return createHash("sha256").update(data).digest("hex");
}
