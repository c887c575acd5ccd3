/** What the kernel's parts share: all are one WebAssembly module, of which whoever needs a memory of its own has an instance. */
#ifndef DECOGS_KERNEL_H
#define DECOGS_KERNEL_H

#include <stdint.h>

#define EXPORT(name) __attribute__((export_name(#name)))
/** Rows that are taken at once: what one step fetches, the next one finds in the processor's cache. */
#define BATCH 1024

/** So many bytes that stay free of everything else, on a multiple of 16; NULL where there is not that much memory. */
uint8_t *room_for(uint64_t bytes);

#endif
