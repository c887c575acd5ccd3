// A fixed camera's picture of a scene of which few Gaussians change: everything that stays is kept from draw to draw and from
// frame to frame (method.md, "cost follows motion").
//
// Chosen: every tile keeps the list of the Gaussians that rest in it, front to back. Gaussians that are about to change are
// lifted out of these lists; a draw projects them alone, merges them with the lists of the tiles they meet, and composites
// those tiles and the ones they met at the last draw. Order, arithmetic and so every bit are those of a whole rendering.
// Rejected: collapsing what rests in front of and behind the lifted ones into one layer (1e-3 off, wrong when they leave
// their range of depths), and one bit per Gaussian in otherwise whole renderings (projection and binning then cost as much as
// all the rest).
#pragma once

#include <array>

#include "backward.h"

namespace decogs {

// Sums of every Gaussian's weight (alpha times transmittance) over a tile: in all, and over the marked pixels.
struct Weigher {
    const uint8_t* marks = nullptr;  // one per pixel, or null
    float* in_all = nullptr;         // one per entry
    float* marked = nullptr;
    std::array<F, kBatch> all_lanes, marked_lanes;
    std::array<F, kBlocks> shares;

    void start(const Camera& cam, int tile_x, int tile_y) {
        for (int b = 0; b < kBlocks; ++b) {
            float lanes[kLanes] = {0};
            const int x0 = tile_x * kTile + (b % 4) * 4, y0 = tile_y * kTile + (b / 4) * 4;
            for (int j = 0; marks && j < std::min(4, cam.height - y0); ++j)
                for (int i = 0; i < std::min(4, cam.width - x0); ++i)
                    lanes[4 * j + i] = marks[static_cast<int64_t>(y0 + j) * cam.width + x0 + i] ? 1.0f : 0.0f;
            shares[b] = load(lanes);
        }
    }
    void begin(int size) {
        for (int e = 0; e < size; ++e) all_lanes[e] = marked_lanes[e] = splat(0.0f);
    }
    void note(int block, int e, const F& weight) {
        all_lanes[e] = all_lanes[e] + weight;
        marked_lanes[e] = marked_lanes[e] + weight * shares[block];
    }
    void end(uint32_t first, int size) {
        for (int e = 0; e < size; ++e) {
            in_all[first + e] = sum(all_lanes[e]);
            marked[first + e] = sum(marked_lanes[e]);
        }
    }
    static float sum(const F& x) {
        float lanes[kLanes], total = 0;
        store(lanes, x);
        for (float lane : lanes) total += lane;
        return total;
    }
};

class FixedView {
 public:
    explicit FixedView(const Camera& camera) : camera_(camera) {
        lists_.columns = (camera.width + kTile - 1) / kTile;
        lists_.rows = (camera.height + kTile - 1) / kTile;
        tiles_.resize(lists_.tiles());
    }

    // Starts anew with a whole scene, all of it at rest.
    void place(Pool& pool, Binner& binner, const Scene& scene) {
        binner.run(pool, scene, camera_, lists_);
        for (int t = 0; t < lists_.tiles(); ++t) {
            tiles_[t] = Tile();
            for (uint32_t e = lists_.first_entry[t]; e < lists_.first_entry[t + 1]; ++e) {
                const uint32_t g = lists_.entries[e].gaussian;
                tiles_[t].resting.push_back({depth_key(lists_.projected[g].depth), g, 0.0f, -1});
            }
        }
    }

    // Takes Gaussians out of the tiles they rest in: from now on they are what changes.
    void lift(const int64_t* rows, int64_t count) {
        std::vector<uint8_t> lifted(lists_.projected.size(), 0);
        std::vector<uint32_t> left;
        for (int64_t i = 0; i < count; ++i) {
            lifted[rows[i]] = 1;
            touch(lists_.projected[rows[i]], lists_.columns, lists_.rows, left);
        }
        std::sort(left.begin(), left.end());
        left.erase(std::unique(left.begin(), left.end()), left.end());
        for (uint32_t t : left) {
            auto& resting = tiles_[t].resting;
            resting.erase(std::remove_if(resting.begin(), resting.end(), [&](const Resting& r) { return lifted[r.gaussian] != 0; }), resting.end());
            tiles_[t].moved = tiles_[t].stale = true;
        }
    }

