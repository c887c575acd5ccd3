// Incremental rendering by a fixed camera of a scene of which few Gaussians change per frame. A static Gaussian keeps its
// projection and its tiles.
//
// Chosen: every tile keeps the depth-sorted list of its static Gaussians. Changing Gaussians are detached from these lists
// and merged into them again with their new values; only tiles that lost or gained one are redrawn. Order and arithmetic are
// those of a full rendering, and so is every bit. The encoder's view (fixed_view.h there) also draws detached Gaussians.
// Rejected: comparing the tile lists of two full renderings (projection and binning cost as much as redrawing saves).
#pragma once

#include "composite.h"

namespace decogs {

// The output picture; the kernel composites into planes.
struct Picture {
    float* image;  // (height, width, 3)
    float* depth;  // (height, width): depth / alpha, 0 where alpha is 0
};

// Copies one tile of the planes to the picture.
inline void finish_tile(const Camera& cam, int x0, int y0, const Planes& planes, const Picture& to) {
    const int64_t plane = static_cast<int64_t>(cam.width) * cam.height;
    const int columns = std::min(kTile, cam.width - x0);
    for (int y = y0; y < std::min(cam.height, y0 + kTile); ++y) {
        const int64_t first = static_cast<int64_t>(y) * cam.width + x0;
        for (int64_t i = first; i < first + columns; ++i) {
            for (int c = 0; c < 3; ++c) to.image[3 * i + c] = planes.rgb[c * plane + i];
            to.depth[i] = planes.alpha[i] > 0.0f ? planes.depth[i] / planes.alpha[i] : 0.0f;
        }
    }
}

class IncrementalView {
 public:
    explicit IncrementalView(const Camera& camera) : camera_(camera) {
        lists_.columns = (camera.width + kTile - 1) / kTile;
        lists_.rows = (camera.height + kTile - 1) / kTile;
        tiles_.resize(lists_.tiles());
    }

    // Limits the (tile, Gaussian) pairs; more throw TooManyPairs.
    void allow(uint64_t max_pairs) { max_pairs_ = max_pairs; }

    // Loads a whole scene as static.
    void set_scene(Pool& pool, Binner& binner, const Scene& scene) {
        for (Tile& tile : tiles_) tile = Tile();
        binner.run(pool, scene, camera_, lists_, max_pairs_);
        for (int t = 0; t < lists_.tiles(); ++t) {
            tiles_[t].statics.reserve(lists_.first_entry[t + 1] - lists_.first_entry[t]);
            for (uint32_t e = lists_.first_entry[t]; e < lists_.first_entry[t + 1]; ++e) {
                const uint32_t g = lists_.entries[e].gaussian;
                tiles_[t].statics.push_back({depth_key(lists_.projected[g].depth), g, 0.0f, -1});
            }
        }
    }

    // Detaches Gaussians from their tiles, so that they may change. Returns these tiles, ascending.
    std::vector<uint32_t> detach(const int64_t* rows, int64_t count) {
        std::vector<uint8_t> detached(lists_.projected.size(), 0);
        std::vector<uint32_t> left;
        for (int64_t i = 0; i < count; ++i) {
            detached[rows[i]] = 1;
            touch(lists_.projected[rows[i]], lists_.columns, lists_.rows, left);
        }
        std::sort(left.begin(), left.end());
        left.erase(std::unique(left.begin(), left.end()), left.end());
        for (uint32_t t : left) {
            auto& statics = tiles_[t].statics;
            statics.erase(std::remove_if(statics.begin(), statics.end(), [&](const Static& r) { return detached[r.gaussian] != 0; }), statics.end());
            tiles_[t].stale = true;
        }
        return left;
    }

    // Makes all of the now `population` Gaussians static. `rows` (ascending) were detached or are new; their values are the rows
    // `from` of `scene` (null: all of it, in order). `renumbered`: the new row of each of the `before` old ones, -1 for removed
    // ones, which were detached; null: rows keep their numbers.
    void commit(Pool& pool, const Scene& scene, const int64_t* from, const int64_t* rows, int64_t count, int64_t population,
                const int64_t* renumbered, int64_t before) {
        if (renumbered) renumber(renumbered, before);
        lists_.projected.resize(population);
        bring(pool, scene, from, rows, count);
        active_.clear();
        for (int t = 0; t < lists_.tiles(); ++t)
            if (first_arrival_[t + 1] > first_arrival_[t]) active_.push_back(t);
        each_active(pool, [&](int t) {
            Tile& tile = tiles_[t];
            std::vector<Static> merged;
            merged.reserve(tile.statics.size() + first_arrival_[t + 1] - first_arrival_[t]);
            each_in_order(
                t, rows, [&](const Static& r) { merged.push_back(r); },
                [&](const Arrival& a) { merged.push_back({a.depth, static_cast<uint32_t>(rows[a.index]), 0.0f, -1}); });
            tile.statics.swap(merged);
            tile.stale = true;
        });
    }

