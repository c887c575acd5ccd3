// Backward pass through compositing and projection.
//
// Compositing is traversed back to front in normalised form. With d = dL/dC . c of the Gaussian's colour c, and S the same of
// everything behind it divided by the transmittance in front of that: T <- T / (1 - alpha), dL/dalpha = T (d - S),
// S <- S + alpha (d - S). S is one scalar per pixel, and no large sums are subtracted. Every (tile, Gaussian) pair writes its
// moments to its own slot, and each Gaussian sums its slots in order: gradient accumulation does not depend on the number of
// threads.
#pragma once

#include "backward_projection.h"
#include "composite.h"

namespace decogs {

struct Cotangents {  // dL/d(picture), planar; alpha and depth may be null
    const float* rgb;
    const float* alpha;
    const float* depth;
    float background[3];
};

struct BlockBack {  // state of a block's pixels; `behind` is S
    F x, y, transmittance, behind, rgb[3], depth;
    I last;
    int32_t newest;  // one past the last entry that any pixel of the block composited
};

// An entry without a pair (kNoPair) is a static Gaussian, which needs no gradient.
template <bool kDepth>
inline void backward_tile_of(const TileLists& lists, const Trace& trace, const Camera& cam, int tile, const Cotangents& ct, float* moments) {
    const int tile_x = tile % lists.columns, tile_y = tile / lists.columns;
    const uint32_t first = lists.first_entry[tile], count = lists.first_entry[tile + 1] - first;
    // Entries in front of the first one with a pair affect no wanted gradient.
    uint32_t foremost = 0;
    while (foremost < count && lists.entries[first + foremost].pair == kNoPair) ++foremost;
    if (foremost == count) return;
    const int64_t plane = static_cast<int64_t>(cam.width) * cam.height;
    BlockBack blocks[kBlocks];
    int32_t newest = 0;
    for (int b = 0; b < kBlocks; ++b) {
        const Block pixels = block_of(tile_x, tile_y, b, cam);
        BlockBack& back = blocks[b];
        const size_t slot = (static_cast<size_t>(tile) * kBlocks + b) * kLanes;
        back.x = pixels.x;
        back.y = pixels.y;
        back.transmittance = load(&trace.transmittance[slot]);
        back.last = loadi(&trace.last[slot]);
        const bool seen = pixels.x0 < cam.width && pixels.y0 < cam.height;
        for (int c = 0; c < 3; ++c) back.rgb[c] = seen ? read_block(ct.rgb + c * plane, pixels, cam) : splat(0.0f);
        back.behind = back.rgb[0] * ct.background[0] + back.rgb[1] * ct.background[1] + back.rgb[2] * ct.background[2];
        if (ct.alpha && seen) back.behind = back.behind - read_block(ct.alpha, pixels, cam);
        back.depth = kDepth && seen ? read_block(ct.depth, pixels, cam) : splat(0.0f);
        back.newest = 0;
        for (int i = 0; i < kLanes; ++i) back.newest = std::max(back.newest, trace.last[slot + i]);
        newest = std::max(newest, back.newest);
    }
    for (uint32_t e = static_cast<uint32_t>(newest); e < count; ++e) {
        const uint32_t pair = lists.entries[first + e].pair;
        if (pair != kNoPair) std::memset(moments + static_cast<size_t>(pair) * kMoments, 0, kMoments * sizeof(float));
    }

    const F zero = splat(0.0f);
    for (int32_t e = newest - 1; e >= static_cast<int32_t>(foremost); --e) {
        const Entry entry = lists.entries[first + e], soon = lists.entries[first + std::max(e - static_cast<int32_t>(kAhead), 0)];
        __builtin_prefetch(&lists.projected[soon.gaussian]);
        if (soon.pair != kNoPair) __builtin_prefetch(moments + static_cast<size_t>(soon.pair) * kMoments, 1);
        const Projected& g = lists.projected[entry.gaussian];
        const bool wanted = entry.pair != kNoPair;
        F g0 = zero, gu = zero, gv = zero, guu = zero, guv = zero, gvv = zero, red = zero, green = zero, blue = zero, far = zero;
        for (unsigned left = trace.blocks[first + e]; left; left &= left - 1) {
            BlockBack& back = blocks[__builtin_ctz(left)];
            if (e >= back.newest) continue;
            const F dx = back.x - g.x, dy = back.y - g.y;
            const F u = dx * g.p + dy * g.q, v = dy * g.r;
            const F exponent = u * u + v * v;
            const M on = (exponent <= g.cut) & (splati(e) < back.last);
            if (!any(on)) continue;
            const F unbounded = exp2_negative(exponent) * g.opacity;
            const F alpha = min(unbounded, kAlphaMax);
            const F transmittance = back.transmittance / (1.0f - alpha);
            back.transmittance = select(on, transmittance, back.transmittance);
            F here = back.rgb[0] * g.rgb[0] + back.rgb[1] * g.rgb[1] + back.rgb[2] * g.rgb[2];
            if (kDepth) here = here + back.depth * g.depth;
            const F gap = here - back.behind;
            back.behind = select(on, back.behind + alpha * gap, back.behind);
            if (!wanted) continue;
            const F weight = select(on, alpha * transmittance, zero);
            red = red + weight * back.rgb[0];
            green = green + weight * back.rgb[1];
            blue = blue + weight * back.rgb[2];
            if (kDepth) far = far + weight * back.depth;
            const F grad = select(unbounded <= kAlphaMax, weight * gap, zero);
            g0 = g0 + grad;
            const F grad_u = grad * u, grad_v = grad * v;
            gu = gu + grad_u;
            gv = gv + grad_v;
            guu = guu + grad_u * u;
            guv = guv + grad_u * v;
            gvv = gvv + grad_v * v;
        }
        if (!wanted) continue;
        float* to = moments + static_cast<size_t>(entry.pair) * kMoments;
        const F fields[kMoments] = {g0, gu, gv, guu, guv, gvv, red, green, blue, far, zero, zero};
        sum_lanes(fields, to);
    }
}

inline void backward_tile(const TileLists& lists, const Trace& trace, const Camera& cam, int tile, const Cotangents& ct, float* moments) {
    if (ct.depth)
        backward_tile_of<true>(lists, trace, cam, tile, ct, moments);
    else
        backward_tile_of<false>(lists, trace, cam, tile, ct, moments);
}

// The forward pass's ellipses, and each Gaussian's range of pairs.
struct Drawn {
    const Projected* projected;
    const uint32_t* first_pair;
};

// Sums the pair moments of Gaussian `row`; returns whether it has pairs.
inline bool gather_moments(const Drawn& drawn, const float* moments, int64_t row, float* total) {
    std::memset(total, 0, kMoments * sizeof(float));
    const uint32_t begin = drawn.first_pair[row], end = drawn.first_pair[row + 1];
    for (uint32_t pair = begin; pair < end; ++pair)
        for (int k = 0; k < kMoments; ++k) total[k] += moments[static_cast<size_t>(pair) * kMoments + k];
    return end > begin;
}

// Gradients of sixteen consecutive Gaussians, from their moments.
inline void backward_group(const Scene& scene, const Camera& cam, const Drawn& forward, const float* moments, int64_t base,
                           const Gradients& out) {
    const int used = static_cast<int>(std::min<int64_t>(kLanes, scene.count - base));
    int64_t rows[kLanes];
    float lanes[kMoments][kLanes];
    bool drawn = false;
    for (int i = 0; i < kLanes; ++i) {
        rows[i] = base + std::min(i, used - 1);
        float total[kMoments];
        if (i < used)
            drawn |= gather_moments(forward, moments, rows[i], total);
        else
            std::memset(total, 0, sizeof total);
        for (int k = 0; k < kMoments; ++k) lanes[k][i] = total[k];
    }
    if (!drawn) {
        const int stride = 3 * scene.sh_coefficients;
        std::memset(out.means + base * 3, 0, sizeof(float) * 3 * used);
        std::memset(out.log_scales + base * 3, 0, sizeof(float) * 3 * used);
        std::memset(out.quaternions + base * 4, 0, sizeof(float) * 4 * used);
        std::memset(out.opacity_logits + base, 0, sizeof(float) * used);
        std::memset(out.sh + base * stride, 0, sizeof(float) * stride * used);
        if (out.view) std::memset(out.view + base, 0, sizeof(float) * used);
        return;
    }
    F total[kMoments];
    for (int k = 0; k < kMoments; ++k) total[k] = load(lanes[k]);
    const Projected* projected[kLanes];
    for (int i = 0; i < kLanes; ++i) projected[i] = &forward.projected[rows[i]];
    backward_rows(scene, cam, rows, used, projected, total, out);
}

// Gradients of the whole scene, one chunk of Gaussians per task.
inline void backward_scene(Pool& pool, const Scene& scene, const Camera& cam, const Drawn& forward, const float* moments, const Gradients& out) {
    const int chunks = static_cast<int>((scene.count + kChunk - 1) / kChunk);
    pool.run(chunks, [&](int chunk) {
        const int64_t end = std::min<int64_t>(scene.count, static_cast<int64_t>(chunk + 1) * kChunk);
        for (int64_t base = static_cast<int64_t>(chunk) * kChunk; base < end; base += kLanes)
            backward_group(scene, cam, forward, moments, base, out);
    });
}

}  // namespace decogs
