// Front-to-back alpha compositing of one tile, per 4x4 block of pixels: C = sum_i T_i alpha_i c_i with transmittance
// T_i = prod_{j<i} (1 - alpha_j) (Kerbl 2023, equation 3).
#pragma once

#include "tiles.h"

namespace decogs {

constexpr int kBlocks = 16;  // 4x4 pixel blocks per tile, 4x4 of them

// State that the backward pass reads: one slot of 16 lanes per block, 16 blocks per tile.
struct Trace {
    std::vector<float> transmittance;  // per pixel, behind its last entry
    std::vector<int32_t> last;     // per pixel: one past the last composited entry of the tile's list
    std::vector<uint16_t> blocks;  // per entry: bit mask of the blocks that its ellipse overlaps

    void resize(const TileLists& lists) {
        transmittance.resize(static_cast<size_t>(lists.tiles()) * kBlocks * kLanes);
        last.resize(transmittance.size());
        blocks.resize(lists.entries.size());
    }
};

struct Planes {  // planar pictures, (channels, height, width); alpha and depth may be null
    float* rgb;
    float* alpha;
    float* depth;
    float background[3];
};

struct Block {  // pixel centres of a block, and the mask of its pixels inside the picture
    F x, y;
    M inside;
    int x0, y0;
};

DECOGS_INLINE Block block_of(int tile_x, int tile_y, int b, const Camera& cam) {
    Block block;
    block.x0 = tile_x * kTile + (b % 4) * 4;
    block.y0 = tile_y * kTile + (b / 4) * 4;
    float x[kLanes], y[kLanes];
    for (int i = 0; i < kLanes; ++i) {
        x[i] = static_cast<float>(block.x0 + i % 4) + 0.5f;
        y[i] = static_cast<float>(block.y0 + i / 4) + 0.5f;
    }
    block.x = load(x);
    block.y = load(y);
    block.inside = (block.x < static_cast<float>(cam.width)) & (block.y < static_cast<float>(cam.height));
    return block;
}

DECOGS_INLINE void write_block(float* plane, const Block& block, const Camera& cam, const F& value) {
    float lanes[kLanes];
    store(lanes, value);
    const int columns = std::min(4, cam.width - block.x0), rows = std::min(4, cam.height - block.y0);
    for (int j = 0; j < rows; ++j)
        for (int i = 0; i < columns; ++i) plane[static_cast<int64_t>(block.y0 + j) * cam.width + block.x0 + i] = lanes[4 * j + i];
}

DECOGS_INLINE F read_block(const float* plane, const Block& block, const Camera& cam) {
    float lanes[kLanes] = {0};
    const int columns = std::min(4, cam.width - block.x0), rows = std::min(4, cam.height - block.y0);
    for (int j = 0; j < rows; ++j)
        for (int i = 0; i < columns; ++i) lanes[4 * j + i] = plane[static_cast<int64_t>(block.y0 + j) * cam.width + block.x0 + i];
    return load(lanes);
}

// Centres of the upper left pixel of a tile's blocks, one lane per block.
struct TileCorners {
    F x, y;
};

DECOGS_INLINE TileCorners block_corners(int tile_x, int tile_y) {
    float x[kLanes], y[kLanes];
    for (int b = 0; b < kBlocks; ++b) {
        x[b] = static_cast<float>(tile_x * kTile + (b % 4) * 4) + 0.5f;
        y[b] = static_cast<float>(tile_y * kTile + (b / 4) * 4) + 0.5f;
    }
    return {load(x), load(y)};
}

// Bit mask of the tile's blocks that the ellipse overlaps.
DECOGS_INLINE uint16_t blocks_met(const Projected& g, const F& corner_x, const F& corner_y) {
    return static_cast<uint16_t>(bits(smallest_exponent(g, corner_x, corner_y, 3.0f) <= g.cut));
}

constexpr uint32_t kAhead = 16;  // prefetch distance in entries: ellipses are scattered in memory
constexpr int kBatch = 256;  // entries per batch: their ellipses fit into the L1 cache

// Compositing state of a block; `live`: pixels not finished yet.
struct Gathered {
    F transmittance, rgb[3], depth;
    M live;
    I last;
};

// Observer of the compositing weights alpha T, per pixel of a block. This one ignores them.
struct Unwatched {
    void begin(int) {}
    void note(int, int, const F&) {}
    void end(uint32_t, int) {}
};

// Composites onto block `b` the ellipses `drawn` of the batch that begins at entry `base` of the tile's list.
template <bool kDepth, class Watch>
DECOGS_INLINE void composite_block(Gathered& to, const Block& block, int b, const Projected* batch, const uint16_t* drawn, int count, int base,
                                   Watch& watch) {
    Gathered now = to;
    for (int k = 0; k < count; ++k) {
        const Projected& g = batch[drawn[k]];
        const F dx = block.x - g.x, dy = block.y - g.y;
        const F u = dx * g.p + dy * g.q, v = dy * g.r;
        const F exponent = u * u + v * v;
        M on = (exponent <= g.cut) & now.live;
        if (!any(on)) continue;
        const F alpha = min(exp2_negative(exponent) * g.opacity, kAlphaMax);
        const F next = now.transmittance * (1.0f - alpha);
        const M full = next < kTransmittanceMin;
        now.live = and_not(now.live, on & full);
        on = and_not(on, full);
        const F weight = select(on, alpha * now.transmittance, splat(0.0f));
        watch.note(b, drawn[k], weight);
        for (int c = 0; c < 3; ++c) now.rgb[c] = now.rgb[c] + weight * g.rgb[c];
        if (kDepth) now.depth = now.depth + weight * g.depth;
        now.transmittance = select(on, next, now.transmittance);
        now.last = select(on, splati(base + drawn[k] + 1), now.last);
        if (!any(now.live)) break;
    }
    to = now;
}

// Draws one tile. A trace records the state for the backward pass; `watch` observes the weights, batch by batch.
template <class Watch>
inline void composite_tile(const TileLists& lists, const Camera& cam, int tile, const Planes& out, Trace* trace, Watch& watch) {
    const int tile_x = tile % lists.columns, tile_y = tile / lists.columns;
    const uint32_t first = lists.first_entry[tile], count = lists.first_entry[tile + 1] - first;
    Block blocks[kBlocks];
    Gathered gathered[kBlocks];
    const F zero = splat(0.0f);
    for (int b = 0; b < kBlocks; ++b) {
        blocks[b] = block_of(tile_x, tile_y, b, cam);
        gathered[b] = {splat(1.0f), {zero, zero, zero}, zero, blocks[b].inside, splati(0)};
    }
    const TileCorners corners = block_corners(tile_x, tile_y);
    Projected batch[kBatch];
    uint16_t drawn[kBlocks][kBatch];
    unsigned live = 0;
    for (int b = 0; b < kBlocks; ++b) live |= static_cast<unsigned>(any(blocks[b].inside)) << b;
    const uint32_t last = first + count - 1;
    for (uint32_t base = 0; base < count && live; base += kBatch) {
        const int size = static_cast<int>(std::min<uint32_t>(kBatch, count - base));
        int drawn_count[kBlocks] = {0};
        watch.begin(size);
        for (int e = 0; e < size; ++e) {
            const uint32_t at = first + base + e;
            __builtin_prefetch(&lists.projected[lists.entries[std::min(at + kAhead, last)].gaussian]);
            batch[e] = lists.projected[lists.entries[at].gaussian];
            const int32_t known = lists.entries[at].blocks;
            const uint16_t met = known < 0 ? blocks_met(batch[e], corners.x, corners.y) : static_cast<uint16_t>(known);
            if (trace) trace->blocks[at] = met;
            for (unsigned left = met & live; left; left &= left - 1) {
                const int b = __builtin_ctz(left);
                drawn[b][drawn_count[b]++] = static_cast<uint16_t>(e);
            }
        }
        for (int b = 0; b < kBlocks; ++b) {
            if (out.depth)
                composite_block<true>(gathered[b], blocks[b], b, batch, drawn[b], drawn_count[b], static_cast<int>(base), watch);
            else
                composite_block<false>(gathered[b], blocks[b], b, batch, drawn[b], drawn_count[b], static_cast<int>(base), watch);
            if (!any(gathered[b].live)) live &= ~(1u << b);
        }
        watch.end(first + base, size);
    }
    const int64_t plane = static_cast<int64_t>(cam.width) * cam.height;
    for (int b = 0; b < kBlocks; ++b) {
        const Block& block = blocks[b];
        const Gathered& g = gathered[b];
        if (trace) {
            const size_t slot = (static_cast<size_t>(tile) * kBlocks + b) * kLanes;
            store(&trace->transmittance[slot], g.transmittance);
            storei(&trace->last[slot], g.last);
        }
        if (block.x0 >= cam.width || block.y0 >= cam.height) continue;
        for (int c = 0; c < 3; ++c) write_block(out.rgb + c * plane, block, cam, g.rgb[c] + g.transmittance * out.background[c]);
        if (out.alpha) write_block(out.alpha, block, cam, 1.0f - g.transmittance);
        if (out.depth) write_block(out.depth, block, cam, g.depth);
    }
}

inline void composite_tile(const TileLists& lists, const Camera& cam, int tile, const Planes& out, Trace* trace) {
    Unwatched nobody;
    composite_tile(lists, cam, tile, out, trace, nobody);
}

// Draws the whole scene.
inline void render_picture(Pool& pool, Binner& binner, const Scene& scene, const Camera& cam, const Planes& out, TileLists& lists,
                           Trace* trace, uint64_t max_pairs = kMaxPairs) {
    binner.run(pool, scene, cam, nullptr, scene.count, lists, 0, max_pairs);
    if (trace) trace->resize(lists);
    pool.run(lists.rows, [&](int row) {
        for (int column = 0; column < lists.columns; ++column)
            composite_tile(lists, cam, row * lists.columns + column, out, trace);
    });
}

}  // namespace decogs
