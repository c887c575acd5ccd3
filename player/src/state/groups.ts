/** The groups of attributes and their channels (SPEC section 1). */

export const GROUP = { MEANS: 0, LOG_SCALES: 1, QUATERNIONS: 2, OPACITY_LOGITS: 3, SH_DC: 4, SH_REST: 5 } as const;
export const GROUPS = 6;

/** Channels of each group, by its bit number. */
export function channelsOf(shDegree: number): readonly number[] {
  return [3, 3, 4, 1, 3, 3 * ((shDegree + 1) ** 2 - 1)];
}

/** Keys of the digest: that of the id is 0, then those of each group's channels, groups in bit order. */
export function firstKeys(channels: readonly number[]): readonly number[] {
  let key = 1;
  return channels.map((count) => {
    key += count;
    return key - count;
  });
}
