// L1 and structural similarity of a picture against its target, with the gradient, in one pass over planar pictures.
//
// SSIM (Wang 2004): 11x11 Gaussian window of sigma 1.5, zero outside the picture, C1 = 0.01^2, C2 = 0.03^2, as 3DGS uses it.
#pragma once

#include <cmath>
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
        const size_t padded = static_cast<size_t>(stride_) * height_;
        for (auto& map : maps_) map.resize(padded * 3);
        row_sums_.assign(static_cast<size_t>(height_) * 3, LossSums{0, 0, 0});
        const int bands = (height_ + kBand - 1) / kBand;
        if (in.ssim_scale != 0.0f) pool.run(3 * bands, [&](int task) { statistics(in, task / bands, task % bands); });
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
    static constexpr int kRadius = 5, kTaps = 11, kBand = 32, kMargin = 16;

    static const float* window() {
        static const float taps[6] = {0.26601171f, 0.21300553f, 0.10936069f, 0.036000773f, 0.0075987577f, 0.0010283801f};
        return taps;  // centre outwards
    }

    // One row through the window; `row` has kMargin zeros on either side.
    static void blur_row(const float* row, int width, float* out) {
        const float* w = window();
        for (int x = 0; x < width; x += kLanes) {
            const float* at = row + x;
            F sum = load(at) * w[0];
            for (int k = 1; k <= kRadius; ++k) sum = sum + (load(at - k) + load(at + k)) * w[k];
            store(out + x, sum);
        }
    }

    // Blurs `kCount` fields of the band's rows; field(y, k, row) fills row y of field k, take(y, blurred) receives each.
    template <int kCount, class Fill, class Take>
    void blur_band(int first, int last, const Fill& fill, const Take& take) const {
        std::vector<float> ring(static_cast<size_t>(kTaps) * kCount * stride_, 0.0f);
        std::vector<float> rows(static_cast<size_t>(kCount) * (stride_ + 2 * kMargin), 0.0f);
        std::vector<float> out(static_cast<size_t>(kCount) * stride_);
        const float* w = window();
        const auto slot = [&](int y, int k) { return ring.data() + (static_cast<size_t>((y + 2 * kTaps) % kTaps) * kCount + k) * stride_; };
        for (int y = first - kRadius; y < last + kRadius; ++y) {
            if (y >= 0 && y < height_) {
                fill(y, rows.data() + kMargin, stride_ + 2 * kMargin);
                for (int k = 0; k < kCount; ++k)
                    blur_row(rows.data() + static_cast<size_t>(k) * (stride_ + 2 * kMargin) + kMargin, stride_, slot(y, k));
            } else {
                for (int k = 0; k < kCount; ++k) std::fill(slot(y, k), slot(y, k) + stride_, 0.0f);
            }
            const int centre = y - kRadius;
            if (centre < first) continue;
            for (int k = 0; k < kCount; ++k) {
                const float* rings[kTaps];
                for (int d = 0; d < kTaps; ++d) rings[d] = slot(centre + d - kRadius, k);
                float* to = out.data() + static_cast<size_t>(k) * stride_;
                for (int x = 0; x < stride_; x += kLanes) {
                    F sum = load(rings[kRadius] + x) * w[0];
                    for (int d = 1; d <= kRadius; ++d) sum = sum + (load(rings[kRadius - d] + x) + load(rings[kRadius + d] + x)) * w[d];
                    store(to + x, sum);
                }
            }
            take(centre, out.data());
        }
    }

    void focused_row(const LossInput& in, const float* picture, int channel, int y, float* row) const {
        const float* from = picture + (static_cast<size_t>(channel) * height_ + y) * width_;
        if (!in.focus) {
            std::memcpy(row, from, sizeof(float) * width_);
            return;
        }
        const float* focus = in.focus + static_cast<size_t>(y) * width_;
        for (int x = 0; x < width_; ++x) row[x] = from[x] * focus[x];
    }

    // Partial derivatives of 1 - SSIM in the window's statistics of the image: mean, mean square, mean product.
    void statistics(const LossInput& in, int channel, int band) {
        const int first = band * kBand, last = std::min(height_, first + kBand);
        const auto fill = [&](int y, float* rows, int step) {
            float *a = rows, *b = rows + step, *aa = rows + 2 * step, *bb = rows + 3 * step, *ab = rows + 4 * step;
            focused_row(in, in.image, channel, y, a);
            focused_row(in, in.target, channel, y, b);
            for (int x = 0; x < width_; ++x) {
                aa[x] = a[x] * a[x];
                bb[x] = b[x] * b[x];
                ab[x] = a[x] * b[x];
            }
        };
        const auto take = [&](int y, const float* blurred) {
            const size_t row = (static_cast<size_t>(channel) * height_ + y) * stride_;
            const float* focus = in.focus ? in.focus + static_cast<size_t>(y) * width_ : nullptr;
            std::vector<float>& weights = focus_row();
            weights.assign(stride_, 0.0f);
            for (int x = 0; x < width_; ++x) weights[x] = focus ? focus[x] : 1.0f;
            double total = 0;
            for (int x = 0; x < stride_; x += kLanes) {
                const F ma = load(blurred + x), mb = load(blurred + stride_ + x), aa = load(blurred + 2 * stride_ + x);
                const F bb = load(blurred + 3 * stride_ + x), ab = load(blurred + 4 * stride_ + x), weight = load(&weights[x]);
                const float c1 = 0.0001f, c2 = 0.0009f;
                const F mab = ma * mb, maa = ma * ma, mbb = mb * mb;
                const F n1 = mab * 2.0f + c1, n2 = (ab - mab) * 2.0f + c2;
                const F d1 = maa + mbb + c1, d2 = (aa - maa) + (bb - mbb) + c2;
                const F inverse = 1.0f / (d1 * d2), similarity = n1 * n2 * inverse;
                // 1 - SSIM: signs turned, weighted.
                const F to_ab = weight * n1 * inverse * -2.0f;
                const F to_aa = weight * similarity / d2;
                const F to_mean = weight * (mb * (n1 - n2) * inverse * 2.0f + similarity * ma * (1.0f / d1 - 1.0f / d2) * 2.0f);
                store(&maps_[0][row + x], to_mean);
                store(&maps_[1][row + x], to_aa);
                store(&maps_[2][row + x], to_ab);
                float loss[kLanes];
                store(loss, weight * (1.0f - similarity));
                for (int i = 0; i < kLanes; ++i) total += loss[i];
            }
            row_sums_[static_cast<size_t>(channel) * height_ + y].ssim = total;
        };
        blur_band<5>(first, last, fill, take);
    }

    static std::vector<float>& focus_row() {
        static thread_local std::vector<float> row;
        return row;
    }

    void derivatives(const LossInput& in, float* gradient, int channel, int band) {
        const int first = band * kBand, last = std::min(height_, first + kBand);
        const bool similarity = in.ssim_scale != 0.0f;
        const auto finish = [&](int y, const float* blurred) {
            const size_t pixel = static_cast<size_t>(y) * width_, row = static_cast<size_t>(channel) * height_ * width_ + pixel;
            double l1 = 0, square = 0;
            for (int x = 0; x < width_; ++x) {
                const float difference = in.image[row + x] - in.target[row + x];
                const float weight = in.l1_weight ? in.l1_weight[pixel + x] : 1.0f;
                l1 += weight * std::fabs(difference);
                square += difference * difference;
                const float sign = static_cast<float>((difference > 0.0f) - (difference < 0.0f));
                float value = in.l1_scale * weight * sign;
                if (similarity) {
                    const float focus = in.focus ? in.focus[pixel + x] : 1.0f;
                    const float a = in.image[row + x] * focus, b = in.target[row + x] * focus;
                    const float back = blurred[x] + 2.0f * a * blurred[stride_ + x] + b * blurred[2 * stride_ + x];
                    value += in.ssim_scale * focus * back;
                }
                gradient[row + x] = value;
            }
            LossSums& sums = row_sums_[static_cast<size_t>(channel) * height_ + y];
            sums.l1 = l1;
            sums.square = square;
        };
        if (!similarity) {
            for (int y = first; y < last; ++y) finish(y, nullptr);
            return;
        }
        const auto fill = [&](int y, float* rows, int step) {
            const size_t row = (static_cast<size_t>(channel) * height_ + y) * stride_;
            for (int k = 0; k < 3; ++k) std::memcpy(rows + k * step, &maps_[k][row], sizeof(float) * width_);
        };
        blur_band<3>(first, last, fill, finish);
    }

    int width_ = 0, height_ = 0, stride_ = 0;
    std::vector<float> maps_[3];
    std::vector<LossSums> row_sums_;
};

}  // namespace decogs
