// Neural transformation cache (3DGStream, Sun 2024): hash grid and MLP, forward, backward and Adam.
//
// Work is divided by level and by chunk, never by thread, and every sum has a fixed order: results are independent of the
// number of threads and of the instruction set.
#pragma once

#include "adam.h"
#include "grid.h"
#include "network.h"
#include "pool.h"
#include "project.h"
#include "transform.h"

namespace decogs {

struct CacheShape {  // mirrored by ctypes
    int32_t levels, features, table_log2, hidden_layers, hidden_width;
    const int32_t* resolutions;
    double low[3], high[3];  // the box, world units
    float translation_scale, gradient_limit;
};

struct Trained {  // parameters and Adam's moments; mirrored by ctypes
    float *value, *first, *second;
};

struct Moved {  // state of sixteen Gaussians for the backward pass
    Quaternions base, turn;
    F turn_norm;
};

constexpr int64_t kRowsPerTask = 4096;

inline int tasks_of(int64_t count, int64_t size) { return static_cast<int>((count + size - 1) / size); }

class Cache {
   public:
    Cache(const CacheShape& shape, int threads)
        : low_{shape.low[0], shape.low[1], shape.low[2]},
          high_{shape.high[0], shape.high[1], shape.high[2]},
          translation_scale_(shape.translation_scale),
          gradient_limit_(shape.gradient_limit),
          grid_{shape.levels, shape.features, shape.table_log2, {shape.resolutions, shape.resolutions + shape.levels}},
          network_(shape.levels * shape.features, shape.hidden_layers, shape.hidden_width),
          levels_(shape.levels),
          head_(network_.size),
          transposed_(network_.size),
          head_gradient_(network_.size),
          pool_(threads) {}

    // Fixes the points at which the grid is sampled; returns the number of table entries read.
    int64_t place(int64_t count, const float* means) {
        inside_.clear();
        for (auto& axis : points_.at) axis.clear();
        for (int64_t i = 0; i < count; ++i) {
            double p[3];
            bool inside = true;
            for (int a = 0; a < 3; ++a) {
                p[a] = (static_cast<double>(means[3 * i + a]) - low_[a]) / (high_[a] - low_[a]);
                inside = inside && p[a] >= 0.0 && p[a] <= 1.0;
            }
            if (!inside) continue;
            inside_.push_back(i);
            for (int a = 0; a < 3; ++a) points_.at[a].push_back(p[a]);
        }
        points_.count = static_cast<int64_t>(inside_.size());
        points_.padded = (points_.count + kLanes - 1) / kLanes * kLanes;
        if (points_.count) {
            inside_.resize(points_.padded, inside_.back());
            for (auto& axis : points_.at) axis.resize(points_.padded, axis.back());
        }
        pool_.run(grid_.levels, [&](int level) { place_level(grid_, level, points_, levels_[level]); });
        int64_t rows = 0;
        for (LevelReading& level : levels_) {
            level.first_row = rows;
            rows += static_cast<int64_t>(level.entries.size());
        }
        features_.resize(points_.padded * grid_.levels * grid_.features);
        v_features_.resize(features_.size());
        hidden_.resize(network_.layers.size() - 1);
        for (size_t k = 0; k < hidden_.size(); ++k) hidden_[k].assign(points_.padded * network_.layers[k].out_padded());
        moved_.resize(points_.padded / kLanes);
        return rows;
    }

    void entries(int64_t* to) const {
        for (int level = 0; level < grid_.levels; ++level)
            for (uint32_t entry : levels_[level].entries) *to++ = (int64_t{level} << grid_.table_log2) + entry;
    }

