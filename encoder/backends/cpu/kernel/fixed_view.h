// Differentiable rendering by a fixed camera of a scene of which few Gaussians change (docs/METHOD.md, "Incremental views").
//
// Chosen: an incremental view (incremental_view.h) that also draws its detached Gaussians. A draw projects only these, merges
// them into the lists of the tiles they overlap, and composites these tiles and those they overlapped at the last draw. Order
// and arithmetic are those of a full rendering, and so is every bit.
// Rejected: one layer each for the static Gaussians in front of and behind the detached ones (1e-3 off, and wrong once these
// leave their range of depths), and full renderings with a bit per Gaussian (projection and binning then cost as much as all
// the rest).
#pragma once

#include <array>
#include <memory>

#include "backward.h"
#include "incremental_view.h"
#include "wanted_tiles.h"

namespace decogs {

// Sums of every Gaussian's weight alpha T over a tile: of all recorded pixels, and of marked ones.
struct Weigher {
    const uint8_t* recorded = nullptr;  // one per pixel; null: all
    const uint8_t* marks = nullptr;     // the same; null: none
    float* in_all = nullptr;         // one per entry
    float* marked = nullptr;
    std::array<F, kBatch> all_lanes, marked_lanes;
    std::array<F, kBlocks> counted, shares;

