// L1 and structural similarity of a picture against its target, with the gradient, in one pass over planar pictures.
//
// SSIM (Wang 2004): 11x11 Gaussian window of sigma 1.5, zero outside the picture, C1 = 0.01^2, C2 = 0.03^2, as 3DGS uses it.
#pragma once

#include <algorithm>
#include <vector>

#include "pool.h"
#include "simd.h"

namespace decogs {

struct LossInput {  // mirrored by ctypes
    const float* image;     // (3, H, W)
    const float* target;    // (3, H, W)
    const float* l1_weight; // (H, W), multiplies |image - target|; null: everywhere 1
    const float* focus;     // (H, W) multiplies both pictures before SSIM and weighs its map; null: everywhere 1
    float l1_scale;         // factors that turn the weighted sums into the loss
    float ssim_scale;
    int32_t width, height;
};

struct LossSums {  // over all pixels and channels
    double l1;    // sum of l1_weight |image - target|
    double ssim;  // sum of focus (1 - SSIM)
    double square;  // sum of (image - target)^2
};

class Loss {
   public:
    // Writes the gradient of l1_scale * l1 + ssim_scale * ssim to `gradient`, (3, H, W).
    LossSums run(Pool& pool, const LossInput& in, float* gradient) {
        width_ = in.width;
        height_ = in.height;
        stride_ = (width_ + kLanes - 1) / kLanes * kLanes;
        row_sums_.assign(static_cast<size_t>(height_) * 3, LossSums{0, 0, 0});
        const int bands = (height_ + kBand - 1) / kBand;
        if (in.ssim_scale != 0.0f) {
            for (auto& map : maps_) map.resize(static_cast<size_t>(stride_) * height_ * 3);
            pool.run(3 * bands, [&](int task) { statistics(in, task / bands, task % bands); });
        }
        pool.run(3 * bands, [&](int task) { derivatives(in, gradient, task / bands, task % bands); });
        LossSums total{0, 0, 0};
        for (const LossSums& row : row_sums_) {
            total.l1 += row.l1;
            total.ssim += row.ssim;
            total.square += row.square;
        }
        return total;
    }

   private:
    // A task is a band of rows, walked in strips of columns so that what the window reads stays in the first-level cache.
    static constexpr int kRadius = 5, kTaps = 11, kBand = 64, kStrip = 128, kMargin = 16, kRow = kStrip + 2 * kMargin;

    static const float* window() {
        static const float taps[6] = {0.26601171f, 0.21300553f, 0.10936069f, 0.036000773f, 0.0075987577f, 0.0010283801f};
        return taps;  // centre outwards
    }

    // Blurs `kCount` fields of columns [x0, x1) of the rows [y0, y1). fill(y, from, to, row) writes columns [from, to) of
    // row y of field k to row[k * kRow]..., take(y, blurred) receives every row, field k at blurred + k * kStrip.
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

    // Partial derivatives of 1 - SSIM in the window's statistics of the image: mean, mean square, mean product.
    void statistics(const LossInput& in, int channel, int band) {
        const int y0 = band * kBand, y1 = std::min(height_, y0 + kBand);
        const auto fill = [&](int y, int from, int to, float* row) {
            focused_row(in, in.image, channel, y, from, to, row);
            focused_row(in, in.target, channel, y, from, to, row + kRow);
            for (int x = 0; x < to - from; x += kLanes) {  // past `to` both pictures are zero, up to the end of the row
                const F a = load(row + x), b = load(row + kRow + x);
                store(row + 2 * kRow + x, a * a + b * b);
                store(row + 3 * kRow + x, a * b);
            }
        };
        for (int x0 = 0; x0 < stride_; x0 += kStrip) {
            const int x1 = std::min(stride_, x0 + kStrip);
            blur_strip<4>(y0, y1, x0, x1, fill, [&](int y, const float* blurred) { take_statistics(in, channel, y, x0, x1, blurred); });
        }
    }

    void take_statistics(const LossInput& in, int channel, int y, int x0, int x1, const float* blurred) {
        const size_t line = static_cast<size_t>(channel) * height_ + y;
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
            // 1 - SSIM: signs turned, weighted.
            const F to_ab = weight * n1 * inverse * -2.0f;
            const F to_squares = weight * similarity * inverse2;
            const F to_mean = weight * (mb * (n1 - n2) * inverse * 2.0f + similarity * ma * (inverse1 - inverse2) * 2.0f);
            const size_t to = line * stride_ + x;
            store(&maps_[0][to], to_mean);
            store(&maps_[1][to], to_squares);
            store(&maps_[2][to], to_ab);
            total = total + weight * (1.0f - similarity);
        }
        row_sums_[line].ssim += sum_of(total);
    }

    static const float* ones() {
        static const float values[kLanes] = {1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
        return values;
    }

    void derivatives(const LossInput& in, float* gradient, int channel, int band) {
        const int y0 = band * kBand, y1 = std::min(height_, y0 + kBand);
        const auto fill = [&](int y, int from, int to, float* row) {
            const size_t at = (static_cast<size_t>(channel) * height_ + y) * stride_ + from;
            for (int k = 0; k < 3; ++k) std::memcpy(row + k * kRow, &maps_[k][at], sizeof(float) * (to - from));
        };
        for (int x0 = 0; x0 < stride_; x0 += kStrip) {
            const int x1 = std::min(stride_, x0 + kStrip);
            if (in.ssim_scale != 0.0f)
                blur_strip<3>(y0, y1, x0, x1, fill, [&](int y, const float* blurred) { finish(in, gradient, channel, y, x0, x1, blurred); });
            else
                for (int y = y0; y < y1; ++y) finish(in, gradient, channel, y, x0, x1, nullptr);
        }
    }

    // The gradient of columns [x0, x1) of a row, and what the row adds to L1 and mean square.
    void finish(const LossInput& in, float* gradient, int channel, int y, int x0, int x1, const float* blurred) {
        const size_t pixel = static_cast<size_t>(y) * width_, line = static_cast<size_t>(channel) * height_ + y;
        const F zero = splat(0.0f), one = splat(1.0f);
        F l1 = zero, square = zero;
        for (int x = x0; x < std::min(x1, width_); x += kLanes) {
            const int left = width_ - x;
            const F a = load_some(in.image + line * width_ + x, left), b = load_some(in.target + line * width_ + x, left);
            const F weight = in.l1_weight ? load_some(in.l1_weight + pixel + x, left) : one;
            const F difference = a - b;
            l1 = l1 + weight * max(difference, -difference);
            square = square + difference * difference;
            F value = weight * in.l1_scale * (select(difference > 0.0f, one, zero) - select(difference < 0.0f, one, zero));
            if (blurred) {
                const float* at = blurred + (x - x0);
                const F focus = in.focus ? load_some(in.focus + pixel + x, left) : one;
                const F back = load(at) + (a * focus) * load(at + kStrip) * 2.0f + (b * focus) * load(at + 2 * kStrip);
                value = value + focus * in.ssim_scale * back;
            }
            store_some(gradient + line * width_ + x, left, value);
        }
        row_sums_[line].l1 += sum_of(l1);
        row_sums_[line].square += sum_of(square);
    }

    int width_ = 0, height_ = 0, stride_ = 0;
    std::vector<float> maps_[3];
    std::vector<LossSums> row_sums_;
};

}  // namespace decogs
