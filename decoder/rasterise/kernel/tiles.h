// Binning: the list of Gaussians of each 16x16 tile, front to back.
//
// Chosen: one stable radix sort of all visible Gaussians by depth, then one counting sort by tile that keeps this order, so
// that lists are sorted and equal depths keep the scene's order. Rejected: a sort per tile (a Gaussian is sorted once for
// each of its tiles), and the bounding box of three sigma (twice as many pairs as the exact ellipse test).
#pragma once

#include <algorithm>
#include <vector>

#include "pool.h"
#include "project.h"

namespace decogs {

constexpr uint32_t kNoPair = UINT32_MAX;
constexpr uint64_t kMaxPairs = 1u << 27;  // (tile, Gaussian) pairs of one picture, whatever the memory budget

struct Entry {
    uint32_t gaussian;
    uint32_t pair;  // slot of the pair's gradient, or kNoPair; pairs of one Gaussian are consecutive
    int32_t blocks = -1;  // bit mask of the tile's blocks that the ellipse overlaps; -1: not computed yet
};

struct TileLists {
    int columns = 0, rows = 0;
    std::vector<Projected> projected;   // per Gaussian
    std::vector<uint32_t> first_pair;   // per Gaussian, exclusive prefix sum; the total is last
    std::vector<uint32_t> tile_of_pair;
    std::vector<uint32_t> first_entry;  // per tile, exclusive prefix sum; the total is last
    std::vector<Entry> entries;

    int tiles() const { return columns * rows; }
};

constexpr int kChunk = 1024;  // Gaussians per task; fixed, so that results are independent of the number of threads

// Minimum of the exponent over the rectangle [x0, x0+size] x [y0, y0+size], per lane, minus a bound on its rounding error:
// never above the true minimum, so that no overlapping tile is missed.
DECOGS_INLINE F smallest_exponent(const Projected& g, const F& x0, const F& y0, float size) {
    const F lx = x0 - g.x, hx = lx + size, ly = y0 - g.y, hy = ly + size;
    const float aa = g.p * g.p, ab = g.p * g.q, cc = g.q * g.q + g.r * g.r;
    const F ex = min(max(lx, 0.0f), hx);  // nearest vertical edge, or the centre line inside
    const F ey = min(max(ly, 0.0f), hy);
    // The minimum of a convex quadratic over a rectangle lies on one of the two facing edges.
    const F y_on_ex = min(max(ex * (-ab / cc), ly), hy);
    const F x_on_ey = min(max(ey * (-ab / aa), lx), hx);
    const F u1 = ex * g.p + y_on_ex * g.q, v1 = y_on_ex * g.r;
    const F u2 = x_on_ey * g.p + ey * g.q, v2 = ey * g.r;
    const F smallest = min(u1 * u1 + v1 * v1, u2 * u2 + v2 * v2);
    const F slack = (ex * ex * aa + ey * ey * cc + hx * hx * aa + hy * hy * cc) * 1e-6f + 1e-3f;
    return smallest - slack;
}

struct Key {
    uint32_t depth, gaussian;
};

DECOGS_INLINE uint32_t depth_key(float depth) {  // depths are positive, and positive floats sort like their bit patterns
    uint32_t bits;
    std::memcpy(&bits, &depth, 4);
    return bits;
}

// Stable LSD radix sort with digits of 11 bits; a digit that all keys share is skipped.
inline void sort_by_depth(std::vector<Key>& keys, std::vector<Key>& scratch) {
    scratch.resize(keys.size());
    for (int shift = 0; shift < 32; shift += 11) {
        uint32_t start[2048] = {0};
        for (const Key& k : keys) ++start[(k.depth >> shift) & 2047];
        if (!keys.empty() && start[(keys[0].depth >> shift) & 2047] == keys.size()) continue;
        uint32_t total = 0;
        for (uint32_t& s : start) {
            const uint32_t c = s;
            s = total;
            total += c;
        }
        for (const Key& k : keys) scratch[start[(k.depth >> shift) & 2047]++] = k;
        keys.swap(scratch);
    }
}

// Appends the tiles that the ellipse overlaps; returns their number.
inline uint32_t touch(const Projected& g, int columns, int rows, std::vector<uint32_t>& tiles) {
    if (!(g.cut > 0.0f)) return 0;
    const float ex = g.extent_x * 1.0001f + 0.01f, ey = g.extent_y * 1.0001f + 0.01f;
    const int x0 = static_cast<int>(std::max(0.0f, (g.x - ex) / kTile));
    const int y0 = static_cast<int>(std::max(0.0f, (g.y - ey) / kTile));
    const int x1 = static_cast<int>(std::min(columns - 1.0f, (g.x + ex) / kTile));
    const int y1 = static_cast<int>(std::min(rows - 1.0f, (g.y + ey) / kTile));
    if (x1 < x0 || y1 < y0) return 0;
    if (x0 == x1 && y0 == y1) {
        tiles.push_back(static_cast<uint32_t>(y0 * columns + x0));
        return 1;
    }
    const size_t before = tiles.size();
    for (int by = y0; by <= y1; by += 4)
        for (int bx = x0; bx <= x1; bx += 4) {  // 4x4 tiles per test
            float cx[kLanes], cy[kLanes];
            for (int i = 0; i < kLanes; ++i) {
                cx[i] = static_cast<float>((bx + i % 4) * kTile) + 0.5f;
                cy[i] = static_cast<float>((by + i / 4) * kTile) + 0.5f;
            }
            const unsigned met = bits(smallest_exponent(g, load(cx), load(cy), kTile - 1.0f) <= g.cut);
            for (int j = 0; j < 4 && by + j <= y1; ++j)
                for (int i = 0; i < 4 && bx + i <= x1; ++i)
                    if (met >> (4 * j + i) & 1) tiles.push_back(static_cast<uint32_t>((by + j) * columns + bx + i));
        }
    return static_cast<uint32_t>(tiles.size() - before);
}

// Counts pairs across threads. A hostile stream can hold millions of Gaussians that each fill the picture: binning must
// stop before memory runs out.
class PairCount {
 public:
    void restart(uint64_t pairs, uint64_t limit) {
        pairs_.store(pairs);
        limit_ = std::min(limit, kMaxPairs);
    }
    bool fits_with(uint64_t more) { return pairs_.fetch_add(more) + more <= limit_; }
    void check() const {
        if (pairs_.load() > limit_) refuse_pairs();
    }

