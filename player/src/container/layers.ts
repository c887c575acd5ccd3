/** Layers: the header's list, and REFINE packets (SPEC sections 4 and 6). */
import type { FrameKind, Layer } from "../scene";
import { refuse } from "./errors";
import { Fields } from "./fields";
import { JsonNumber, type JsonValue } from "./json";
import { frameKind } from "./packets";

/** The Gaussians of layer k have ids from k times this on. */
export const LAYER_IDS = 1n << 50n;
const MAX_LAYERS = 4;
const MAX_GAUSSIANS = 2 ** 27;
const MAX_BYTES = 1e9;
const MAX_PSNR = 200;

/** The list in the header; empty where it, or any entry, is out of bounds. */
export function readLayers(value: JsonValue | undefined): Layer[] {
  if (!Array.isArray(value) || value.length < 2 || value.length > MAX_LAYERS) return [];
  const layers = value.flatMap((entry, number) => layerOf(entry, number === value.length - 1) ?? []);
  return layers.length === value.length ? layers : [];
}

function layerOf(entry: JsonValue, isLast: boolean): Layer | null {
  if (!(entry instanceof Map)) return null;
  const gaussians = entry.get("gaussians");
  if (!(gaussians instanceof JsonNumber && gaussians.integer)) return null;
  const bytesPerFrame = within(entry.get("bytes_per_frame"), MAX_BYTES);
  const psnr = within(entry.get("psnr"), MAX_PSNR);
  if (within(gaussians, MAX_GAUSSIANS) === null || bytesPerFrame === null) return null;
  if (isLast ? entry.get("psnr") !== undefined : psnr === null) return null;
  return { gaussians: gaussians.value, bytesPerFrame, psnr };
}

function within(value: JsonValue | undefined, most: number): number | null {
  return value instanceof JsonNumber && value.value >= 0 && value.value <= most ? value.value : null;
}

/** One layer of a frame. */
export interface Refinement {
  readonly layer: number;
  /** Of its Gaussians and those of all layers below. */
  readonly digest: bigint;
  /** Of each layer below, a delta payload; empty for no change. */
  readonly alignments: readonly Uint8Array[];
  readonly kind: FrameKind;
  /** The payload of a packet of that kind, without corrections. */
  readonly block: Uint8Array;
}

export function readRefinement(payload: Uint8Array): Refinement {
  const fields = new Fields(payload);
  const layer = fields.u8();
  const kind = frameKind(fields.u8());
  const reserved = fields.u8() + fields.u8();
  if (layer < 1 || layer >= MAX_LAYERS || kind === null || reserved !== 0) refuse("bad-payload", "a refinement is of no layer");
  const digest = fields.u64();
  const alignments: Uint8Array[] = [];
  for (let below = 0; below < layer; below++) alignments.push(fields.take(fields.u32()));
  return { layer, digest, alignments, kind, block: fields.take(fields.rest) };
}