    // Draws `moving`, the lifted Gaussians as they are now and perhaps new ones, which are the scene's `rows` (ascending), and
    // with them every tile that they meet or met at the last draw. `met` receives one byte per tile: whether they meet it.
    void draw(Pool& pool, const Scene& moving, const int64_t* rows, const Planes& out, uint8_t* met) {
        bring(pool, moving, nullptr, rows, moving.count);
        active_.clear();
        for (int t = 0; t < lists_.tiles(); ++t) {
            Tile& tile = tiles_[t];
            met[t] = first_arrival_[t + 1] > first_arrival_[t];
            if (!met[t] && !tile.moved && !(out.depth && tile.shallow)) continue;
            active_.push_back(t);
            tile.moved = met[t];
            tile.stale = true;
            tile.shallow = !out.depth;
        }
        merge(rows);
        trace_.resize(lists_);
        each_active(pool, [&](int t) { composite_tile(lists_, camera_, t, out, &trace_); });
    }

    // Gradients of the last draw's `moving`.
    void backward(Pool& pool, const Scene& moving, const Cotangents& cotangents, const Gradients& out) {
        moments_.resize(tile_of_pair_.size() * kMoments);
        each_active(pool, [&](int t) { backward_tile(lists_, trace_, camera_, t, cotangents, moments_.data()); });
        backward_scene(pool, moving, camera_, {projected_.data(), first_pair_.data()}, moments_.data(), out);
    }

    // All is at rest again: `scene` is the whole scene from now on, `rows` (ascending) those that were lifted or are new.
    // `renumbered` gives the new row of each of the `before` old ones, -1 for those that are gone; null: all keep theirs.
    void settle(Pool& pool, const Scene& scene, const int64_t* rows, int64_t count, const int64_t* renumbered, int64_t before) {
        if (renumbered) renumber(renumbered, before);
        lists_.projected.resize(scene.count);
        bring(pool, scene, rows, rows, count);
        std::vector<Resting> merged;
        for (int t = 0; t < lists_.tiles(); ++t) {
            Tile& tile = tiles_[t];
            tile.moved = false;
            if (first_arrival_[t + 1] == first_arrival_[t]) continue;
            merged.clear();
            each_in_order(
                t, rows, [&](const Resting& r) { merged.push_back(r); },
                [&](const Arrival& a) { merged.push_back({a.depth, static_cast<uint32_t>(rows[a.index]), 0.0f, -1}); });
            tile.resting.swap(merged);
            tile.stale = true;
        }
    }

    // Redraws the tiles that do not show the scene at rest and, with `weights` (2, count), weighs every Gaussian: in all and
    // over the marked pixels (`marks`, one byte per pixel; null: none).
    void refresh(Pool& pool, const uint8_t* marks, const Planes& out, float* weights, int64_t count) {
        active_.clear();
        for (int t = 0; t < lists_.tiles(); ++t) {
            Tile& tile = tiles_[t];
            if (!tile.stale && !(marks && any_marked(marks, t))) continue;
            active_.push_back(t);
            tile.stale = tile.shallow = false;
        }
        first_arrival_.assign(lists_.tiles() + 1, 0);
        merge(nullptr);
        in_all_.resize(lists_.entries.size());
        marked_.resize(lists_.entries.size());
        each_active(pool, [&](int t) { weigh(t, marks, out); });
        if (weights) add_weights(marks, weights, count);
    }

