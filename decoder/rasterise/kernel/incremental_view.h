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
        binner.run(pool, scene, camera_, nullptr, scene.count, lists_, 0, max_pairs_);
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
        is_detached_.resize(lists_.projected.size(), 0);
        std::vector<uint32_t> left;
        for (int64_t i = 0; i < count; ++i) touch(lists_.projected[rows[i]], lists_.columns, lists_.rows, left);
        for (int64_t i = 0; i < count; ++i) is_detached_[rows[i]] = 1;
        std::sort(left.begin(), left.end());
        left.erase(std::unique(left.begin(), left.end()), left.end());
        for (uint32_t t : left) {
            auto& statics = tiles_[t].statics;
            statics.erase(std::remove_if(statics.begin(), statics.end(), [&](const Static& r) { return is_detached_[r.gaussian] != 0; }), statics.end());
            tiles_[t].stale = true;
        }
        for (int64_t i = 0; i < count; ++i) is_detached_[rows[i]] = 0;
        return left;
    }

    // Makes all of the now `population` Gaussians static. `rows` (ascending) were detached or are new; their values are the rows
    // `from` of `scene` (null: all of it, in order). `renumbered`: the new row of each of the `before` old ones, -1 for removed
    // ones, which were detached; null: rows keep their numbers.
    void commit(Pool& pool, Binner& binner, const Scene& scene, const int64_t* from, const int64_t* rows, int64_t count,
                int64_t population, const int64_t* renumbered, int64_t before) {
        if (renumbered) renumber(renumbered, before);
        lists_.projected.resize(population);
        bring(pool, binner, scene, from, rows, count);
        active_.clear();
        for (int t = 0; t < lists_.tiles(); ++t)
            if (is_met(t)) active_.push_back(t);
        each_active(pool, [&](int t) {
            Tile& tile = tiles_[t];
            std::vector<Static> merged;
            merged.reserve(tile.statics.size() + arrived_.first_entry[t + 1] - arrived_.first_entry[t]);
            each_in_order(
                t, rows, [&](const Static& r) { merged.push_back(r); },
                [&](const Entry& a, uint32_t depth) { merged.push_back({depth, static_cast<uint32_t>(rows[a.gaussian]), 0.0f, -1}); });
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

    // Projects and bins the scene's rows `from` (null: all) as rows `to`.
    void bring(Pool& pool, Binner& binner, const Scene& scene, const int64_t* from, const int64_t* to, int64_t count) {
        uint64_t statics = 0;
        for (const Tile& tile : tiles_) statics += tile.statics.size();
        binner.run(pool, scene, camera_, from, count, arrived_, statics, max_pairs_);
        if (count && static_cast<int64_t>(lists_.projected.size()) <= to[count - 1]) lists_.projected.resize(to[count - 1] + 1);
        for (int64_t i = 0; i < count; ++i) lists_.projected[to[i]] = arrived_.projected[i];
    }

    bool is_met(int t) const { return arrived_.first_entry[t + 1] > arrived_.first_entry[t]; }

    // Merges a tile's static Gaussians and arrivals by depth; an arrival is its entry and the key of its depth.
    template <class OnResting, class OnArrival>
    void each_in_order(int t, const int64_t* rows, const OnResting& on_resting, const OnArrival& on_arrival) const {
        auto r = tiles_[t].statics.begin(), last = tiles_[t].statics.end();
        for (uint32_t a = arrived_.first_entry[t]; a < arrived_.first_entry[t + 1]; ++a) {
            const Entry& next = arrived_.entries[a];
            const uint32_t depth = depth_key(arrived_.projected[next.gaussian].depth);
            for (; r != last && (r->depth < depth || (r->depth == depth && static_cast<int64_t>(r->gaussian) < rows[next.gaussian])); ++r)
                on_resting(*r);
            on_arrival(next, depth);
        }
        for (; r != last; ++r) on_resting(*r);
    }

    // Makes room for the lists of the active tiles; `merge` fills each.
    void make_room() {
        lists_.first_entry.assign(lists_.tiles() + 1, 0);
        for (int t : active_)
            lists_.first_entry[t + 1] = static_cast<uint32_t>(tiles_[t].statics.size()) + arrived_.first_entry[t + 1] - arrived_.first_entry[t];
        for (int t = 0; t < lists_.tiles(); ++t) lists_.first_entry[t + 1] += lists_.first_entry[t];
        lists_.entries.resize(lists_.first_entry[lists_.tiles()]);
    }

    // Builds the list of an active tile.
    void merge(int t, const int64_t* rows) {
        Entry* to = lists_.entries.data() + lists_.first_entry[t];
        each_in_order(
            t, rows, [&](const Static& r) { *to++ = {r.gaussian, kNoPair, r.blocks}; },
            [&](const Entry& a, uint32_t) { *to++ = {static_cast<uint32_t>(rows[a.gaussian]), a.pair, -1}; });
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
        arrived_.first_entry.assign(lists_.tiles() + 1, 0);
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
    TileLists arrived_;        // of the last `bring`, numbered from 0
    std::vector<uint8_t> is_detached_;  // scratch of `detach`: all 0 between calls
};

}  // namespace decogs
