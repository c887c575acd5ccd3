// Photometric loss and gradient, l1_scale L1 + ssim_scale (1 - SSIM), in one pass over planar pictures.
//
// SSIM (Wang 2004) as in 3DGS: 11x11 Gaussian window with sigma 1.5, zero padding, C1 = 0.01^2, C2 = 0.03^2.
#pragma once

#include <algorithm>
#include <vector>

#include "pool.h"
#include "project.h"
#include "simd.h"

namespace decogs {

struct LossInput {  // mirrored by ctypes
    const float* image;     // (3, H, W)
    const float* target;    // (3, H, W)
    const float* l1_weight; // (H, W), multiplies |image - target|; null: everywhere 1
    const float* focus;     // (H, W), multiplies both pictures before SSIM, and weights its map; null: everywhere 1
    const uint8_t* tiles;   // per 16x16 tile: whether its loss is wanted; null: everywhere
    float l1_scale;         // factors of the weighted sums
    float ssim_scale;
    int32_t width, height;
};

struct LossSums {  // over the wanted pixels and all channels
    double l1;    // sum of l1_weight |image - target|
    double ssim;  // sum of focus (1 - SSIM)
};

struct Region {
    int x0, x1, y0, y1;  // pixels [x0, x1) x [y0, y1)
};

class Loss {
   public:
    // Writes the gradient (3, H, W) of l1_scale * l1 + ssim_scale * ssim at the wanted pixels. It is exact there: SSIM windows
    // that extend beyond the wanted tiles are evaluated too.
    LossSums run(Pool& pool, const LossInput& in, float* gradient) {
        width_ = in.width;
        height_ = in.height;
        find_regions(in.tiles);
        const int tasks = 3 * static_cast<int>(regions_.size());
        sums_.assign(tasks, LossSums{0, 0});
        pool.run(tasks, [&](int task) { sums_[task] = region(in, gradient, task % 3, regions_[task / 3]); });
        LossSums total{0, 0};
        for (const LossSums& part : sums_) {
            total.l1 += part.l1;
            total.ssim += part.ssim;
        }
        return total;
    }

   private:
    static constexpr int kRadius = 5, kTaps = 11, kBand = 64, kStrip = 128, kMargin = 16, kRow = kStrip + 2 * kMargin;

    // Rectangles of wanted tiles: runs along a row of tiles, merged with the run above if they have the same ends.
    void find_regions(const uint8_t* tiles) {
        regions_.clear();
        if (!tiles) {
            for (int y = 0; y < height_; y += kBand) regions_.push_back({0, width_, y, std::min(height_, y + kBand)});
            return;
        }
        const int columns = (width_ + kTile - 1) / kTile, rows = (height_ + kTile - 1) / kTile;
        for (int r = 0; r < rows; ++r)
            for (int c = 0; c < columns;) {
                if (!tiles[r * columns + c]) {
                    ++c;
                    continue;
                }
                const int begin = c;
                while (c < columns && tiles[r * columns + c]) ++c;
                add_run({begin * kTile, std::min(width_, c * kTile), r * kTile, std::min(height_, (r + 1) * kTile)});
            }
    }

    void add_run(const Region& run) {
        for (Region& above : regions_)
            if (above.y1 == run.y0 && above.x0 == run.x0 && above.x1 == run.x1 && run.y1 - above.y0 <= kBand) {
                above.y1 = run.y1;
                return;
            }
        regions_.push_back(run);
    }

    // A task's buffers: derivatives of SSIM by its window statistics, over the region and the margin of its windows.
    struct Maps {
        int x0, y0, stride;
        std::vector<float> field[3];
        float* at(int k, int x, int y) { return &field[k][static_cast<size_t>(y - y0) * stride + (x - x0)]; }
    };

    LossSums region(const LossInput& in, float* gradient, int channel, const Region& r) const {
        thread_local Maps maps;
        LossSums sums{0, 0};
        if (in.ssim_scale != 0.0f) {
            const Region wide{std::max(0, r.x0 - kRadius), std::min(width_, r.x1 + kRadius), std::max(0, r.y0 - kRadius),
                              std::min(height_, r.y1 + kRadius)};
            maps.x0 = wide.x0;
            maps.y0 = wide.y0;
            maps.stride = (wide.x1 - wide.x0 + kLanes - 1) / kLanes * kLanes;
            for (auto& field : maps.field) field.resize(static_cast<size_t>(maps.stride) * (wide.y1 - wide.y0));
            sums.ssim = statistics(in, channel, wide, r, maps);
        }
        sums.l1 = derivatives(in, gradient, channel, r, maps);
        return sums;
    }