    // Projected centres, (count, 2) pixels, of the scene at rest; not-a-number where not drawn.
    void centres(int64_t count, float* to) const {
        for (int64_t i = 0; i < count; ++i) {
            const Projected& g = lists_.projected[i];
            to[2 * i] = g.cut > 0.0f ? g.x : NAN;
            to[2 * i + 1] = g.cut > 0.0f ? g.y : NAN;
        }
    }

 private:
    struct Resting {
        uint32_t depth, gaussian;
        float weight;    // over the tile, as of its last refresh
        int32_t blocks;  // of the tile that its ellipse meets; -1: not known yet
    };
    struct Tile {
        std::vector<Resting> resting;  // front to back; equal depths in the scene's order
        bool stale = true;             // the picture or the weights are not those of the scene at rest
        bool moved = false;            // the picture shows, or lacks, Gaussians that are lifted
        bool shallow = true;           // was last drawn without depth
    };
    struct Arrival {  // of a Gaussian that was just projected, in a tile
        uint32_t depth, index, pair;
    };

    // Projects the scene's rows `from` (null: all) into the places `to`, and sorts them into the tiles they meet.
    void bring(Pool& pool, const Scene& scene, const int64_t* from, const int64_t* to, int64_t count) {
        if (count && static_cast<int64_t>(lists_.projected.size()) <= to[count - 1]) lists_.projected.resize(to[count - 1] + 1);
        projected_.resize((count + kLanes - 1) / kLanes * kLanes);
        pairs_of_.resize(count);
        const int chunks = static_cast<int>((count + kChunk - 1) / kChunk);
        chunk_tiles_.resize(std::max<size_t>(chunk_tiles_.size(), chunks));
        pool.run(chunks, [&](int chunk) {
            const int64_t begin = static_cast<int64_t>(chunk) * kChunk, end = std::min<int64_t>(count, begin + kChunk);
            chunk_tiles_[chunk].clear();
            for (int64_t base = begin; base < end; base += kLanes) {
                int64_t rows[kLanes];
                for (int64_t i = 0; i < kLanes; ++i) rows[i] = from ? from[std::min(base + i, count - 1)] : std::min(base + i, count - 1);
                project_rows(scene, camera_, rows, &projected_[base]);
                for (int64_t i = base; i < std::min(base + kLanes, end); ++i) {
                    lists_.projected[to[i]] = projected_[i];
                    pairs_of_[i] = touch(projected_[i], lists_.columns, lists_.rows, chunk_tiles_[chunk]);
                }
            }
        });
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

    // Walks a tile's resting Gaussians and arrivals together, front to back.
    template <class OnResting, class OnArrival>
    void each_in_order(int t, const int64_t* rows, const OnResting& on_resting, const OnArrival& on_arrival) const {
        uint32_t a = first_arrival_[t];
        const uint32_t end = first_arrival_[t + 1];
        for (const Resting& r : tiles_[t].resting) {
            for (; a < end; ++a) {
                const Arrival& next = arrivals_[a];
                if (next.depth > r.depth || (next.depth == r.depth && rows[next.index] > static_cast<int64_t>(r.gaussian))) break;
                on_arrival(next);
            }
            on_resting(r);
        }
        for (; a < end; ++a) on_arrival(arrivals_[a]);
    }

    // The lists of the active tiles, ready to be drawn.
    void merge(const int64_t* rows) {
        lists_.first_entry.assign(lists_.tiles() + 1, 0);
        for (int t : active_)
            lists_.first_entry[t + 1] = static_cast<uint32_t>(tiles_[t].resting.size()) + first_arrival_[t + 1] - first_arrival_[t];
        for (int t = 0; t < lists_.tiles(); ++t) lists_.first_entry[t + 1] += lists_.first_entry[t];
        lists_.entries.resize(lists_.first_entry[lists_.tiles()]);
        for (int t : active_) {
            Entry* to = lists_.entries.data() + lists_.first_entry[t];
            each_in_order(
                t, rows, [&](const Resting& r) { *to++ = {r.gaussian, kNoPair, r.blocks}; },
                [&](const Arrival& a) { *to++ = {static_cast<uint32_t>(rows[a.index]), a.pair, -1}; });
        }
    }

    template <class Task>
    void each_active(Pool& pool, const Task& task) {
        constexpr int kTogether = 4;
        const int count = static_cast<int>(active_.size());
        pool.run((count + kTogether - 1) / kTogether, [&](int group) {
            for (int i = group * kTogether; i < std::min(count, (group + 1) * kTogether); ++i) task(active_[i]);
        });
    }

    void weigh(int t, const uint8_t* marks, const Planes& out) {
        static thread_local Weigher weigher;
        weigher.marks = marks;
        weigher.in_all = in_all_.data();
        weigher.marked = marked_.data();
        const uint32_t begin = lists_.first_entry[t], end = lists_.first_entry[t + 1];
        std::fill(in_all_.begin() + begin, in_all_.begin() + end, 0.0f);  // what lies behind a full tile is never come to
        std::fill(marked_.begin() + begin, marked_.begin() + end, 0.0f);
        weigher.start(camera_, t % lists_.columns, t / lists_.columns);
        find_blocks(t);
        composite_tile(lists_, camera_, t, out, nullptr, weigher);
        for (uint32_t e = begin; e < end; ++e) tiles_[t].resting[e - begin].weight = in_all_[e];
    }

    // Which blocks of a tile the ellipses at rest in it meet, for all draws to come.
    void find_blocks(int t) {
        const TileCorners corners = block_corners(t % lists_.columns, t / lists_.columns);
        Entry* entry = lists_.entries.data() + lists_.first_entry[t];
        for (Resting& r : tiles_[t].resting) {
            if (r.blocks < 0) r.blocks = blocks_met(lists_.projected[r.gaussian], corners.x, corners.y);
            (entry++)->blocks = r.blocks;
        }
    }

    bool any_marked(const uint8_t* marks, int t) const {
        const int x0 = t % lists_.columns * kTile, y0 = t / lists_.columns * kTile, width = std::min(kTile, camera_.width - x0);
        for (int y = y0; y < std::min(camera_.height, y0 + kTile); ++y)
            if (std::memchr(marks + static_cast<int64_t>(y) * camera_.width + x0, 1, width)) return true;
        return false;
    }

    void add_weights(const uint8_t* marks, float* weights, int64_t count) const {
        std::fill(weights, weights + 2 * count, 0.0f);
        for (const Tile& tile : tiles_)
            for (const Resting& r : tile.resting) weights[r.gaussian] += r.weight;
        if (!marks) return;
        for (int t : active_)
            for (uint32_t e = lists_.first_entry[t]; e < lists_.first_entry[t + 1]; ++e) weights[count + lists_.entries[e].gaussian] += marked_[e];
    }

    void renumber(const int64_t* renumbered, int64_t before) {
        for (int64_t i = 0; i < before; ++i)
            if (renumbered[i] >= 0) lists_.projected[renumbered[i]] = lists_.projected[i];
        for (Tile& tile : tiles_)
            for (Resting& r : tile.resting) r.gaussian = static_cast<uint32_t>(renumbered[r.gaussian]);
    }

    Camera camera_;
    TileLists lists_;  // `projected` of the whole scene; entries of the active tiles only
    std::vector<Tile> tiles_;
    std::vector<int> active_;
    Trace trace_;
    std::vector<float> moments_, in_all_, marked_;
    // What was brought last.
    std::vector<Projected> projected_;
    std::vector<uint32_t> pairs_of_, first_pair_, tile_of_pair_, first_arrival_, cursor_;
    std::vector<std::vector<uint32_t>> chunk_tiles_;
    std::vector<Key> order_, scratch_;
    std::vector<Arrival> arrivals_;
};

}  // namespace decogs