    // Redraws stale tiles; returns their number.
    int64_t redraw(Pool& pool, const Planes& planes, const Picture& to) {
        line_up([](int) { return false; });
        each_active(pool, [&](int t) {
            list_statics(t);
            composite_tile(lists_, camera_, t, planes, nullptr);
            finish_tile(camera_, t % lists_.columns * kTile, t / lists_.columns * kTile, planes, to);
        });
        return static_cast<int64_t>(active_.size());
    }

 protected:
    struct Static {
        uint32_t depth, gaussian;
        float weight;    // sum of alpha T over the tile, if weighed
        int32_t blocks;  // bit mask of the blocks that its ellipse overlaps; -1: not computed yet
    };
    struct Tile {
        std::vector<Static> statics;  // by depth; equal depths in the scene's order
        bool stale = true;             // the picture does not show the static scene
    };
    struct Arrival {  // a newly projected Gaussian in a tile
        uint32_t depth, index, pair;
    };

    // Projects the scene's rows `from` (null: all) as rows `to`, and bins them: radix sort by depth, counting sort by tile.
    void bring(Pool& pool, const Scene& scene, const int64_t* from, const int64_t* to, int64_t count) {
        if (count && static_cast<int64_t>(lists_.projected.size()) <= to[count - 1]) lists_.projected.resize(to[count - 1] + 1);
        projected_.resize((count + kLanes - 1) / kLanes * kLanes);
        pairs_of_.resize(count);
        const int chunks = static_cast<int>((count + kChunk - 1) / kChunk);
        chunk_tiles_.resize(std::max<size_t>(chunk_tiles_.size(), chunks));
        uint64_t statics = 0;
        for (const Tile& tile : tiles_) statics += tile.statics.size();
        count_.restart(statics, max_pairs_);
        pool.run(chunks, [&](int chunk) {
            const int64_t begin = static_cast<int64_t>(chunk) * kChunk, end = std::min<int64_t>(count, begin + kChunk);
            chunk_tiles_[chunk].clear();
            uint64_t added = 0;
            for (int64_t base = begin; base < end && count_.fits_with(added); base += kLanes) {
                const size_t so_far = chunk_tiles_[chunk].size();
                int64_t rows[kLanes];
                for (int64_t i = 0; i < kLanes; ++i) rows[i] = from ? from[std::min(base + i, count - 1)] : std::min(base + i, count - 1);
                project_rows(scene, camera_, rows, &projected_[base]);
                for (int64_t i = base; i < std::min(base + kLanes, end); ++i) {
                    lists_.projected[to[i]] = projected_[i];
                    pairs_of_[i] = touch(projected_[i], lists_.columns, lists_.rows, chunk_tiles_[chunk]);
                }
                added = chunk_tiles_[chunk].size() - so_far;
            }
            count_.fits_with(added);
        });
        count_.check();
        first_pair_.resize(count + 1);
        order_.clear();
        uint32_t pairs = 0;
        for (int64_t i = 0; i < count; ++i) {
            first_pair_[i] = pairs;
            pairs += pairs_of_[i];
            if (pairs_of_[i]) order_.push_back({depth_key(projected_[i].depth), static_cast<uint32_t>(i)});
        }
        first_pair_[count] = pairs;
        tile_of_pair_.clear();
        for (int chunk = 0; chunk < chunks; ++chunk) tile_of_pair_.insert(tile_of_pair_.end(), chunk_tiles_[chunk].begin(), chunk_tiles_[chunk].end());
        sort_by_depth(order_, scratch_);
        first_arrival_.assign(lists_.tiles() + 1, 0);
        for (uint32_t tile : tile_of_pair_) ++first_arrival_[tile + 1];
        for (int t = 0; t < lists_.tiles(); ++t) first_arrival_[t + 1] += first_arrival_[t];
        cursor_.assign(first_arrival_.begin(), first_arrival_.end() - 1);
        arrivals_.resize(pairs);
        for (const Key& k : order_)
            for (uint32_t pair = first_pair_[k.gaussian]; pair < first_pair_[k.gaussian + 1]; ++pair)
                arrivals_[cursor_[tile_of_pair_[pair]]++] = {k.depth, k.gaussian, pair};
    }

