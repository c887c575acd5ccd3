/** Rows that the kernel takes at once: what one step fetches, the next one finds in the processor's cache. */
export const BATCH = 1024;
