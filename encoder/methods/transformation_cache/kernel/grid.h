// Multi-resolution hash grid (Instant-NGP, Mueller 2022), sampled at fixed points.
//
// Placing computes each point's table entries and trilinear weights once. Only entries that a point reads are stored: each
// level numbers its own in the table's order, and values, gradients and moments are rows in this order, level after level.
// Features are level-major, (levels, padded, features), so that a level's rows stay in cache while they are read.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "simd.h"

namespace decogs {

constexpr int kCorners = 8;
constexpr int kMostFeatures = 32;

struct Grid {
    int levels, features, table_log2;
    std::vector<int32_t> resolutions;  // vertices along each side of the box, per level
};

struct Points {  // in the unit cube, one array per axis; the last point is repeated to fill a group of lanes
    int64_t count = 0, padded = 0;
    std::vector<double> at[3];
};

struct LevelReading {
    std::vector<uint32_t> rows;      // (padded, 8): the level's row of each corner
    std::vector<float> fractions;    // (padded / 16, 3, 16): a point's position in its cell, 0..1
    std::vector<uint32_t> entries;   // the table's entry of each row, ascending
    int64_t first_row = 0;           // of this level among all levels' rows
};

// A vertex's entry in a level's table: dense, x fastest, if all vertices fit; else hashed (Mueller 2022, equation 4).
inline uint32_t table_entry(const Grid& grid, uint32_t resolution, uint32_t x, uint32_t y, uint32_t z) {
    const uint64_t table = uint64_t{1} << grid.table_log2, side = resolution;
    if (side * side <= table && side * side * side <= table) return x + resolution * (y + resolution * z);
    return (x ^ y * 2654435761u ^ z * 805459861u) & static_cast<uint32_t>(table - 1);
}

// Corner k is offset by bits 0, 1, 2 of k along x, y, z. The box's upper faces belong to the last cell.
inline void place_level(const Grid& grid, int level, const Points& points, LevelReading& reading) {
    const int32_t resolution = grid.resolutions[level];
    reading.rows.resize(points.padded * kCorners);
    reading.fractions.resize(points.padded * 3);
    reading.entries.clear();
    std::vector<uint32_t> row_of(size_t{1} << grid.table_log2, 0);
    for (int64_t i = 0; i < points.padded; ++i) {
        uint32_t cell[3];
        for (int axis = 0; axis < 3; ++axis) {
            const double position = points.at[axis][i] * (resolution - 1);
            cell[axis] = static_cast<uint32_t>(std::min(static_cast<int32_t>(position), resolution - 2));
            reading.fractions[(i / kLanes * 3 + axis) * kLanes + i % kLanes] = static_cast<float>(position - cell[axis]);
        }
        for (uint32_t k = 0; k < kCorners; ++k) {
            const uint32_t entry = table_entry(grid, resolution, cell[0] + (k & 1), cell[1] + (k >> 1 & 1), cell[2] + (k >> 2));
            reading.rows[i * kCorners + k] = entry;
            row_of[entry] = 1;
        }
    }
    for (size_t entry = 0; entry < row_of.size(); ++entry) {
        if (!row_of[entry]) continue;
        row_of[entry] = static_cast<uint32_t>(reading.entries.size());
        reading.entries.push_back(static_cast<uint32_t>(entry));
    }
    for (uint32_t& row : reading.rows) row = row_of[row];
}

// Features of one row or point: a vector if their number is a template argument, else (0) an array.
template <int kFeatures>
struct Features {
    typedef float Vector __attribute__((vector_size(4 * kFeatures)));
    Vector sum{};
    DECOGS_INLINE explicit Features(int) {}
    DECOGS_INLINE void load(const float* a) { std::memcpy(&sum, a, sizeof sum); }
    DECOGS_INLINE void add(float weight, const float* a) {
        Vector value;
        std::memcpy(&value, a, sizeof value);
        sum += weight * value;
    }
    DECOGS_INLINE void store(float* a) const { std::memcpy(a, &sum, sizeof sum); }
};
template <>
struct Features<0> {
    float sum[kMostFeatures] = {};
    int count;
    DECOGS_INLINE explicit Features(int features) : count(features) {}
    DECOGS_INLINE void load(const float* a) { std::copy(a, a + count, sum); }
    DECOGS_INLINE void add(float weight, const float* a) {
        for (int f = 0; f < count; ++f) sum[f] += weight * a[f];
    }
    DECOGS_INLINE void store(float* a) const { std::copy(sum, sum + count, a); }
};

// Trilinear weights of sixteen points; to[k][i]: corner k of point i.
DECOGS_INLINE void corner_weights(const float* fractions, float to[kCorners][kLanes]) {
    F side[3][2];
    for (int axis = 0; axis < 3; ++axis) {
        side[axis][1] = load(fractions + axis * kLanes);
        side[axis][0] = 1.0f - side[axis][1];
    }
    for (int k = 0; k < kCorners; ++k) store(to[k], side[0][k & 1] * side[1][k >> 1 & 1] * side[2][k >> 2]);
}

// Calls work(point, its eight rows, weights) for each point; weights[k * kLanes]: corner k.
template <class Work>
DECOGS_INLINE void for_points(const LevelReading& reading, const Work& work) {
    alignas(64) float weights[kCorners][kLanes];
    const int64_t points = static_cast<int64_t>(reading.rows.size()) / kCorners;
    for (int64_t base = 0; base < points; base += kLanes) {
        corner_weights(&reading.fractions[base * 3], weights);
        for (int i = 0; i < kLanes; ++i) work(base + i, &reading.rows[(base + i) * kCorners], &weights[0][i]);
    }
}

// Interpolates one level's features (padded, features) at all points from the level's rows of `values`.
template <int kFeatures>
inline void read_level_of(const LevelReading& reading, int features, const float* values, float* to) {
    if (kFeatures) features = kFeatures;
    for_points(reading, [&](int64_t point, const uint32_t* rows, const float* weights) {
        Features<kFeatures> read(features);
        for (int k = 0; k < kCorners; ++k)
            read.add(weights[k * kLanes], values + static_cast<int64_t>(rows[k]) * features);
        read.store(to + point * features);
    });
}

// Accumulates the features' cotangents into the level's rows of `gradient`, point by point.
template <int kFeatures>
inline void scatter_level_of(const LevelReading& reading, int features, const float* v_features, float* gradient) {
    if (kFeatures) features = kFeatures;
    for_points(reading, [&](int64_t point, const uint32_t* rows, const float* weights) {
        for (int k = 0; k < kCorners; ++k) {
            float* row = gradient + static_cast<int64_t>(rows[k]) * features;
            Features<kFeatures> total(features);
            total.load(row);
            total.add(weights[k * kLanes], v_features + point * features);
            total.store(row);
        }
    });
}

inline void read_level(const LevelReading& reading, int features, const float* values, float* to) {
    if (features == 4) return read_level_of<4>(reading, features, values, to);
    if (features == 2) return read_level_of<2>(reading, features, values, to);
    read_level_of<0>(reading, features, values, to);
}

inline void scatter_level(const LevelReading& reading, int features, const float* v_features, float* gradient) {
    if (features == 4) return scatter_level_of<4>(reading, features, v_features, gradient);
    if (features == 2) return scatter_level_of<2>(reading, features, v_features, gradient);
    scatter_level_of<0>(reading, features, v_features, gradient);
}

}  // namespace decogs
