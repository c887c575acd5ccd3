// Adam (Kingma 2015) on chosen rows only: the others keep value and moments, bit for bit.
#pragma once

#include <cmath>

#include "pool.h"

namespace decogs {

struct AdamStep {  // mirrored by ctypes
    float beta1, beta2, epsilon;
    float correction1, correction2;  // 1 - beta^t of the step
};

inline void adam_rows(Pool& pool, const AdamStep& step, int64_t row_count, const int64_t* rows, int columns,
                      const float* rates, float* value, const float* gradient, float* first, float* second) {
    constexpr int64_t kRows = 4096;
    const int tasks = static_cast<int>((row_count + kRows - 1) / kRows);
    const float first_scale = 1.0f / step.correction1, root = 1.0f / std::sqrt(step.correction2);
    pool.run(tasks, [&](int task) {
        const int64_t end = std::min(row_count, (task + 1) * kRows);
        for (int64_t r = task * kRows; r < end; ++r) {
            const int64_t base = (rows ? rows[r] : r) * columns;
            for (int c = 0; c < columns; ++c) {
                const int64_t k = base + c;
                const float g = gradient[k];
                first[k] = step.beta1 * first[k] + (1.0f - step.beta1) * g;
                second[k] = step.beta2 * second[k] + (1.0f - step.beta2) * (g * g);
                value[k] -= rates[c] * (first[k] * first_scale) / (std::sqrt(second[k]) * root + step.epsilon);
            }
        }
    });
}

}  // namespace decogs