    // Base values of all Gaussians. Quaternions are normalised in float64: correctly rounded, and without overflow.
    void base(int64_t count, const float* means, const float* quaternions) {
        means_.assign(means, means + 3 * count);
        units_.resize(4 * count);
        norms_.resize(count);
        pool_.run(tasks_of(count, kRowsPerTask), [&](int task) {
            for (int64_t i = task * kRowsPerTask; i < std::min(count, (task + 1) * kRowsPerTask); ++i) {
                const float* q = quaternions + 4 * i;
                const double w = q[0], x = q[1], y = q[2], z = q[3];
                const double norm = std::sqrt(w * w + x * x + y * y + z * z);
                const bool turned = norm > kLeastNorm;  // a zero quaternion is the identity, as in the rasteriser
                for (int k = 0; k < 4; ++k)
                    units_[4 * i + k] = turned ? static_cast<float>(q[k] / norm) : k == 0 ? 1.0f : 0.0f;
                norms_[i] = static_cast<float>(norm);
            }
        });
    }

    void read(const float* values) {
        pool_.run(grid_.levels, [&](int level) { read_features(level, values); });
    }

    // MLP and transformation, from the features as last read.
    void moved(const float* head, float* means, float* quaternions) {
        std::copy(means_.begin(), means_.end(), means);
        std::copy(units_.begin(), units_.end(), quaternions);
        std::copy(head, head + network_.size, head_.data());
        network_.transpose(head, transposed_.data());
        pool_.run(tasks_of(points_.padded, kChunk), [&](int chunk) {
            Floats inputs(kBlock * network_.layers.front().given_padded()), outputs(kBlock * kOutPadded);
            for_blocks(chunk, [&](int64_t begin, int rows) {
                gather_inputs(begin, rows, inputs.data());
                const float* x = inputs.data();
                for (size_t k = 0; k < network_.layers.size(); ++k) {
                    const bool last = k + 1 == network_.layers.size();
                    float* to = last ? outputs.data() : hidden(k, begin);
                    layer_forward(network_.layers[k], last, head_.data(), transposed_.data(), rows, x, to);
                    x = to;
                }
                for (int i = 0; i < rows; i += kLanes) move_group(begin + i, x + i * kOutPadded, means, quaternions);
            });
        });
    }

    // Accumulates the parameters' gradients and writes those of the base values.
    void backward(const float* v_means, const float* v_quaternions, float* v_base_means, float* v_base_quaternions) {
        const int64_t count = static_cast<int64_t>(norms_.size());
        const float limit = gradient_limit_;
        for (int64_t k = 0; k < 3 * count; ++k) v_base_means[k] = std::min(std::max(v_means[k], -limit), limit);
        for (int64_t k = 0; k < 4 * count; ++k) v_base_quaternions[k] = std::min(std::max(v_quaternions[k], -limit), limit);
        const int chunks = tasks_of(points_.padded, kChunk);
        partial_.assign(chunks * network_.size);
        pool_.run(chunks, [&](int chunk) {
            Floats inputs(kBlock * network_.layers.front().given_padded()), v_inputs = inputs;
            std::vector<Floats> v;
            for (const Layer& layer : network_.layers) v.emplace_back(kBlock * layer.out_padded());
            float* gradient = partial_.data() + chunk * network_.size;
            for_blocks(chunk, [&](int64_t begin, int rows) {
                gather_inputs(begin, rows, inputs.data());
                for (int i = 0; i < rows; i += kLanes)
                    move_group_back(begin + i, v_base_means, v_base_quaternions, v.back().data() + i * kOutPadded);
                for (size_t k = network_.layers.size(); k-- > 0;) {
                    const float* x = k ? hidden(k - 1, begin) : inputs.data();
                    layer_gradient(network_.layers[k], rows, x, v[k].data(), gradient);
                    layer_backward(network_.layers[k], head_.data(), rows, v[k].data(), k ? x : nullptr,
                                   k ? v[k - 1].data() : v_inputs.data());
                }
                scatter_inputs(begin, rows, v_inputs.data());
            });
        });
        head_gradient_.assign(network_.size);
        for (int chunk = 0; chunk < chunks; ++chunk)
            for (int64_t k = 0; k < network_.size; k += kLanes) {
                float* sum = head_gradient_.data() + k;
                store(sum, load(sum) + load(partial_.data() + chunk * network_.size + k));
            }
        pool_.run(tasks_of(count, kRowsPerTask), [&](int task) {
            for (int64_t base = task * kRowsPerTask; base < std::min(count, (task + 1) * kRowsPerTask); base += kLanes)
                through_base_norm(base, static_cast<int>(std::min<int64_t>(kLanes, count - base)), v_base_quaternions);
        });
    }