    // Merges a tile's static Gaussians and arrivals by depth.
    template <class OnResting, class OnArrival>
    void each_in_order(int t, const int64_t* rows, const OnResting& on_resting, const OnArrival& on_arrival) const {
        uint32_t a = first_arrival_[t];
        const uint32_t end = first_arrival_[t + 1];
        for (const Static& r : tiles_[t].statics) {
            for (; a < end; ++a) {
                const Arrival& next = arrivals_[a];
                if (next.depth > r.depth || (next.depth == r.depth && rows[next.index] > static_cast<int64_t>(r.gaussian))) break;
                on_arrival(next);
            }
            on_resting(r);
        }
        for (; a < end; ++a) on_arrival(arrivals_[a]);
    }

    // Makes room for the lists of the active tiles; `merge` fills each.
    void make_room() {
        lists_.first_entry.assign(lists_.tiles() + 1, 0);
        for (int t : active_)
            lists_.first_entry[t + 1] = static_cast<uint32_t>(tiles_[t].statics.size()) + first_arrival_[t + 1] - first_arrival_[t];
        for (int t = 0; t < lists_.tiles(); ++t) lists_.first_entry[t + 1] += lists_.first_entry[t];
        lists_.entries.resize(lists_.first_entry[lists_.tiles()]);
    }

    // Builds the list of an active tile.
    void merge(int t, const int64_t* rows) {
        Entry* to = lists_.entries.data() + lists_.first_entry[t];
        each_in_order(
            t, rows, [&](const Static& r) { *to++ = {r.gaussian, kNoPair, r.blocks}; },
            [&](const Arrival& a) { *to++ = {static_cast<uint32_t>(rows[a.index]), a.pair, -1}; });
    }

    // Activates stale and `wanted` tiles for a redraw of the static scene.
    template <class Wanted>
    void line_up(const Wanted& wanted) {
        active_.clear();
        for (int t = 0; t < lists_.tiles(); ++t) {
            if (!tiles_[t].stale && !wanted(t)) continue;
            active_.push_back(t);
            tiles_[t].stale = false;
        }
        first_arrival_.assign(lists_.tiles() + 1, 0);
        make_room();
    }

    template <class Task>
    void each_active(Pool& pool, const Task& task) {
        constexpr int kTogether = 4;
        const int count = static_cast<int>(active_.size());
        pool.run((count + kTogether - 1) / kTogether, [&](int group) {
            for (int i = group * kTogether; i < std::min(count, (group + 1) * kTogether); ++i) task(active_[i]);
        });
    }

    // Builds the list of an active tile without arrivals. The block masks of its ellipses are computed once, for all later draws.
    void list_statics(int t) {
        const TileCorners corners = block_corners(t % lists_.columns, t / lists_.columns);
        for (Static& r : tiles_[t].statics)
            if (r.blocks < 0) r.blocks = blocks_met(lists_.projected[r.gaussian], corners.x, corners.y);
        merge(t, nullptr);
    }

    void renumber(const int64_t* renumbered, int64_t before) {
        for (int64_t i = 0; i < before; ++i)
            if (renumbered[i] >= 0) lists_.projected[renumbered[i]] = lists_.projected[i];
        for (Tile& tile : tiles_)
            for (Static& r : tile.statics) r.gaussian = static_cast<uint32_t>(renumbered[r.gaussian]);
    }

    Camera camera_;
    uint64_t max_pairs_ = kMaxPairs;
    TileLists lists_;  // `projected` of the whole scene; entries of the active tiles only
    std::vector<Tile> tiles_;
    std::vector<int> active_;  // tiles under work
    // Buffers of the last `bring`.
    std::vector<Projected> projected_;
    std::vector<uint32_t> pairs_of_, first_pair_, tile_of_pair_, first_arrival_, cursor_;
    std::vector<std::vector<uint32_t>> chunk_tiles_;
    std::vector<Key> order_, scratch_;
    std::vector<Arrival> arrivals_;
    PairCount count_;
};

}  // namespace decogs
