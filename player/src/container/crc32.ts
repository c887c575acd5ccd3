/** CRC-32 of ISO 3309 and zlib, eight bytes a step (SPEC section 3). */

const TABLES = makeTables();

/** Table k, entry b: the checksum of byte b followed by k zero bytes. */
function makeTables(): Uint32Array[] {
  const first = new Uint32Array(256);
  for (let byte = 0; byte < 256; byte++) {
    let rest = byte;
    for (let bit = 0; bit < 8; bit++) rest = rest & 1 ? (rest >>> 1) ^ 0xedb88320 : rest >>> 1;
    first[byte] = rest;
  }
  const tables = [first];
  for (let k = 1; k < 8; k++) {
    const before = tables[k - 1];
    tables.push(before.map((rest) => first[rest & 255] ^ (rest >>> 8)));
  }
  return tables;
}

export function crc32(bytes: Uint8Array): number {
  const [t0, t1, t2, t3, t4, t5, t6, t7] = TABLES;
  let crc = 0xffffffff;
  let i = 0;
  for (const end = bytes.length - 7; i < end; i += 8) {
    crc =
      t7[(crc ^ bytes[i]) & 255] ^
      t6[((crc >>> 8) ^ bytes[i + 1]) & 255] ^
      t5[((crc >>> 16) ^ bytes[i + 2]) & 255] ^
      t4[(crc >>> 24) ^ bytes[i + 3]] ^
      t3[bytes[i + 4]] ^
      t2[bytes[i + 5]] ^
      t1[bytes[i + 6]] ^
      t0[bytes[i + 7]];
  }
  for (; i < bytes.length; i++) crc = t0[(crc ^ bytes[i]) & 255] ^ (crc >>> 8);
  return ~crc >>> 0;
}