    void gradients(float* rows, float* head) {
        pool_.run(grid_.levels, [&](int level) {
            const size_t values = levels_[level].entries.size() * grid_.features;
            float* to = rows + levels_[level].first_row * grid_.features;
            std::fill(to, to + values, 0.0f);
            scatter_level(levels_[level], grid_.features, v_features(level), to);
        });
        std::copy(head_gradient_.data(), head_gradient_.data() + network_.size, head);
    }

    // One Adam step. Each level accumulates its gradient, takes the step and reads its features while its rows are in cache.
    void step(const AdamStep& adam, float rate, const Trained& rows, const Trained& head) {
        const std::vector<float> rates(1 + kLanes, rate);
        pool_.run(grid_.levels, [&](int level) {
            const size_t values = levels_[level].entries.size() * grid_.features;
            const int64_t at = levels_[level].first_row * grid_.features;
            static thread_local std::vector<float> gradient;  // reused: allocating it costs as much as the step
            gradient.assign(values, 0.0f);
            scatter_level(levels_[level], grid_.features, v_features(level), gradient.data());
            adam_run(adam, values, 1, rates.data(), rows.value + at, gradient.data(), rows.first + at, rows.second + at);
            read_features(level, rows.value);
        });
        adam_run(adam, network_.size, 1, rates.data(), head.value, head_gradient_.data(), head.first, head.second);
    }

   private:
    static constexpr int kOutPadded = kLanes;
    static constexpr double kLeastNorm = 1e-18;
    static_assert(kOutputs <= kOutPadded);

    float* features(int level) { return features_.data() + level * points_.padded * grid_.features; }
    float* v_features(int level) { return v_features_.data() + level * points_.padded * grid_.features; }
    float* hidden(size_t layer, int64_t row) { return hidden_[layer].data() + row * network_.layers[layer].out_padded(); }

    void read_features(int level, const float* values) {
        read_level(levels_[level], grid_.features, values + levels_[level].first_row * grid_.features, features(level));
    }

    // Calls work(first row, number of rows) for the blocks of one chunk.
    template <class Work>
    void for_blocks(int chunk, const Work& work) const {
        const int64_t end = std::min<int64_t>(points_.padded, (chunk + int64_t{1}) * kChunk);
        for (int64_t begin = chunk * int64_t{kChunk}; begin < end; begin += kBlock)
            work(begin, static_cast<int>(std::min<int64_t>(kBlock, end - begin)));
    }

    // Transposes level-major features to the MLP's row-major inputs, and back.
    void gather_inputs(int64_t begin, int rows, float* to) {
        const int64_t width = network_.layers.front().given_padded(), count = grid_.features;
        for (int level = 0; level < grid_.levels; ++level) {
            const float* from = features(level) + begin * count;
            for (int i = 0; i < rows; ++i) copy_features(count, from + i * count, to + i * width + level * count);
        }
    }

    void scatter_inputs(int64_t begin, int rows, const float* v) {
        const int64_t width = network_.layers.front().given_padded(), count = grid_.features;
        for (int level = 0; level < grid_.levels; ++level) {
            float* to = v_features(level) + begin * count;
            for (int i = 0; i < rows; ++i) copy_features(count, v + i * width + level * count, to + i * count);
        }
    }

    static void copy_features(int64_t count, const float* from, float* to) {
        if (count == 4)  // a known size compiles to one move
            std::memcpy(to, from, 4 * sizeof(float));
        else
            std::copy(from, from + count, to);
    }

