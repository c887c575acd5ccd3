/**
 * The state's digest (SPEC section 5). The kernel keeps a linear form of every row's id and integers, so that a residual
 * costs one product, and tells sums of hashes; here is what there is one of in a frame.
 */

const MASK = (1n << 64n) - 1n;
const FIRST_FACTOR = 0xbf58476d1ce4e5b9n;
const SECOND_FACTOR = 0x94d049bb133111ebn;

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
