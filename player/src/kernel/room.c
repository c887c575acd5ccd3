/** An instance's memory beyond what the parts declare. */
#include "kernel.h"

#define PAGE 65536

extern uint8_t __heap_base;
static uint64_t next;

uint8_t *room_for(uint64_t bytes) {
    if (next == 0) next = ((uint64_t)(uintptr_t)&__heap_base + 15) / 16 * 16;
    const uint64_t start = next, end = start + (bytes + 15) / 16 * 16;
    // 62 integers and as many floats of 2^21 Gaussians, the most there may be, are a quarter of what 32 bits count.
    if (bytes > 0xf0000000u || end > 0xf0000000u) return 0;
    const uint64_t pages = (end + PAGE - 1) / PAGE, there = __builtin_wasm_memory_size(0);
    if (pages > there && __builtin_wasm_memory_grow(0, pages - there) == (uintptr_t)-1) return 0;
    next = end;
    return (uint8_t *)(uintptr_t)start;
}
