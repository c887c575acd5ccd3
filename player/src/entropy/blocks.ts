/** Coded blocks and varints (SPEC section 6). */

import { refuse } from "../container/errors";
import type { Fields } from "../container/fields";
import { decompress } from "./zstd";

/** The data of a block that decodes to `least` to `most` bytes. */
export function readBlock(fields: Fields, least: number, most = least): Uint8Array {
  const codec = fields.u8();
  if (codec > 1) refuse("unsupported-mode", `codec ${codec} is unknown`);
  const data = fields.take(fields.u32());
  if (codec === 1) return decompress(data, least, most);
  if (data.length < least || data.length > most) refuse("bad-payload", `a stored block has ${data.length} bytes`);
  return data;
}

/** A block of so many varints; numbers below 2^35. */
export function readVarints(fields: Fields, count: number): Float64Array {
  const block = readBlock(fields, count, 5 * count);
  const numbers = new Float64Array(count);
  let position = 0;
  for (let i = 0; i < count; i++) {
    let number = 0;
    let unit = 1;
    let byte: number;
    do {
      if (position === block.length) bad("a block of varints stops inside one");
      if (unit > 2 ** 28) bad("a varint has more than five bytes");
      byte = block[position++];
      number += (byte & 0x7f) * unit;
      unit *= 128;
    } while (byte & 0x80);
    if (byte === 0 && unit > 128) bad("a varint is longer than it needs to be");
    numbers[i] = number;
  }
  if (position < block.length) bad("a block of varints holds more of them than it should");
  return numbers;
}

function bad(message: string): never {
  refuse("bad-index-set", message);
}