    static const float* window() {
        static const float taps[6] = {0.26601171f, 0.21300553f, 0.10936069f, 0.036000773f, 0.0075987577f, 0.0010283801f};
        return taps;  // centre outwards
    }

    // Separable Gaussian blur of `kCount` fields over columns [x0, x1) of rows [y0, y1). fill(y, from, to, row) writes columns
    // [from, to) of row y of field k to row[k * kRow]...; take(y, blurred) receives each row, field k at blurred + k * kStrip.
    template <int kCount, class Fill, class Take>
    void blur_strip(int y0, int y1, int x0, int x1, const Fill& fill, const Take& take) const {
        alignas(64) float ring[kTaps][kCount][kStrip] = {};
        alignas(64) float rows[kCount][kRow] = {};
        alignas(64) float out[kCount][kStrip];
        const float* w = window();
        const int from = std::max(0, x0 - kRadius), to = std::min(width_, x1 + kRadius), columns = x1 - x0;
        for (int y = y0 - kRadius; y < y1 + kRadius; ++y) {
            auto& newest = ring[(y + kTaps) % kTaps];
            if (y >= 0 && y < height_) {
                fill(y, from, to, &rows[0][kMargin + from - x0]);
                for (int k = 0; k < kCount; ++k)
                    for (int x = 0; x < columns; x += kLanes) {
                        const float* at = &rows[k][kMargin + x];
                        F sum = load(at) * w[0];
                        sum = sum + (load_beside<-1>(at) + load_beside<1>(at)) * w[1];
                        sum = sum + (load_beside<-2>(at) + load_beside<2>(at)) * w[2];
                        sum = sum + (load_beside<-3>(at) + load_beside<3>(at)) * w[3];
                        sum = sum + (load_beside<-4>(at) + load_beside<4>(at)) * w[4];
                        sum = sum + (load_beside<-5>(at) + load_beside<5>(at)) * w[5];
                        store(&newest[k][x], sum);
                    }
            } else {
                std::memset(&newest, 0, sizeof newest);
            }
            const int centre = y - kRadius;
            if (centre < y0) continue;
            const float* rings[kTaps];
            for (int d = 0; d < kTaps; ++d) rings[d] = ring[(centre + d - kRadius + kTaps) % kTaps][0];
            for (int k = 0; k < kCount; ++k)
                for (int x = 0; x < columns; x += kLanes) {
                    const int at = k * kStrip + x;
                    F sum = load(rings[kRadius] + at) * w[0];
                    for (int d = 1; d <= kRadius; ++d) sum = sum + (load(rings[kRadius - d] + at) + load(rings[kRadius + d] + at)) * w[d];
                    store(&out[k][x], sum);
                }
            take(centre, &out[0][0]);
        }
    }

    static double sum_of(const F& x) {
        float lanes[kLanes];
        store(lanes, x);
        double total = 0;
        for (float lane : lanes) total += lane;
        return total;
    }

    // Columns [from, to) of a row of a picture, times focus.
    void focused_row(const LossInput& in, const float* picture, int channel, int y, int from, int to, float* row) const {
        const float* at = picture + (static_cast<size_t>(channel) * height_ + y) * width_;
        const float* focus = in.focus ? in.focus + static_cast<size_t>(y) * width_ : nullptr;
        for (int x = from; x < to; x += kLanes) {
            const int left = to - x;
            F value = load_some(at + x, left);
            if (focus) value = value * load_some(focus + x, left);
            store_some(row + x - from, left, value);
        }
    }

    // Partial derivatives of 1 - SSIM by the image's window statistics: mean, mean square, mean product. Returns the sum of
    // focus (1 - SSIM) over the region.
    double statistics(const LossInput& in, int channel, const Region& wide, const Region& own, Maps& maps) const {
        const auto fill = [&](int y, int from, int to, float* row) {
            focused_row(in, in.image, channel, y, from, to, row);
            focused_row(in, in.target, channel, y, from, to, row + kRow);
            for (int x = 0; x < to - from; x += kLanes) {  // beyond `to` both pictures are zero
                const F a = load(row + x), b = load(row + kRow + x);
                store(row + 2 * kRow + x, a * a + b * b);
                store(row + 3 * kRow + x, a * b);
            }
        };
        double total = 0;
        for (int x0 = wide.x0; x0 < wide.x1; x0 += kStrip) {
            const int x1 = std::min(wide.x1, x0 + kStrip);
            blur_strip<4>(wide.y0, wide.y1, x0, x1, fill, [&](int y, const float* blurred) {
                const double row = take_statistics(in, y, x0, x1, own, blurred, maps);
                if (y >= own.y0 && y < own.y1) total += row;
            });
        }
        return total;
    }