 private:
    std::atomic<uint64_t> pairs_{0};
    uint64_t limit_ = kMaxPairs;
};

class Binner {
   public:
    // Bins the `count` Gaussians that are the scene's `rows` (null: all, in order); `lists` numbers them from 0. Throws TooManyPairs
    // above `max_pairs`, of which `taken` are others'.
    void run(Pool& pool, const Scene& scene, const Camera& cam, const int64_t* rows, int64_t count, TileLists& lists,
             uint64_t taken = 0, uint64_t max_pairs = kMaxPairs) {
        lists.columns = (cam.width + kTile - 1) / kTile;
        lists.rows = (cam.height + kTile - 1) / kTile;
        const int64_t padded = (count + kLanes - 1) / kLanes * kLanes;
        lists.projected.resize(padded);
        const int chunks = static_cast<int>((count + kChunk - 1) / kChunk);
        chunk_tiles_.resize(std::max<size_t>(chunk_tiles_.size(), chunks));
        count_.resize(count);
        pairs_.restart(taken, max_pairs);
        pool.run(chunks, [&](int chunk) { project_chunk(scene, cam, rows, count, lists, chunk); });
        pairs_.check();

        lists.first_pair.resize(count + 1);
        uint64_t pairs = 0;
        drawn_.clear();
        for (int64_t i = 0; i < count; ++i) {
            lists.first_pair[i] = static_cast<uint32_t>(pairs);
            pairs += count_[i];
            if (count_[i]) drawn_.push_back({depth_key(lists.projected[i].depth), static_cast<uint32_t>(i)});
        }
        lists.first_pair[count] = static_cast<uint32_t>(pairs);
        lists.tile_of_pair.resize(pairs);
        uint32_t at = 0;
        for (int c = 0; c < chunks; ++c) {
            std::copy(chunk_tiles_[c].begin(), chunk_tiles_[c].end(), lists.tile_of_pair.begin() + at);
            at += static_cast<uint32_t>(chunk_tiles_[c].size());
        }
        sort_by_depth(drawn_, other_);
        fill(lists, static_cast<uint32_t>(pairs));
    }

   private:
    void project_chunk(const Scene& scene, const Camera& cam, const int64_t* from, int64_t count, TileLists& lists, int chunk) {
        const int64_t begin = static_cast<int64_t>(chunk) * kChunk, end = std::min(count, begin + kChunk);
        auto& tiles = chunk_tiles_[chunk];
        tiles.clear();
        uint64_t added = 0;
        for (int64_t base = begin; base < end && pairs_.fits_with(added); base += kLanes) {
            const size_t before = tiles.size();
            int64_t rows[kLanes];
            for (int i = 0; i < kLanes; ++i) rows[i] = std::min(base + i, count - 1);
            if (from)
                for (int64_t& row : rows) row = from[row];
            project_rows(scene, cam, rows, &lists.projected[base]);
            for (int64_t i = base; i < std::min(base + kLanes, end); ++i)
                count_[i] = touch(lists.projected[i], lists.columns, lists.rows, tiles);
            added = tiles.size() - before;
        }
        pairs_.fits_with(added);
    }

    void fill(TileLists& lists, uint32_t pairs) {
        lists.first_entry.assign(lists.tiles() + 1, 0);
        for (uint32_t tile : lists.tile_of_pair) ++lists.first_entry[tile + 1];
        for (int t = 0; t < lists.tiles(); ++t) lists.first_entry[t + 1] += lists.first_entry[t];
        cursor_.assign(lists.first_entry.begin(), lists.first_entry.end() - 1);
        lists.entries.resize(pairs);
        for (const Key& k : drawn_)
            for (uint32_t pair = lists.first_pair[k.gaussian]; pair < lists.first_pair[k.gaussian + 1]; ++pair)
                lists.entries[cursor_[lists.tile_of_pair[pair]]++] = {k.gaussian, pair};
    }

    std::vector<std::vector<uint32_t>> chunk_tiles_;
    std::vector<uint32_t> count_, cursor_;
    std::vector<Key> drawn_, other_;
    PairCount pairs_;
};

}  // namespace decogs
