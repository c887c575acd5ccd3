/** The groups of attributes and their channels (SPEC section 1). */

export const GROUP = { MEANS: 0, LOG_SCALES: 1, QUATERNIONS: 2, OPACITY_LOGITS: 3, SH_DC: 4, SH_REST: 5 } as const;

/** Channels of each group, by its bit number. */
export function channelsOf(shDegree: number): readonly number[] {
  return [3, 3, 4, 1, 3, 3 * ((shDegree + 1) ** 2 - 1)];
}

/** Where each group's channels start among all: groups in bit order, channels in order. */
export function offsetsOf(channels: readonly number[]): readonly number[] {
  let offset = 0;
  return channels.map((count) => {
    offset += count;
    return offset - count;
  });
}
