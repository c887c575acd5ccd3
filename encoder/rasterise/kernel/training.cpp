// The encoder's differentiable renderer, loss and optimiser behind a plain C interface; mirrored in native.py.
#include "adam.h"
#include "backward.h"
#include "loss.h"

using namespace decogs;

namespace {
struct Trainer {
    explicit Trainer(int threads) : pool(threads) {}
    Pool pool;
    Binner binner;
    TileLists lists;
    Trace trace;
    std::vector<float> moments;
    Loss loss;
};
Trainer& trainer_of(void* handle) { return *static_cast<Trainer*>(handle); }
}  // namespace

extern "C" {

void* decogs_trainer_create(int threads) { return new Trainer(threads); }

void decogs_trainer_destroy(void* handle) { delete static_cast<Trainer*>(handle); }

void decogs_forward(void* handle, const Scene* scene, const Camera* camera, const Planes* out) {
    Trainer& t = trainer_of(handle);
    render_picture(t.pool, t.binner, *scene, *camera, *out, t.lists, &t.trace);
}

// As decogs_forward into a picture that already shows the scene with other values of `selected`: only tiles that one of
// them meets now, or met when the picture was drawn before, can differ. `touched`, one byte per tile, remembers those.
// `first` draws the whole picture and starts that memory.
void decogs_redraw(void* handle, const Scene* scene, const Camera* camera, const Planes* out, const uint8_t* selected, int first,
                   uint8_t* touched) {
    Trainer& t = trainer_of(handle);
    t.binner.run(t.pool, *scene, *camera, t.lists);
    t.trace.resize(t.lists);
    t.pool.run(t.lists.rows, [&](int row) {
        for (int tile = row * t.lists.columns; tile < (row + 1) * t.lists.columns; ++tile) {
            bool met = false;
            for (uint32_t e = t.lists.first_entry[tile]; !met && e < t.lists.first_entry[tile + 1]; ++e)
                met = selected[t.lists.entries[e].gaussian];
            if (first) touched[tile] = 0;
            touched[tile] |= met;
            if (first || touched[tile]) composite_tile(t.lists, *camera, tile, *out, &t.trace);
        }
    });
}

// Gradients of the last decogs_forward or decogs_redraw; `selected`, one byte per Gaussian, may be null for all.
void decogs_backward(void* handle, const Scene* scene, const Camera* camera, const Cotangents* cotangents, const uint8_t* selected,
                     const Gradients* out) {
    Trainer& t = trainer_of(handle);
    t.moments.resize(t.lists.entries.size() * kMoments);
    t.pool.run(t.lists.rows, [&](int row) {
        for (int column = 0; column < t.lists.columns; ++column)
            backward_tile(t.lists, t.trace, *camera, row * t.lists.columns + column, *cotangents, selected, t.moments.data());
    });
    const int chunks = static_cast<int>((scene->count + kChunk - 1) / kChunk);
    t.pool.run(chunks, [&](int chunk) {
        const int64_t end = std::min<int64_t>(scene->count, static_cast<int64_t>(chunk + 1) * kChunk);
        for (int64_t base = static_cast<int64_t>(chunk) * kChunk; base < end; base += kLanes)
            backward_group(*scene, *camera, t.lists, t.moments.data(), base, selected, *out);
    });
}

void decogs_loss(void* handle, const LossInput* in, float* gradient, LossSums* sums) {
    Trainer& t = trainer_of(handle);
    *sums = t.loss.run(t.pool, *in, gradient);
}

void decogs_adam(void* handle, const AdamStep* step, int64_t row_count, const int64_t* rows, int columns, const float* rates,
                 float* value, const float* gradient, float* first, float* second) {
    adam_rows(trainer_of(handle).pool, *step, row_count, rows, columns, rates, value, gradient, first, second);
}

// The projected centres, (count, 2) pixels, and depths, (count,), of the last decogs_forward; not-a-number where not drawn.
void decogs_centres(void* handle, int64_t count, float* centres, float* depths) {
    const Trainer& t = trainer_of(handle);
    for (int64_t i = 0; i < count; ++i) {
        const Projected& g = t.lists.projected[i];
        const bool drawn = t.lists.first_pair[i + 1] > t.lists.first_pair[i];
        centres[2 * i] = drawn ? g.x : NAN;
        centres[2 * i + 1] = drawn ? g.y : NAN;
        depths[i] = drawn ? g.depth : NAN;
    }
}
}
