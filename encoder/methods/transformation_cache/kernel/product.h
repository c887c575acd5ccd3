// Small dense matrix products with register tiles of four rows by two vectors of columns. Every value is one sum in the
// order of the inner index, whatever the vector width: all instruction sets give the same bits.
#pragma once

#include <cstdint>
#include <vector>

#include "simd.h"

namespace decogs {

constexpr int kTileRows = 4;  // with two vectors of columns, the largest tile for sixteen registers

DECOGS_INLINE NativeF load_native(const float* a) {
    NativeF r;
    std::memcpy(&r, a, sizeof r);
    return r;
}
DECOGS_INLINE void store_native(float* a, const NativeF& x) { std::memcpy(a, &x, sizeof x); }

// Zero-initialised floats, aligned to a cache line: loads that straddle two lines cost a quarter more.
class Floats {
   public:
    explicit Floats(int64_t count = 0) { assign(count); }
    void assign(int64_t count) { lines_.assign((count + kLanes - 1) / kLanes, Line{}); }
    float* data() { return lines_.data()->values; }
    const float* data() const { return lines_.data()->values; }

   private:
    struct alignas(64) Line {
        float values[kLanes];
    };
    std::vector<Line> lines_;
};

struct Left {  // element (i, p) is at[i * row + p * step]
    const float* at;
    int64_t row, step;
};
struct Right {  // element (p, k) is at[p * row + k]
    const float* at;
    int64_t row;
};

template <int kVectors, class Start, class Finish>
DECOGS_INLINE void product_tile(int row, int column, int depth, const Left& left, const Right& right, const Start& start,
                                const Finish& finish) {
    NativeF sum[kTileRows][kVectors];
#pragma GCC unroll 4
    for (int r = 0; r < kTileRows; ++r)
#pragma GCC unroll 2
        for (int v = 0; v < kVectors; ++v) sum[r][v] = start(row + r, column + v * DECOGS_NATIVE);
    const float *a = left.at + row * left.row, *b = right.at + column;
#pragma GCC unroll 2  // measured: without it, compilers keep the rows' addresses in memory
    for (int p = 0; p < depth; ++p, a += left.step, b += right.row) {
        NativeF values[kVectors];
#pragma GCC unroll 2
        for (int v = 0; v < kVectors; ++v) values[v] = load_native(b + v * DECOGS_NATIVE);
#pragma GCC unroll 4
        for (int r = 0; r < kTileRows; ++r) {
            const NativeF factor = a[r * left.row] - NativeF{};
#pragma GCC unroll 2
            for (int v = 0; v < kVectors; ++v) sum[r][v] += factor * values[v];
        }
    }
#pragma GCC unroll 4
    for (int r = 0; r < kTileRows; ++r)
#pragma GCC unroll 2
        for (int v = 0; v < kVectors; ++v) finish(row + r, column + v * DECOGS_NATIVE, sum[r][v]);
}

// finish(i, k, start(i, k) + sum over p < depth of left(i, p) * right(p, k)) for `rows` rows i, a multiple of four, and
// `columns` columns, rounded up to whole vectors; start and finish are called for the vector of columns that begins at k.
template <class Start, class Finish>
inline void product(int rows, int columns, int depth, const Left& left, const Right& right, const Start& start,
                    const Finish& finish) {
    int column = 0;
    for (; column + DECOGS_NATIVE < columns; column += 2 * DECOGS_NATIVE)
        for (int row = 0; row < rows; row += kTileRows) product_tile<2>(row, column, depth, left, right, start, finish);
    if (column < columns)
        for (int row = 0; row < rows; row += kTileRows) product_tile<1>(row, column, depth, left, right, start, finish);
}

}  // namespace decogs