    void start(const Camera& cam, int tile_x, int tile_y) {
        for (int b = 0; b < kBlocks; ++b) {
            float of_all[kLanes] = {0}, of_marked[kLanes] = {0};
            const int x0 = tile_x * kTile + (b % 4) * 4, y0 = tile_y * kTile + (b / 4) * 4;
            for (int j = 0; j < std::min(4, cam.height - y0); ++j)
                for (int i = 0; i < std::min(4, cam.width - x0); ++i) {
                    const int64_t pixel = static_cast<int64_t>(y0 + j) * cam.width + x0 + i;
                    if (recorded && !recorded[pixel]) continue;
                    of_all[4 * j + i] = 1.0f;
                    of_marked[4 * j + i] = marks && marks[pixel] ? 1.0f : 0.0f;
                }
            counted[b] = load(of_all);
            shares[b] = load(of_marked);
        }
    }
    void begin(int size) {
        for (int e = 0; e < size; ++e) all_lanes[e] = marked_lanes[e] = splat(0.0f);
    }
    void note(int block, int e, const F& weight) {
        all_lanes[e] = all_lanes[e] + weight * counted[block];
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

class FixedView : public IncrementalView {
 public:
    // `recorded`: one byte per pixel, which stay; null: all were. Tiles without any show the background.
    FixedView(const Camera& camera, const uint8_t* recorded) : IncrementalView(camera), recorded_(recorded), shown_(tiles_.size()) {
        for (int t = 0; recorded && t < lists_.tiles(); ++t) wanted_.push_back(any_marked(recorded, t));
    }

    void set_scene(Pool& pool, Binner& binner, const Scene& scene) {
        IncrementalView::set_scene(pool, binner, scene);
        empty_unwanted();
        std::fill(shown_.begin(), shown_.end(), Shown());
    }

    void detach(const int64_t* rows, int64_t count) {
        for (uint32_t t : IncrementalView::detach(rows, count)) shown_[t].moved = true;
    }

    // Draws `moving`, the current values of the detached Gaussians and of new ones, as the scene's `rows` (ascending): all tiles
    // that they overlap, or overlapped at the last draw. `met` (one byte per tile): whether they overlap it now.
    void draw(Pool& pool, Binner& binner, const Scene& moving, const int64_t* rows, const Planes& out, uint8_t* met) {
        bring(pool, binner, moving, nullptr, rows, moving.count);
        drop_unwanted(wanted(), arrived_);
        active_.clear();
        for (int t = 0; t < lists_.tiles(); ++t) {
            Shown& shown = shown_[t];
            met[t] = is_met(t);
            if (!met[t] && !shown.moved && !(out.depth && shown.shallow)) continue;
            active_.push_back(t);
            tiles_[t].stale = true;
            shown = {static_cast<bool>(met[t]), !out.depth};
        }
        make_room();
        trace_.resize(lists_);
        each_active(pool, [&](int t) {
            merge(t, rows);
            composite_tile(lists_, camera_, t, out, &trace_);
        });
    }

    // Gradients of `moving` through the last draw.
    void backward(Pool& pool, const Scene& moving, const Cotangents& cotangents, const Gradients& out) {
        moments_.resize(arrived_.tile_of_pair.size() * kMoments);
        silence_unwanted(wanted(), arrived_, moments_.data());
        each_active(pool, [&](int t) { backward_tile(lists_, trace_, camera_, t, cotangents, moments_.data()); });
        backward_scene(pool, moving, camera_, {arrived_.projected.data(), arrived_.first_pair.data()}, moments_.data(), out);
    }

    void commit(Pool& pool, Binner& binner, const Scene& scene, const int64_t* rows, int64_t count, const int64_t* renumbered,
                int64_t before) {
        IncrementalView::commit(pool, binner, scene, rows, rows, count, scene.count, renumbered, before);
        empty_unwanted();
        for (Shown& shown : shown_) shown.moved = false;
    }

    // Redraws stale tiles. `weights` (2, count) receives every Gaussian's sum of alpha T over recorded pixels and over marked ones
    // (`marks`, one byte per pixel; null: none).
    void redraw(Pool& pool, const uint8_t* marks, const Planes& out, float* weights, int64_t count) {
        line_up([&](int t) { return marks && any_marked(marks, t); });
        for (int t : active_) shown_[t].shallow = false;
        in_all_.resize(lists_.entries.size());
        marked_.resize(lists_.entries.size());
        each_active(pool, [&](int t) { weigh(t, marks, out); });
        if (weights) add_weights(marks, weights, count);
    }

    // Projected means (count, 2) of the static scene, in pixels; NaN where culled.
    void centres(int64_t count, float* to) const {
        for (int64_t i = 0; i < count; ++i) {
            const Projected& g = lists_.projected[i];
            to[2 * i] = g.cut > 0.0f ? g.x : NAN;
            to[2 * i + 1] = g.cut > 0.0f ? g.y : NAN;
        }
    }

 private:
    struct Shown {  // state of a tile's picture
        bool moved = false;   // detached Gaussians are shown or missing
        bool shallow = true;  // last drawn without depth
    };

    const uint8_t* wanted() const { return wanted_.empty() ? nullptr : wanted_.data(); }

    void empty_unwanted() {
        for (size_t t = 0; t < wanted_.size(); ++t)
            if (!wanted_[t]) tiles_[t].statics.clear();
    }

    void weigh(int t, const uint8_t* marks, const Planes& out) {
        // Of its own allocation: Windows aligns what is local to a thread to 16 bytes, and vectors are wider.
        static thread_local const std::unique_ptr<Weigher> kept(new Weigher);
        Weigher& weigher = *kept;
        weigher.recorded = recorded_;
        weigher.marks = marks;
        weigher.in_all = in_all_.data();
        weigher.marked = marked_.data();
        const uint32_t begin = lists_.first_entry[t], end = lists_.first_entry[t + 1];
        std::fill(in_all_.begin() + begin, in_all_.begin() + end, 0.0f);  // entries behind opaque ones are not visited
        std::fill(marked_.begin() + begin, marked_.begin() + end, 0.0f);
        weigher.start(camera_, t % lists_.columns, t / lists_.columns);
        list_statics(t);
        composite_tile(lists_, camera_, t, out, nullptr, weigher);
        for (uint32_t e = begin; e < end; ++e) tiles_[t].statics[e - begin].weight = in_all_[e];
    }

    bool any_marked(const uint8_t* marks, int t) const {
        const int x0 = t % lists_.columns * kTile, y0 = t / lists_.columns * kTile, width = std::min(kTile, camera_.width - x0);
        for (int y = y0; y < std::min(camera_.height, y0 + kTile); ++y) {
            const uint8_t* first = marks + static_cast<int64_t>(y) * camera_.width + x0;
            if (std::any_of(first, first + width, [](uint8_t mark) { return mark != 0; })) return true;
        }
        return false;
    }

    void add_weights(const uint8_t* marks, float* weights, int64_t count) const {
        std::fill(weights, weights + 2 * count, 0.0f);
        for (const Tile& tile : tiles_)
            for (const Static& r : tile.statics) weights[r.gaussian] += r.weight;
        if (!marks) return;
        for (int t : active_)
            for (uint32_t e = lists_.first_entry[t]; e < lists_.first_entry[t + 1]; ++e) weights[count + lists_.entries[e].gaussian] += marked_[e];
    }

    const uint8_t* recorded_;
    std::vector<uint8_t> wanted_;  // one per tile; empty: all are
    std::vector<Shown> shown_;  // one per tile
    Trace trace_;
    std::vector<float> moments_, in_all_, marked_;
};

}  // namespace decogs
