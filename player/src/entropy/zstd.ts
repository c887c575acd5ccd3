/** One zstd frame (RFC 8878) as SPEC section 6, "Coded block", allows it. */

import { ZSTDDecoder } from "zstddec";
import { refuse } from "../container/errors";
import { MAX_ZSTD_WINDOW } from "../container/limits";

const MAGIC = 0xfd2fb528;
const library = new ZSTDDecoder();
const CONTENT_SIZE_BYTES = [0, 2, 4, 8];
const DICTIONARY_BYTES = [0, 1, 2, 4];

let started: Promise<unknown> | null = null;

/** Compiles the library, once; before this is done nothing can be decoded. */
export function startZstd(): Promise<unknown> {
  return (started ??= library.init());
}

/**
 * The content of a frame of `least` to `most` bytes.
 *
 * The library writes no more than the declared size, and takes several frames and skippable ones for one content; so
 * the size is checked before, and that the frame's blocks end where the data end.
 */
export function decompress(data: Uint8Array, least: number, most: number): Uint8Array {
  const { contentSize, blocks, checksum } = readFrameHeader(data);
  if (contentSize < Math.max(least, 1) || contentSize > most) bad("a zstd frame declares another size");
  if (endOfBlocks(data, blocks) + (checksum ? 4 : 0) !== data.length) bad("a zstd frame ends elsewhere");
  const content = decoded(data, contentSize);
  if (content.length !== contentSize) bad("a zstd frame is damaged");
  return content;
}

function decoded(data: Uint8Array, contentSize: number): Uint8Array {
  try {
    return library.decode(data, contentSize);
  } catch {
    return bad("a zstd frame is damaged");
  }
}

interface FrameHeader {
  readonly contentSize: number;
  /** Where the first block starts. */
  readonly blocks: number;
  readonly checksum: boolean;
}

function readFrameHeader(data: Uint8Array): FrameHeader {
  if (data.length < 5 || littleEndian(data, 0, 4) !== MAGIC) bad("no zstd frame starts where one must");
  const descriptor = data[4];
  const singleSegment = (descriptor & 0x20) !== 0;
  if (descriptor & 0x08) bad("a zstd frame has its reserved bit set");
  const windowBytes = singleSegment ? 0 : 1;
  const dictionaryBytes = DICTIONARY_BYTES[descriptor & 3];
  const sizeBytes = singleSegment && descriptor >> 6 === 0 ? 1 : CONTENT_SIZE_BYTES[descriptor >> 6];
  const blocks = 5 + windowBytes + dictionaryBytes + sizeBytes;
  if (sizeBytes === 0) bad("a zstd frame does not declare its size");
  if (blocks > data.length) bad("a zstd frame stops in its header");
  const dictionary = littleEndian(data, 5 + windowBytes, dictionaryBytes);
  const contentSize = littleEndian(data, blocks - sizeBytes, sizeBytes) + (sizeBytes === 2 ? 256 : 0);
  const window = singleSegment ? contentSize : windowSize(data[5]);
  if (window > MAX_ZSTD_WINDOW) bad("a zstd frame needs too large a window");
  if (dictionary !== 0) bad("a zstd frame needs a dictionary");
  return { contentSize, blocks, checksum: (descriptor & 4) !== 0 };
}

function windowSize(descriptor: number): number {
  const base = 2 ** (10 + (descriptor >> 3));
  return base + (base / 8) * (descriptor & 7);
}

/** Where the last block ends, by the sizes that block headers tell. */
function endOfBlocks(data: Uint8Array, start: number): number {
  let position = start;
  let last = false;
  while (!last) {
    if (position + 3 > data.length) bad("a zstd frame has no last block");
    const header = littleEndian(data, position, 3);
    const type = (header >> 1) & 3;
    if (type === 3) bad("a zstd frame has a block of a reserved type");
    position += 3 + (type === 1 ? 1 : header >> 3);
    last = (header & 1) !== 0;
  }
  return position;
}

function littleEndian(data: Uint8Array, offset: number, bytes: number): number {
  let value = 0;
  for (let i = bytes - 1; i >= 0; i--) value = value * 256 + data[offset + i];
  return value;
}

function bad(message: string): never {
  refuse("bad-compression", message);
}
