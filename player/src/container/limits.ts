/** Limits of SPEC section 8. */

export const MAX_PAYLOAD_BYTES = 268_435_456;
export const MAX_HEADER_BYTES = 1_048_576;
export const MAX_HEADER_NESTING = 16;
export const MAX_CAMERAS = 1024;
export const MAX_IMAGE_SIDE = 32_768;
export const MAX_ZSTD_WINDOW = 8_388_608;
/** 2^63: ids and the next id are below it. */
export const ID_END = 1n << 63n;

/** Limits that a reader may set. */
export interface Limits {
  readonly payloadBytes: number;
  readonly gaussians: number;
}

export const DEFAULT_LIMITS: Limits = { payloadBytes: MAX_PAYLOAD_BYTES, gaussians: 2_097_152 };