    double take_statistics(const LossInput& in, int y, int x0, int x1, const Region& own, const float* blurred, Maps& maps) const {
        const float* focus = in.focus ? in.focus + static_cast<size_t>(y) * width_ : nullptr;
        F total = splat(0.0f);
        for (int x = x0; x < x1; x += kLanes) {
            const float* at = blurred + (x - x0);
            const F ma = load(at), mb = load(at + kStrip), squares = load(at + 2 * kStrip), ab = load(at + 3 * kStrip);
            const F weight = load_some(focus ? focus + x : ones(), width_ - x);
            const float c1 = 0.0001f, c2 = 0.0009f;
            const F mab = ma * mb, means = ma * ma + mb * mb;
            const F n1 = mab * 2.0f + c1, n2 = (ab - mab) * 2.0f + c2;
            const F d1 = means + c1, d2 = (squares - means) + c2;
            const F inverse = 1.0f / (d1 * d2), similarity = n1 * n2 * inverse;
            const F inverse1 = inverse * d2, inverse2 = inverse * d1;
            // Derivatives of focus (1 - SSIM), hence the negated signs.
            const F to_ab = weight * n1 * inverse * -2.0f;
            const F to_squares = weight * similarity * inverse2;
            const F to_mean = weight * (mb * (n1 - n2) * inverse * 2.0f + similarity * ma * (inverse1 - inverse2) * 2.0f);
            store(maps.at(0, x, y), to_mean);
            store(maps.at(1, x, y), to_squares);
            store(maps.at(2, x, y), to_ab);
            const F column = lane_numbers() + static_cast<float>(x);
            const M counted = (column >= static_cast<float>(own.x0)) & (column < static_cast<float>(own.x1));
            total = total + select(counted, weight * (1.0f - similarity), splat(0.0f));
        }
        return sum_of(total);
    }

    static F lane_numbers() {
        static const float values[kLanes] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
        return load(values);
    }

    static const float* ones() {
        static const float values[kLanes] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
        return values;
    }

    // Gradient over the region; returns its sum of l1_weight |image - target|.
    double derivatives(const LossInput& in, float* gradient, int channel, const Region& r, Maps& maps) const {
        const auto fill = [&](int y, int from, int to, float* row) {
            for (int k = 0; k < 3; ++k) std::memcpy(row + k * kRow, maps.at(k, from, y), sizeof(float) * (to - from));
        };
        double l1 = 0;
        for (int x0 = r.x0; x0 < r.x1; x0 += kStrip) {
            const int x1 = std::min(r.x1, x0 + kStrip);
            const auto take = [&](int y, const float* blurred) { l1 += finish(in, gradient, channel, y, x0, x1, blurred); };
            if (in.ssim_scale != 0.0f)
                blur_strip<3>(r.y0, r.y1, x0, x1, fill, take);
            else
                for (int y = r.y0; y < r.y1; ++y) take(y, nullptr);
        }
        return l1;
    }

    // Gradient of columns [x0, x1) of a row; returns the row's share of L1.
    double finish(const LossInput& in, float* gradient, int channel, int y, int x0, int x1, const float* blurred) const {
        const size_t pixel = static_cast<size_t>(y) * width_, line = static_cast<size_t>(channel) * height_ + y;
        const F zero = splat(0.0f), one = splat(1.0f);
        F l1 = zero;
        for (int x = x0; x < x1; x += kLanes) {
            const int left = x1 - x;
            const F a = load_some(in.image + line * width_ + x, left), b = load_some(in.target + line * width_ + x, left);
            const F weight = in.l1_weight ? load_some(in.l1_weight + pixel + x, left) : one;
            const F difference = a - b;
            l1 = l1 + weight * max(difference, -difference);
            F value = weight * in.l1_scale * (select(difference > 0.0f, one, zero) - select(difference < 0.0f, one, zero));
            if (blurred) {
                const float* at = blurred + (x - x0);
                const F focus = in.focus ? load_some(in.focus + pixel + x, left) : one;
                const F back = load(at) + (a * focus) * load(at + kStrip) * 2.0f + (b * focus) * load(at + 2 * kStrip);
                value = value + focus * in.ssim_scale * back;
            }
            store_some(gradient + line * width_ + x, left, value);
        }
        return sum_of(l1);
    }

    int width_ = 0, height_ = 0;
    std::vector<Region> regions_;
    std::vector<LossSums> sums_;
};

}  // namespace decogs
