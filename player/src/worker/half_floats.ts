/** Half-precision floats (IEEE 754 binary16) by tables over the upper nine bits of a float32 (van der Zijp 2008). */

const base = new Uint16Array(512);
const shift = new Uint8Array(512);
for (let i = 0; i < 256; i++) {
  const exponent = i - 127;
  const [bits, drop] =
    exponent < -25
      ? [0, 24]
      : exponent < -14
        ? [0x0400 >> (-exponent - 14), -exponent - 1]
        : exponent <= 15
          ? [(exponent + 15) << 10, 13]
          : [0x7bff, 24]; // what is too large becomes the largest: infinities have no place in a scene
  base[i] = bits;
  base[i | 256] = bits | 0x8000;
  shift[i] = shift[i | 256] = drop;
}

const float = new Float32Array(1);
const bits = new Uint32Array(float.buffer);

/** The sixteen bits of the half nearest to a number, ties away from zero; up to 65504. */
export function halfBits(value: number): number {
  float[0] = value;
  const word = bits[0];
  const head = word >>> 23;
  const drop = shift[head];
  const mantissa = word & 0x7fffff;
  const whole = base[head] + (mantissa >> drop);
  // The carry of rounding runs into the exponent, as it should; not beyond the largest.
  const up = drop < 24 ? (mantissa >> (drop - 1)) & 1 : 0;
  return (whole & 0x7fff) < 0x7bff ? whole + up : whole;
}