    int lanes_used(int64_t base) const { return static_cast<int>(std::min<int64_t>(kLanes, points_.count - base)); }

    void move_group(int64_t base, const float* out, float* means, float* quaternions) {
        const int64_t* rows = &inside_[base];
        F given[8], mean[3];
        load_columns(out, kFirstRows, kOutPadded, 8, given);
        load_columns(means_.data(), rows, 3, 3, mean);
        Moved& kept = moved_[base / kLanes];
        load_columns(units_.data(), rows, 4, 4, kept.base.c);
        kept.turn = normalise({{given[3], given[4], given[5], given[6]}}, kept.turn_norm);
        for (int k = 0; k < 3; ++k) mean[k] = mean[k] + given[k] * translation_scale_;
        store_columns(means, rows, lanes_used(base), 3, 3, mean);
        store_columns(quaternions, rows, lanes_used(base), 4, 4, multiply(kept.base, kept.turn).c);
    }

    // Cotangents v_out (16, padded outputs) of the MLP's outputs. In `v_quaternions`, cotangents of the unit base quaternions
    // replace those of the moved ones.
    void move_group_back(int64_t base, const float* v_means, float* v_quaternions, float* v_out) {
        const int64_t* rows = &inside_[base];
        const int used = lanes_used(base);
        const M real = load(kLaneNumbers) < static_cast<float>(used);
        const Moved& kept = moved_[base / kLanes];
        F v[8];
        Quaternions v_moved;
        load_columns(v_means, rows, 3, 3, v);
        load_columns(v_quaternions, rows, 4, 4, v_moved.c);
        // The adjoint of multiplication by a quaternion is multiplication by its conjugate.
        const Quaternions v_unit_turn = multiply(conjugate(kept.base), v_moved);
        const Quaternions v_turn = through_norm(kept.turn, kept.turn_norm, kept.turn_norm > kTiny, v_unit_turn);
        for (int k = 0; k < 3; ++k) v[k] = select(real, v[k] * translation_scale_, splat(0.0f));
        for (int k = 0; k < 4; ++k) v[3 + k] = select(real, v_turn.c[k], splat(0.0f));
        v[7] = splat(0.0f);
        store_columns(v_out, kFirstRows, kLanes, kOutPadded, 8, v);
        store_columns(v_quaternions, rows, used, 4, 4, multiply(v_moved, conjugate(kept.turn)).c);
    }

    void through_base_norm(int64_t base, int used, float* v_quaternions) {
        int64_t rows[kLanes];
        for (int i = 0; i < kLanes; ++i) rows[i] = base + std::min(i, used - 1);
        Quaternions unit, v;
        load_columns(units_.data(), rows, 4, 4, unit.c);
        load_columns(v_quaternions, rows, 4, 4, v.c);
        const F norm = gather(norms_.data(), rows, 1, 0);
        v = through_norm(unit, norm, norm > static_cast<float>(kLeastNorm), v);
        const float limit = gradient_limit_;  // the gradient grows as 1 / norm
        for (F& c : v.c) c = min(max(c, -limit), limit);
        store_columns(v_quaternions, rows, used, 4, 4, v.c);
    }

    static constexpr int64_t kFirstRows[kLanes] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
    static constexpr float kLaneNumbers[kLanes] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};

    const double low_[3], high_[3];
    const float translation_scale_, gradient_limit_;
    Grid grid_;
    Network network_;
    Points points_;
    std::vector<int64_t> inside_;  // the Gaussians in the box, padded like the points
    std::vector<LevelReading> levels_;
    std::vector<float> means_, units_, norms_;        // of all Gaussians, (M, 3), (M, 4), (M,)
    std::vector<float> features_, v_features_;        // (levels, padded, features)
    std::vector<Floats> hidden_;                      // activations of each hidden layer, (padded, out)
    std::vector<Moved> moved_;                        // (padded / 16,)
    Floats head_, transposed_, partial_, head_gradient_;
    Pool pool_;
};

}  // namespace decogs
