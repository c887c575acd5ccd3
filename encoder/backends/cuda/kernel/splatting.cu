// Gaussians on a picture of a CUDA device: projection, lists by tile, compositing, the loss, and the way back to the
// stored values and through Adam.
//
// The projection and its way back are the processor's own source with one lane (lane.h), and the rest follows its
// conventions: the same tiles, the same order, the same caps. Chosen: lists for every draw, of the needed tiles alone. A
// pair of a tile and a Gaussian has a number that ascends with the Gaussian's row, so that depth and number are a key of
// which no two are equal: a tile's list, which arrives in any order, is the same once sorted. Every pair writes its
// moments to its own slot, and each Gaussian sums its slots in order: no sum depends on which thread came first, and the
// same seed gives the same bytes. The host reads nothing: lists lie in buffers of a fixed capacity; `seen` tells the host,
// when it looks, how many pairs there were. Rejected: a radix sort of all pairs (more launches, as many again of 64 bits),
// and sums by atomics (other bits every time).
#include "backward_projection.h"

namespace decogs {

constexpr int kThreads = 256, kWarp = 32, kWarps = kThreads / kWarp;
constexpr int kWide = 8, kHigh = 4;  // pixels of a warp, of which a tile has two beside each other
constexpr unsigned kEvery = 0xffffffffu;

DECOGS_INLINE int lane_of_warp() { return threadIdx.x % kWarp; }
DECOGS_INLINE int warp_of_block() { return threadIdx.x / kWarp; }
DECOGS_INLINE int64_t thread_of_grid() { return static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x; }

// As in tiles.h, for one rectangle: the smallest exponent in it, less what rounding may have added.
DECOGS_INLINE float smallest_exponent(const Projected& g, float x0, float y0, float width, float height) {
    const float lx = x0 - g.x, hx = lx + width, ly = y0 - g.y, hy = ly + height;
    const float aa = g.p * g.p, ab = g.p * g.q, cc = g.q * g.q + g.r * g.r;
    const float ex = min(max(lx, 0.0f), hx), ey = min(max(ly, 0.0f), hy);
    const float y_on_ex = min(max(ex * (-ab / cc), ly), hy), x_on_ey = min(max(ey * (-ab / aa), lx), hx);
    const float u1 = ex * g.p + y_on_ex * g.q, v1 = y_on_ex * g.r, u2 = x_on_ey * g.p + ey * g.q, v2 = ey * g.r;
    const float slack = (ex * ex * aa + ey * ey * cc + hx * hx * aa + hy * hy * cc) * 1e-6f + 1e-3f;
    return min(u1 * u1 + v1 * v1, u2 * u2 + v2 * v2) - slack;
}

struct Grid {  // a picture's tiles
    int columns, rows;
};

struct Needed {  // tiles to draw, one byte each: those that a changing Gaussian meets, and those that show a past one; null: all
    uint8_t* met;
    uint8_t* stale;
};
DECOGS_INLINE bool is_needed(const Needed& needed, int tile) { return !needed.met || needed.met[tile] || needed.stale[tile]; }

struct Lists {  // pairs of a tile and a Gaussian
    const int64_t* ends;  // sums of the tiles' numbers of pairs, then of the Gaussians'
    uint64_t* keys;       // by tile: depth, and the pair's number
    int32_t* gaussians;   // by the pair's number
    int64_t capacity;
};

struct Range {
    int64_t begin, end;
};
DECOGS_INLINE int64_t shorter(int64_t a, int64_t b) { return a < b ? a : b; }
DECOGS_INLINE Range entries_of(const Lists& lists, int tile) {
    return {shorter(tile ? lists.ends[tile - 1] : 0, lists.capacity), shorter(lists.ends[tile], lists.capacity)};
}
DECOGS_INLINE Range pairs_of(const Lists& lists, int64_t tiles, int64_t gaussian) {
    const int64_t total = lists.ends[tiles - 1], at = tiles + gaussian;
    return {shorter(lists.ends[at - 1] - total, lists.capacity), shorter(lists.ends[at] - total, lists.capacity)};
}
DECOGS_INLINE int32_t gaussian_at(const Lists& lists, int64_t entry) { return lists.gaussians[lists.keys[entry] & kEvery]; }

// Calls visit(tile, whether the ellipse overlaps it) for the tiles around a Gaussian, a warp's lanes for one tile each, all
// of them together, beyond the last tile, too.
template <class Visit>
DECOGS_INLINE void each_tile(const Projected& g, const Grid& grid, const Visit& visit) {
    if (!(g.cut > 0.0f)) return;
    const float ex = g.extent_x * 1.0001f + 0.01f, ey = g.extent_y * 1.0001f + 0.01f;
    const int x0 = static_cast<int>(max(0.0f, (g.x - ex) / kTile)), x1 = static_cast<int>(min(grid.columns - 1.0f, (g.x + ex) / kTile));
    const int y0 = static_cast<int>(max(0.0f, (g.y - ey) / kTile)), y1 = static_cast<int>(min(grid.rows - 1.0f, (g.y + ey) / kTile));
    const int across = x1 - x0 + 1, count = across > 0 && y1 >= y0 ? across * (y1 - y0 + 1) : 0;
    for (int base = 0; base < count; base += kWarp) {
        const int i = base + lane_of_warp(), x = x0 + i % across, y = y0 + i / across;
        const bool met = i < count && (count == 1 || smallest_exponent(g, x * kTile + 0.5f, y * kTile + 0.5f, kTile - 1.0f, kTile - 1.0f) <= g.cut);
        visit(y * grid.columns + x, met);
    }
}

extern "C" __global__ void project(Scene scene, Camera camera, const int64_t* rows, Projected* out) {
    const int64_t i = thread_of_grid();
    if (i < scene.count) project_rows(scene, camera, &i, out + (rows ? rows[i] : i));
}

// For a draw: no tile is met or has pairs yet.
extern "C" __global__ void begin(Grid grid, uint8_t* met, int32_t* counts) {
    const int64_t tile = thread_of_grid();
    if (tile >= grid.columns * grid.rows) return;
    counts[tile] = 0;
    if (met) met[tile] = 0;
}

// Marks the tiles that the Gaussians `rows` meet.
extern "C" __global__ void meet(const Projected* all, const int64_t* rows, int64_t count, Grid grid, uint8_t* marks) {
    const int64_t i = thread_of_grid() / kWarp;
    if (i < count)
        each_tile(all[rows[i]], grid, [&](int tile, bool met) {
            if (met) marks[tile] = 1;
        });
}

// Pairs of each needed tile, and then of each Gaussian.
extern "C" __global__ void count_pairs(const Projected* all, int64_t count, Grid grid, Needed needed, int32_t* counts) {
    const int64_t i = thread_of_grid() / kWarp;
    if (i >= count) return;
    int pairs = 0;
    each_tile(all[i], grid, [&](int tile, bool met) {
        const bool counted = met && is_needed(needed, tile);
        if (counted) atomicAdd(&counts[tile], 1);
        pairs += __popc(__ballot_sync(kEvery, counted));
    });
    if (lane_of_warp() == 0) counts[grid.columns * grid.rows + i] = pairs;
}

// Writes the keys, in any order within a tile. Counts the tiles' `counts` down to 0.
extern "C" __global__ void list_pairs(const Projected* all, int64_t count, Grid grid, Needed needed, int32_t* counts, Lists lists, int64_t* seen) {
    const int64_t i = thread_of_grid() / kWarp;
    const int tiles = grid.columns * grid.rows;
    if (thread_of_grid() == 0) *seen = lists.ends[tiles - 1];
    if (i >= count) return;
    const Projected& g = all[i];
    const uint64_t depth = static_cast<uint64_t>(__float_as_uint(g.depth)) << 32;  // positive, so that bits are in its order
    int64_t next = lists.ends[tiles + i - 1] - lists.ends[tiles - 1];
    each_tile(g, grid, [&](int tile, bool met) {
        const bool counted = met && is_needed(needed, tile);
        const unsigned votes = __ballot_sync(kEvery, counted);
        const int64_t pair = next + __popc(votes & ((1u << lane_of_warp()) - 1u));
        next += __popc(votes);
        if (!counted) return;
        const int64_t entry = (tile ? lists.ends[tile - 1] : 0) + atomicSub(&counts[tile], 1) - 1;
        if (entry < lists.capacity) lists.keys[entry] = depth | static_cast<uint64_t>(pair);
        if (pair < lists.capacity) lists.gaussians[pair] = static_cast<int32_t>(i);
    });
}

constexpr int kSortable = 2048;  // entries that shared memory has room for

// Bitonic, with every comparison upwards, so that the numbers beyond the last are as good as infinite. Batcher 1968.
DECOGS_INLINE void sort_keys(uint64_t* keys, int64_t count) {
    for (int64_t half = 1; half < count; half *= 2)
        for (int64_t step = half; step > 0; step /= 2) {
            for (int64_t i = threadIdx.x; i < count; i += kThreads) {
                const int64_t j = step == half ? i ^ (2 * half - 1) : i ^ step;
                if (j > i && j < count && keys[i] > keys[j]) {
                    const uint64_t larger = keys[i];
                    keys[i] = keys[j];
                    keys[j] = larger;
                }
            }
            __syncthreads();
        }
}

// Sorts each tile's list, front to back; equal depths in the scene's order.
extern "C" __global__ void __launch_bounds__(kThreads) sort_tiles(Lists lists) {
    __shared__ uint64_t sorted[kSortable];
    const Range range = entries_of(lists, blockIdx.x);
    const int64_t count = range.end - range.begin;
    uint64_t* keys = lists.keys + range.begin;
    if (count > kSortable) return sort_keys(keys, count);
    for (int i = threadIdx.x; i < count; i += kThreads) sorted[i] = keys[i];
    __syncthreads();
    sort_keys(sorted, count);
    for (int i = threadIdx.x; i < count; i += kThreads) keys[i] = sorted[i];
}

struct Pixel {
    float x, y;
    float corner_x, corner_y;  // centre of the warp's first pixel
    int64_t at;
    bool inside;
};

DECOGS_INLINE Pixel pixel_of(const Camera& camera, const Grid& grid, int tile) {
    const int warp = warp_of_block(), lane = lane_of_warp();
    const int left = tile % grid.columns * kTile + warp % 2 * kWide, top = tile / grid.columns * kTile + warp / 2 * kHigh;
    const int x = left + lane % kWide, y = top + lane / kWide;
    return {x + 0.5f, y + 0.5f, left + 0.5f, top + 0.5f, static_cast<int64_t>(y) * camera.width + x, x < camera.width && y < camera.height};
}

// Which of 32 ellipses overlap the warp's pixels, as bits; `lane`'s is this one's.
DECOGS_INLINE unsigned overlapping(const Projected& lane, bool there, const Pixel& pixel) {
    return __ballot_sync(kEvery, there && smallest_exponent(lane, pixel.corner_x, pixel.corner_y, kWide - 1.0f, kHigh - 1.0f) <= lane.cut);
}

struct Planes {  // planar pictures, (channels, height, width)
    float* rgb;
    float* transmittance;
    float* depth;
    int32_t* last;  // one past the last composited entry of the tile's list
    float background[3];
};

// Front to back; Kerbl 2023, equation 3. Afterwards the stale tiles are those that show changing Gaussians.
extern "C" __global__ void __launch_bounds__(kThreads)
    composite(Camera camera, Grid grid, const Projected* all, Lists lists, Needed needed, Planes out) {
    __shared__ Projected batch[kThreads];
    const int tile = blockIdx.x, lane = lane_of_warp();
    if (!is_needed(needed, tile)) return;
    const Pixel pixel = pixel_of(camera, grid, tile);
    const Range range = entries_of(lists, tile);
    float transmittance = 1.0f, rgb[3] = {0.0f, 0.0f, 0.0f}, depth = 0.0f;
    int last = 0;
    bool live = pixel.inside;
    for (int64_t base = range.begin; base < range.end; base += kThreads) {
        if (!__syncthreads_or(live)) break;
        const int size = static_cast<int>(shorter(kThreads, range.end - base));
        if (static_cast<int>(threadIdx.x) < size) batch[threadIdx.x] = all[gaussian_at(lists, base + threadIdx.x)];
        __syncthreads();
        for (int chunk = 0; chunk < size && __ballot_sync(kEvery, live); chunk += kWarp)
            for (unsigned left = overlapping(batch[chunk + lane], chunk + lane < size, pixel); left; left &= left - 1) {
                const int e = chunk + __ffs(left) - 1;
                const Projected& g = batch[e];
                const float dx = pixel.x - g.x, dy = pixel.y - g.y, u = dx * g.p + dy * g.q, v = dy * g.r;
                const float exponent = u * u + v * v;
                if (!live || !(exponent <= g.cut)) continue;
                const float alpha = min(exp2_negative(exponent) * g.opacity, kAlphaMax), next = transmittance * (1.0f - alpha);
                if (next < kTransmittanceMin) {
                    live = false;
                    continue;
                }
                const float weight = alpha * transmittance;
                for (int c = 0; c < 3; ++c) rgb[c] += weight * g.rgb[c];
                depth += weight * g.depth;
                transmittance = next;
                last = static_cast<int>(base - range.begin) + e + 1;
            }
    }
    __syncthreads();
    if (threadIdx.x == 0 && needed.met) needed.stale[tile] = needed.met[tile];
    if (!pixel.inside) return;
    const int64_t plane = static_cast<int64_t>(camera.width) * camera.height;
    for (int c = 0; c < 3; ++c) out.rgb[c * plane + pixel.at] = rgb[c] + transmittance * out.background[c];
    out.transmittance[pixel.at] = transmittance;
    out.depth[pixel.at] = depth;
    out.last[pixel.at] = last;
}

struct Cotangents {  // of the picture, planar; alpha and depth may be null
    const float* rgb;
    const float* alpha;
    const float* depth;
};

constexpr int kSums = 10;  // of the moments, those that are used

// Sums of each of sixteen values over a warp: that of value i in the lanes of number 2i and 2i + 1.
DECOGS_INLINE float sum_over_warp(float* values) {
#pragma unroll
    for (int half = 8; half > 0; half /= 2) {
        const bool upper = lane_of_warp() & (2 * half);
#pragma unroll
        for (int i = 0; i < half; ++i) {
            const float kept = upper ? values[i + half] : values[i], given = upper ? values[i] : values[i + half];
            values[i] = kept + __shfl_xor_sync(kEvery, given, 2 * half);
        }
    }
    return values[0] + __shfl_xor_sync(kEvery, values[0], 1);
}

// Back to front in normalised form, as backward.h has it. Moments of the pairs of `changing` Gaussians (null: all) alone.
extern "C" __global__ void __launch_bounds__(kThreads) backward(Camera camera, Grid grid, const Projected* all, Lists lists, const uint8_t* met,
                                                                const uint8_t* changing, Planes drawn, Cotangents by, float* moments) {
    __shared__ Projected batch[kWarp];
    __shared__ uint32_t pairs[kWarp];
    __shared__ float sums[kWarps][kWarp][kSums];
    __shared__ unsigned summed[kWarps], wanted;
    __shared__ int foremost, newest;
    const int tile = blockIdx.x, lane = lane_of_warp(), warp = warp_of_block();
    if (met && !met[tile]) return;
    const Pixel pixel = pixel_of(camera, grid, tile);
    const Range range = entries_of(lists, tile);
    const int count = static_cast<int>(range.end - range.begin), last = pixel.inside ? drawn.last[pixel.at] : 0;
    if (threadIdx.x == 0) {
        foremost = changing ? count : 0;
        newest = 0;
    }
    __syncthreads();
    if (changing)  // entries in front of the first wanted one affect no gradient
        for (int e = threadIdx.x; e < count; e += kThreads)
            if (changing[gaussian_at(lists, range.begin + e)]) {
                atomicMin(&foremost, e);
                break;
            }
    atomicMax(&newest, last);
    __syncthreads();
    for (int e = newest + threadIdx.x; e < count; e += kThreads) {
        const uint64_t pair = lists.keys[range.begin + e] & kEvery;
        if (changing && !changing[lists.gaussians[pair]]) continue;
        for (int k = 0; k < kMoments; ++k) moments[pair * kMoments + k] = 0.0f;
    }
    const int64_t plane = static_cast<int64_t>(camera.width) * camera.height;
    float transmittance = 1.0f, behind = 0.0f, rgb[3] = {0.0f, 0.0f, 0.0f}, depth = 0.0f;
    if (pixel.inside) {
        transmittance = drawn.transmittance[pixel.at];
        for (int c = 0; c < 3; ++c) rgb[c] = by.rgb[c * plane + pixel.at];
        behind = rgb[0] * drawn.background[0] + rgb[1] * drawn.background[1] + rgb[2] * drawn.background[2];
        if (by.alpha) behind -= by.alpha[pixel.at];
        if (by.depth) depth = by.depth[pixel.at];
    }
    for (int end = newest; end > foremost; end -= kWarp) {
        const int begin = end > kWarp ? end - kWarp : 0, size = end - begin;
        __syncthreads();
        if (warp == 0) {
            bool asked = false;
            if (lane < size) {
                const uint32_t pair = lists.keys[range.begin + begin + lane] & kEvery;
                const int32_t gaussian = lists.gaussians[pair];
                pairs[lane] = pair;
                batch[lane] = all[gaussian];
                asked = !changing || changing[gaussian];
            }
            const unsigned votes = __ballot_sync(kEvery, asked);
            if (lane == 0) wanted = votes;
        }
        __syncthreads();
        unsigned mine = 0;
        for (unsigned left = overlapping(batch[lane], lane < size, pixel); left;) {
            const int e = kWarp - 1 - __clz(left);
            left &= ~(1u << e);
            const Projected& g = batch[e];
            const float dx = pixel.x - g.x, dy = pixel.y - g.y, u = dx * g.p + dy * g.q, v = dy * g.r;
            const float exponent = u * u + v * v;
            const bool on = exponent <= g.cut && begin + e < last;
            if (!__ballot_sync(kEvery, on)) continue;
            float values[16] = {0.0f};
            if (on) {
                const float unbounded = exp2_negative(exponent) * g.opacity, alpha = min(unbounded, kAlphaMax);
                transmittance = transmittance / (1.0f - alpha);
                const float gap = rgb[0] * g.rgb[0] + rgb[1] * g.rgb[1] + rgb[2] * g.rgb[2] + depth * g.depth - behind;
                behind += alpha * gap;
                const float weight = alpha * transmittance, grad = unbounded <= kAlphaMax ? weight * gap : 0.0f;
                values[0] = grad;
                values[1] = grad * u;
                values[2] = grad * v;
                values[3] = grad * u * u;
                values[4] = grad * u * v;
                values[5] = grad * v * v;
                for (int c = 0; c < 3; ++c) values[6 + c] = weight * rgb[c];
                values[9] = weight * depth;
            }
            if (!(wanted >> e & 1u)) continue;
            mine |= 1u << e;
            const float sum = sum_over_warp(values);
            if (lane % 2 == 0 && lane / 2 < kSums) sums[warp][e][lane / 2] = sum;
        }
        if (lane == 0) summed[warp] = mine;
        __syncthreads();
        for (int i = threadIdx.x; i < size * kMoments; i += kThreads) {
            const int e = i / kMoments, k = i % kMoments;
            float total = 0.0f;
            for (int w = 0; w < kWarps; ++w)
                if (k < kSums && (summed[w] >> e & 1u)) total += sums[w][e][k];
            if (wanted >> e & 1u) moments[static_cast<int64_t>(pairs[e]) * kMoments + k] = total;
        }
    }
}

constexpr int kWeights = 2;

// Each pair's rendering weight, the sum of alpha T over the tile's pixels, and over those that are marked (null: none).
extern "C" __global__ void __launch_bounds__(kThreads)
    weigh(Camera camera, Grid grid, const Projected* all, Lists lists, const uint8_t* marks, float* weights) {
    __shared__ Projected batch[kThreads];
    __shared__ float sums[kWarps][kThreads][kWeights];
    const int tile = blockIdx.x, lane = lane_of_warp(), warp = warp_of_block();
    const Pixel pixel = pixel_of(camera, grid, tile);
    const Range range = entries_of(lists, tile);
    const bool marked = pixel.inside && marks && marks[pixel.at], upper = lane >= kWarp / 2;
    float transmittance = 1.0f;
    bool live = pixel.inside;
    for (int64_t base = range.begin; base < range.end; base += kThreads) {
        const bool some = __syncthreads_or(live);
        const int size = static_cast<int>(shorter(kThreads, range.end - base));
        uint32_t pair = 0;
        if (static_cast<int>(threadIdx.x) < size) {
            pair = lists.keys[base + threadIdx.x] & kEvery;
            if (some) batch[threadIdx.x] = all[lists.gaussians[pair]];
        }
        for (int w = 0; w < kWarps; ++w) sums[w][threadIdx.x][0] = sums[w][threadIdx.x][1] = 0.0f;
        __syncthreads();
        for (int chunk = 0; some && chunk < size && __ballot_sync(kEvery, live); chunk += kWarp)
            for (unsigned left = overlapping(batch[chunk + lane], chunk + lane < size, pixel); left; left &= left - 1) {
                const int e = chunk + __ffs(left) - 1;
                const Projected& g = batch[e];
                const float dx = pixel.x - g.x, dy = pixel.y - g.y, u = dx * g.p + dy * g.q, v = dy * g.r;
                const float exponent = u * u + v * v;
                float weight = 0.0f;
                if (live && exponent <= g.cut) {
                    const float alpha = min(exp2_negative(exponent) * g.opacity, kAlphaMax), next = transmittance * (1.0f - alpha);
                    live = next >= kTransmittanceMin;
                    if (live) {
                        weight = alpha * transmittance;
                        transmittance = next;
                    }
                }
                if (!__ballot_sync(kEvery, weight > 0.0f)) continue;
                const float in_marks = marked ? weight : 0.0f, given = upper ? weight : in_marks;
                float sum = (upper ? in_marks : weight) + __shfl_xor_sync(kEvery, given, kWarp / 2);
                for (int offset = kWarp / 4; offset > 0; offset /= 2) sum += __shfl_xor_sync(kEvery, sum, offset);
                if (lane % (kWarp / 2) == 0) sums[warp][e][upper] = sum;
            }
        __syncthreads();
        for (int k = 0; k < kWeights && static_cast<int>(threadIdx.x) < size; ++k) {
            float total = 0.0f;
            for (int w = 0; w < kWarps; ++w) total += sums[w][threadIdx.x][k];
            weights[static_cast<int64_t>(pair) * kWeights + k] = total;
        }
    }
}

constexpr int kGathering = 16;  // threads of a Gaussian, one for each of its sums

// Sums what the pairs of Gaussians `rows` (null: all) have, so many numbers each, in the order of the pairs.
extern "C" __global__ void gather(const int64_t* rows, int64_t count, int64_t tiles, Lists lists, const float* values, int64_t numbers, float* totals) {
    const int64_t i = thread_of_grid() / kGathering;
    const int k = threadIdx.x % kGathering;
    if (i >= count || k >= numbers) return;
    const Range range = pairs_of(lists, tiles, rows ? rows[i] : i);
    float total = 0.0f;
    for (int64_t pair = range.begin; pair < range.end; ++pair) total += values[pair * numbers + k];
    totals[i * numbers + k] = total;
}

extern "C" __global__ void backward_project(Scene scene, Camera camera, const int64_t* rows, const Projected* all, const float* totals, Gradients out) {
    const int64_t i = thread_of_grid();
    if (i >= scene.count) return;
    const Projected* projected = all + (rows ? rows[i] : i);
    float total[kMoments];
    for (int k = 0; k < kMoments; ++k) total[k] = totals[i * kMoments + k];
    backward_rows(scene, camera, &i, 1, &projected, total, out);
}

// The loss, as loss.h has it (Wang 2004; Kerbl 2023, equation 7), a block for a tile of a channel.

constexpr int kRadius = 5, kTaps = 2 * kRadius + 1, kGrown = kTile + 2 * kRadius;
__constant__ float kWindow[kTaps] = {0.0010283801f, 0.0075987577f, 0.036000773f, 0.10936069f, 0.21300553f, 0.26601171f,
                                     0.21300553f,   0.10936069f,   0.036000773f, 0.0075987577f, 0.0010283801f};

struct Compared {  // (3, H, W) and (H, W); weight of L1 and focus may be null
    const float* image;
    const float* target;
    const float* l1_weight;
    const float* focus;
    const uint8_t* wanted;  // by tile; null: all
    float l1_scale, ssim_scale;
    int width, height;
};

struct Place {
    int left, top, x, y;  // of the tile, and the thread's pixel
    int64_t at;
    bool inside;
};
DECOGS_INLINE Place place_of(const Compared& in) {
    const int left = blockIdx.x * kTile, top = blockIdx.y * kTile, x = left + threadIdx.x % kTile, y = top + threadIdx.x / kTile;
    return {left, top, x, y, static_cast<int64_t>(y) * in.width + x, x < in.width && y < in.height};
}

// Whether the loss of a tile within this many of the block's is wanted.
DECOGS_INLINE bool is_wanted(const Compared& in, int around) {
    if (!in.wanted) return true;
    bool found = false;
    for (int y = -around; y <= around; ++y)
        for (int x = -around; x <= around; ++x) {
            const int column = static_cast<int>(blockIdx.x) + x, row = static_cast<int>(blockIdx.y) + y;
            if (column >= 0 && column < static_cast<int>(gridDim.x) && row >= 0 && row < static_cast<int>(gridDim.y))
                found |= in.wanted[row * gridDim.x + column] != 0;
        }
    return found;
}

DECOGS_INLINE float sum_over_block(float value) {
    __shared__ float parts[kWarps];
    for (int offset = kWarp / 2; offset > 0; offset /= 2) value += __shfl_xor_sync(kEvery, value, offset);
    if (lane_of_warp() == 0) parts[warp_of_block()] = value;
    __syncthreads();
    float total = 0.0f;
    for (float part : parts) total += part;
    return total;
}

// One value at a pixel of the grown tile, of `kMaps` maps; blurs them along rows and leaves them to be blurred along columns.
template <int kMaps, class Read>
DECOGS_INLINE void blur_rows(float (&rows)[kMaps][kGrown][kTile], float (&grown)[kMaps][kGrown][kGrown], const Read& read) {
    for (int i = threadIdx.x; i < kGrown * kGrown; i += kThreads) read(i % kGrown - kRadius, i / kGrown - kRadius, i);
    __syncthreads();
    for (int i = threadIdx.x; i < kGrown * kTile; i += kThreads)
        for (int map = 0; map < kMaps; ++map) {
            float total = 0.0f;
            for (int k = 0; k < kTaps; ++k) total += kWindow[k] * grown[map][i / kTile][i % kTile + k];
            rows[map][i / kTile][i % kTile] = total;
        }
    __syncthreads();
}
template <int kMaps>
DECOGS_INLINE float blurred(const float (&rows)[kMaps][kGrown][kTile], int map) {
    float total = 0.0f;
    for (int k = 0; k < kTaps; ++k) total += kWindow[k] * rows[map][threadIdx.x / kTile + k][threadIdx.x % kTile];
    return total;
}

// Derivatives of focus (1 - SSIM) by the image's window statistics, mean, mean square and mean product: maps (3, 3, H, W).
extern "C" __global__ void __launch_bounds__(kThreads) compare_windows(Compared in, float* maps, float* sums) {
    __shared__ float grown[4][kGrown][kGrown], rows[4][kGrown][kTile];
    const Place place = place_of(in);
    const int channel = blockIdx.z, block = (channel * gridDim.y + blockIdx.y) * gridDim.x + blockIdx.x;
    const int64_t area = static_cast<int64_t>(in.width) * in.height;
    if (!is_wanted(in, 1)) {
        if (threadIdx.x == 0) sums[block] = 0.0f;
        return;
    }
    blur_rows<4>(rows, grown, [&](int dx, int dy, int i) {
        const int x = place.left + dx, y = place.top + dy;
        float a = 0.0f, b = 0.0f;
        if (x >= 0 && x < in.width && y >= 0 && y < in.height) {
            const int64_t at = static_cast<int64_t>(y) * in.width + x;
            const float focus = in.focus ? in.focus[at] : 1.0f;
            a = in.image[channel * area + at] * focus;
            b = in.target[channel * area + at] * focus;
        }
        (&grown[0][0][0])[i] = a;
        (&grown[1][0][0])[i] = b;
        (&grown[2][0][0])[i] = a * a + b * b;
        (&grown[3][0][0])[i] = a * b;
    });
    float missed = 0.0f;
    if (place.inside) {
        const float ma = blurred(rows, 0), mb = blurred(rows, 1), squares = blurred(rows, 2), ab = blurred(rows, 3);
        const float weight = in.focus ? in.focus[place.at] : 1.0f, c1 = 0.0001f, c2 = 0.0009f;
        const float mab = ma * mb, means = ma * ma + mb * mb, n1 = mab * 2.0f + c1, n2 = (ab - mab) * 2.0f + c2;
        const float d1 = means + c1, d2 = (squares - means) + c2, inverse = 1.0f / (d1 * d2), similarity = n1 * n2 * inverse;
        const float inverse1 = inverse * d2, inverse2 = inverse * d1;
        float* to = maps + channel * area + place.at;
        to[0] = weight * (mb * (n1 - n2) * inverse * 2.0f + similarity * ma * (inverse1 - inverse2) * 2.0f);
        to[3 * area] = weight * similarity * inverse2;
        to[6 * area] = weight * n1 * inverse * -2.0f;
        missed = weight * (1.0f - similarity);
    }
    const float total = sum_over_block(missed);
    if (threadIdx.x == 0) sums[block] = is_wanted(in, 0) ? total : 0.0f;
}

// The gradient (3, H, W) in the wanted tiles, from these maps, and L1.
extern "C" __global__ void __launch_bounds__(kThreads) differentiate(Compared in, const float* maps, float* gradient, float* sums) {
    __shared__ float grown[3][kGrown][kGrown], rows[3][kGrown][kTile];
    const Place place = place_of(in);
    const int channel = blockIdx.z, block = (channel * gridDim.y + blockIdx.y) * gridDim.x + blockIdx.x;
    const int64_t area = static_cast<int64_t>(in.width) * in.height;
    if (!is_wanted(in, 0)) {
        if (threadIdx.x == 0) sums[block] = 0.0f;
        return;
    }
    if (in.ssim_scale != 0.0f)
        blur_rows<3>(rows, grown, [&](int dx, int dy, int i) {
            const int x = place.left + dx, y = place.top + dy;
            const bool there = x >= 0 && x < in.width && y >= 0 && y < in.height;
            const int64_t at = channel * area + static_cast<int64_t>(y) * in.width + x;
            for (int map = 0; map < 3; ++map) (&grown[map][0][0])[i] = there ? maps[3 * map * area + at] : 0.0f;
        });
    float l1 = 0.0f;
    if (place.inside) {
        const float a = in.image[channel * area + place.at], b = in.target[channel * area + place.at], difference = a - b;
        const float weight = in.l1_weight ? in.l1_weight[place.at] : 1.0f;
        l1 = weight * fabsf(difference);
        float value = weight * in.l1_scale * (difference > 0.0f ? 1.0f : difference < 0.0f ? -1.0f : 0.0f);
        if (in.ssim_scale != 0.0f) {
            const float focus = in.focus ? in.focus[place.at] : 1.0f;
            const float back = blurred(rows, 0) + a * focus * blurred(rows, 1) * 2.0f + b * focus * blurred(rows, 2);
            value += focus * in.ssim_scale * back;
        }
        gradient[channel * area + place.at] = value;
    }
    const float total = sum_over_block(l1);
    if (threadIdx.x == 0) sums[block] = total;
}

// Sums of L1 and of 1 - SSIM, (2,), from those of `count` blocks each; a block for each.
extern "C" __global__ void __launch_bounds__(kThreads) sum_losses(const float* sums, int64_t count, double* totals) {
    __shared__ double parts[kThreads];
    double own = 0.0;
    for (int64_t i = threadIdx.x; i < count; i += kThreads) own += sums[blockIdx.x * count + i];
    parts[threadIdx.x] = own;
    for (int half = kThreads / 2; half > 0; half /= 2) {
        __syncthreads();
        if (static_cast<int>(threadIdx.x) < half) parts[threadIdx.x] += parts[threadIdx.x + half];
    }
    if (threadIdx.x == 0) totals[blockIdx.x] = parts[0];
}

struct Trained {  // one attribute's values, (count, columns), and what is known of them; frozen and kept may be null
    float* value;
    const float* gradient;
    float* first;
    float* second;
    const uint8_t* frozen;
    const float* kept;
    int columns, few;      // the first few columns have a rate of their own
    float rate, few_rate;
};

struct AdamStep {
    float beta1, beta2, epsilon;
    float first_scale, second_root;  // bias corrections
    float longest;                   // logarithm of the largest stretch; below 0: any
    int sizes;                       // which attribute is the sizes, of which stretch is limited
};

DECOGS_INLINE float adam_value(const Trained& of, const AdamStep& step, int64_t i) {
    const float g = of.gradient[i], rate = i % of.columns < of.few ? of.few_rate : of.rate;
    const float m = of.first[i] * step.beta1 + g * (1.0f - step.beta1), v = of.second[i] * step.beta2 + g * g * (1.0f - step.beta2);
    of.first[i] = m;
    of.second[i] = v;
    if (of.frozen && of.frozen[i]) return of.kept[i];
    return of.value[i] - rate * (m * step.first_scale) / (sqrt(v) * step.second_root + step.epsilon);
}

// Logarithm of the largest over the middle size.
DECOGS_INLINE float stretch(const float* s) {
    const float low = min(s[0], s[1]), high = max(s[0], s[1]);
    return max(high, s[2]) - max(low, min(high, s[2]));
}

// Kingma 2015, algorithm 1, of a row of blocks for each attribute; sizes also as cpu/stretch.py limits them.
extern "C" __global__ void adam(Trained a, Trained b, Trained c, Trained d, Trained e, int64_t count, AdamStep step) {
    const int attribute = blockIdx.y;
    const Trained of = attribute == 0 ? a : attribute == 1 ? b : attribute == 2 ? c : attribute == 3 ? d : e;
    const int64_t all = static_cast<int64_t>(gridDim.x) * blockDim.x;
    if (!of.value) return;
    if (attribute != step.sizes || step.longest < 0.0f) {
        for (int64_t i = thread_of_grid(); i < count * of.columns; i += all) of.value[i] = adam_value(of, step, i);
        return;
    }
    for (int64_t row = thread_of_grid(); row < count; row += all) {
        float* at = of.value + 3 * row;
        const float allowed = max(stretch(at), step.longest);
        float now[3];
        for (int k = 0; k < 3; ++k) now[k] = adam_value(of, step, 3 * row + k);
        const float excess = max(stretch(now) - allowed, 0.0f);
        const int largest = now[0] >= now[1] && now[0] >= now[2] ? 0 : now[1] >= now[2] ? 1 : 2;
        for (int k = 0; k < 3; ++k) at[k] = now[k] - (k == largest ? excess : 0.0f);
    }
}

// Adds the lengths `view` of a picture's view gradients to their sums, and 1 where a Gaussian was drawn.
extern "C" __global__ void add_view(const float* view, int64_t count, float emphasis, double half_size, double* sums, int64_t* views) {
    const int64_t i = thread_of_grid();
    if (i >= count) return;
    sums[i] += static_cast<double>(view[i] / emphasis) * half_size;
    views[i] += view[i] > 0.0f;
}

}  // namespace decogs
