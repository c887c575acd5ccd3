/**
 * The state's digest (SPEC section 5), kept up to date by what changes.
 *
 * A row's hash is `mix` of a linear form of its id and integers. The form is kept for every row, so that a residual costs
 * one product, whatever the row's other channels are. Numbers of 64 bits are two of 32, `low` and `high`; BigInt, which is
 * some fifty times slower, serves what there is one of in a frame.
 */

const MASK = (1n << 64n) - 1n;
const GOLDEN = 0x9e3779b97f4a7c15n;
const FIRST_FACTOR = 0xbf58476d1ce4e5b9n;
const SECOND_FACTOR = 0x94d049bb133111ebn;
const MAX_KEYS = 1 + 11 + 48;
const TWO_TO_32 = 2 ** 32;
/** Integers below this times 32 bits, and 32 bits more, are exact in a float64. */
const SMALL = 2 ** 20;

const KEYS = Array.from({ length: MAX_KEYS }, (_, j) => mix(BigInt(j + 1) * GOLDEN) | 1n);
const KEYS_LOW = Float64Array.from(KEYS, (key) => Number(key & 0xffffffffn));
const KEYS_HIGH = Int32Array.from(KEYS, (key) => Number(key >> 32n) | 0);

/** The linear forms of so many rows, modulo 2^64. */
export interface Forms {
  readonly low: Int32Array;
  readonly high: Int32Array;
}

export function mix(value: bigint): bigint {
  let z = value & MASK;
  z = ((z ^ (z >> 30n)) * FIRST_FACTOR) & MASK;
  z = ((z ^ (z >> 27n)) * SECOND_FACTOR) & MASK;
  return z ^ (z >> 31n);
}

/** Digest from the sum of all rows' hashes, the number of Gaussians and the next id. */
export function combine(sum: bigint, count: number, nextId: bigint): bigint {
  return mix(mix(mix(sum) + BigInt(count)) + nextId);
}

export function addModulo(sum: bigint, term: bigint): bigint {
  return (sum + term) & MASK;
}

/**
 * Adds to the form at a place what was summed up outside: the values times the low halves of their keys, an exact
 * float64, and times the high halves, modulo 2^32.
 */
export function addSums({ low, high }: Forms, place: number, ofLow: number, ofHigh: number): void {
  const sum = (low[place] >>> 0) + ofLow;
  low[place] = sum;
  high[place] += ofHigh + Math.floor(sum / TWO_TO_32);
}

/** So many products of a key's low half and a value below this, or its negative, are summed up exactly: a power of 2. */
export function largestSummed(terms: number): number {
  return 2 ** (20 - Math.ceil(Math.log2(Math.max(terms, 1))));
}

/** Adds key times value to the form at a place. */
function addProduct({ low, high }: Forms, place: number, key: number, value: number): void {
  if (value < SMALL && value > -SMALL) {
    const sum = (low[place] >>> 0) + KEYS_LOW[key] * value;
    low[place] = sum;
    high[place] += Math.imul(KEYS_HIGH[key], value) + Math.floor(sum / TWO_TO_32);
  } else {
    addLargeProduct({ low, high }, place, key, value);
  }
}

/** The same for values of 32 bits: two products of 16. */
function addLargeProduct(forms: Forms, place: number, key: number, value: number): void {
  addProduct(forms, place, key, value & 0xffff);
  const upper = value >> 16;
  const product = KEYS_LOW[key] * upper;
  const productHigh = Math.imul(KEYS_HIGH[key], upper) + Math.floor(product / TWO_TO_32);
  const sum = (forms.low[place] >>> 0) + ((product << 16) >>> 0);
  forms.low[place] = sum;
  forms.high[place] += ((productHigh << 16) | ((product | 0) >>> 16)) + Math.floor(sum / TWO_TO_32);
}

/** Adds key times the difference of two integers, which is up to 2^32. */
export function addDifference(forms: Forms, place: number, key: number, after: number, before: number): void {
  addProduct(forms, place, key, (after - before) | 0);
  const wraps = (after - before - ((after - before) | 0)) / TWO_TO_32;
  forms.high[place] += wraps * KEYS_LOW[key];
}

/** Low and high halves of so many keys. */
export function keysFrom(first: number, count: number): [Float64Array, Int32Array] {
  return [KEYS_LOW.slice(first, first + count), KEYS_HIGH.slice(first, first + count)];
}

/** Adds the id's product to the form at a place; the id is two unsigned numbers of 32 bits. */
export function addId(forms: Forms, place: number, idLow: number, idHigh: number): void {
  addDifference(forms, place, 0, idLow, 0);
  forms.high[place] += Math.imul(KEYS_LOW[0], idHigh);
}

/** The sum of the hashes of the rows at these places, of all or of some of them, modulo 2^64. */
export function sumOfHashes(
  { low: lows, high: highs }: Forms,
  places: Uint32Array,
  from = 0,
  to = places.length,
): bigint {
  let sumLow = 0;
  let sumHigh = 0;
  for (let i = from; i < to; i++) {
    let low = lows[places[i]];
    let high = highs[places[i]];
    // z ^= z >> 30, z *= FIRST_FACTOR
    low ^= (low >>> 30) | (high << 2);
    high ^= high >>> 30;
    high = (Math.imul(high, 0x1ce4e5b9) + Math.imul(low, 0xbf58476d) + upperHalf(low, 0x1ce4, 0xe5b9)) | 0;
    low = Math.imul(low, 0x1ce4e5b9);
    // z ^= z >> 27, z *= SECOND_FACTOR
    low ^= (low >>> 27) | (high << 5);
    high ^= high >>> 27;
    high = (Math.imul(high, 0x133111eb) + Math.imul(low, 0x94d049bb) + upperHalf(low, 0x1331, 0x11eb)) | 0;
    low = Math.imul(low, 0x133111eb);
    // z ^= z >> 31
    sumLow += (low ^ ((low >>> 31) | (high << 1))) >>> 0;
    sumHigh += (high ^ (high >>> 31)) >>> 0;
  }
  return (BigInt(sumLow) + (BigInt(sumHigh) << 32n)) & MASK;
}

/** The upper 32 bits of an unsigned product; the factor is two numbers of 16 bits. */
function upperHalf(value: number, factorHigh: number, factorLow: number): number {
  const low = value & 0xffff;
  const high = value >>> 16;
  const lowLow = Math.imul(low, factorLow);
  const highLow = Math.imul(high, factorLow);
  const lowHigh = Math.imul(low, factorHigh);
  const middle = (lowLow >>> 16) + (highLow & 0xffff) + (lowHigh & 0xffff);
  return (Math.imul(high, factorHigh) + (highLow >>> 16) + (lowHigh >>> 16) + (middle >>> 16)) | 0;
}
