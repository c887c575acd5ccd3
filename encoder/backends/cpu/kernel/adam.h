// Adam (Kingma 2015, algorithm 1).
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "pool.h"
#include "simd.h"

namespace decogs {

struct AdamStep {  // mirrored by ctypes
    float beta1, beta2, epsilon;
    float correction1, correction2;  // bias corrections 1 - beta^t
};

// One step on `count` consecutive values; rates[k] is the learning rate of value k, with period `columns`.
inline void adam_run(const AdamStep& step, int64_t count, int columns, const float* rates, float* value, const float* gradient,
                     float* first, float* second) {
    const float first_scale = 1.0f / step.correction1, root = 1.0f / std::sqrt(step.correction2);
    int64_t k = 0;
    int column = 0;
    for (; k + kLanes <= count; k += kLanes) {
        const F g = load(gradient + k);
        const F m = load(first + k) * step.beta1 + g * (1.0f - step.beta1);
        const F v = load(second + k) * step.beta2 + g * g * (1.0f - step.beta2);
        store(first + k, m);
        store(second + k, v);
        store(value + k, load(value + k) - load(rates + column) * (m * first_scale) / (sqrt(v) * root + step.epsilon));
        column = (column + kLanes) % columns;
    }
    for (; k < count; ++k) {  // the tail, one value at a time
        const float g = gradient[k];
        first[k] = first[k] * step.beta1 + g * (1.0f - step.beta1);
        second[k] = second[k] * step.beta2 + g * g * (1.0f - step.beta2);
        value[k] -= rates[column] * (first[k] * first_scale) / (std::sqrt(second[k]) * root + step.epsilon);
        column = column + 1 == columns ? 0 : column + 1;
    }
}

// One step on `count` rows of `columns` values.
inline void adam_rows(Pool& pool, const AdamStep& step, int64_t count, int columns, const float* rates, float* value,
                      const float* gradient, float* first, float* second) {
    constexpr int64_t kValues = 2048;  // of a task
    if (count == 0 || columns == 0) return;
    const int64_t size = std::max<int64_t>(1, kValues / columns);
    std::vector<float> repeated(columns + kLanes);
    for (size_t k = 0; k < repeated.size(); ++k) repeated[k] = rates[k % columns];
    pool.run(static_cast<int>((count + size - 1) / size), [&](int task) {
        const int64_t at = task * size * columns, values = std::min(size, count - task * size) * columns;
        adam_run(step, values, columns, repeated.data(), value + at, gradient + at, first + at, second + at);
    });
}

}  // namespace decogs
