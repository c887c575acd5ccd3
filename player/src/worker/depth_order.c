/** Gaussians by depth, nearest first (depth_order.ts says how): depths a batch at a time, then the counting sort of all. */
#include "../kernel/kernel.h"

#define BINS 65536
#define INFINITE 0x7f800000u

static float sort_means[3 * BATCH];
static uint32_t starts[BINS + 1];
/** By row, the depth's float32; the rows in order. */
static union {
    float *depths;
    uint32_t *words;
} rows;
static uint32_t *order;
static uint32_t nearest, farthest;

EXPORT(sort_means_at) float *sort_means_at(void) { return sort_means; }
EXPORT(sort_order_at) uint32_t *sort_order_at(void) { return order; }

/** Room for so many rows; 0 where there is not that much memory. */
EXPORT(sort_reserve) uint32_t sort_reserve(uint32_t count) {
    rows.words = (uint32_t *)room_for(4 * (uint64_t)count);
    order = (uint32_t *)room_for(4 * (uint64_t)count);
    return rows.words != 0 && order != 0;
}

EXPORT(sort_begin) void sort_begin(void) {
    nearest = INFINITE;
    farthest = 0;
}

/** Depths of a batch, from row `from` on, for a view: computed in float64, rounded once. */
EXPORT(sort_depths) void sort_depths(uint32_t from, uint32_t count, double x, double y, double z, double offset) {
    for (uint32_t i = 0; i < count; i++) {
        const float *mean = sort_means + 3 * i;
        rows.depths[from + i] = (float)(x * mean[0] + y * mean[1] + z * mean[2] + offset);
        // Negative floats have the top bit set: as unsigned numbers they lie above every finite positive one.
        const uint32_t word = rows.words[from + i];
        if (word == 0 || word >= INFINITE) continue;
        if (word < nearest) nearest = word;
        if (word > farthest) farthest = word;
    }
}

/** Puts the rows before the camera in order; how many these are. */
EXPORT(sort_rows) uint32_t sort_rows(uint32_t count) {
    if (farthest < nearest) return 0;
    const uint32_t span = farthest - nearest;
    uint32_t drop = 0;
    while (span >> drop >= BINS) drop++;
    for (uint32_t bin = 0; bin <= BINS; bin++) starts[bin] = 0;
    // Words beyond the span lie behind the camera, or are no depths.
    for (uint32_t row = 0; row < count; row++) {
        const uint32_t above = rows.words[row] - nearest;
        if (above <= span) starts[(above >> drop) + 1]++;
    }
    for (uint32_t bin = 1; bin <= BINS; bin++) starts[bin] += starts[bin - 1];
    const uint32_t drawn = starts[BINS];
    for (uint32_t row = 0; row < count; row++) {
        const uint32_t above = rows.words[row] - nearest;
        if (above <= span) order[starts[above >> drop]++] = row;
    }
    return drawn;
}
