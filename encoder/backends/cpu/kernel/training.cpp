// The encoder's differentiable renderer, loss and optimiser behind a plain C interface; mirrored in native.py.
#include "adam.h"
#include "backward.h"
#include "fixed_view.h"
#include "loss.h"
#include "wanted_tiles.h"

using namespace decogs;

namespace {
struct Trainer {
    explicit Trainer(int threads) : pool(threads) {}
    Pool pool;
    Binner binner;
    TileLists lists;
    Trace trace;
    std::vector<float> moments;
    const uint8_t* wanted = nullptr;  // of the last decogs_forward
    Loss loss;
};
Trainer& trainer_of(void* handle) { return *static_cast<Trainer*>(handle); }
FixedView& view_of(void* handle) { return *static_cast<FixedView*>(handle); }
}  // namespace

#pragma GCC visibility push(default)
extern "C" {

// Sizes of the structs of this interface, in the order in which Python's loader states them, and a 0 at the end.
const int64_t* decogs_sizes() {
    static const int64_t sizes[] = {sizeof(Scene),     sizeof(Camera),    sizeof(Planes),   sizeof(Cotangents),
                                    sizeof(Gradients), sizeof(LossInput), sizeof(LossSums), sizeof(AdamStep), 0};
    return sizes;
}

void* decogs_trainer_create(int threads) {
    return created([&] { return new Trainer(threads); });
}

void decogs_trainer_destroy(void* handle) { delete static_cast<Trainer*>(handle); }

// `wanted`: one byte per tile, which stay until the way back; the others show the background. Null: all are.
int decogs_forward(void* handle, const Scene* scene, const Camera* camera, const uint8_t* wanted, const Planes* out) {
    Trainer& t = trainer_of(handle);
    return status_of([&] {
        t.binner.run(t.pool, *scene, *camera, nullptr, scene->count, t.lists);
        t.wanted = wanted;
        drop_unwanted(wanted, t.lists);
        t.trace.resize(t.lists);
        t.pool.run(t.lists.rows, [&](int row) {
            for (int column = 0; column < t.lists.columns; ++column)
                composite_tile(t.lists, *camera, row * t.lists.columns + column, *out, &t.trace);
        });
    });
}

// Gradients through the last decogs_forward.
int decogs_backward(void* handle, const Scene* scene, const Camera* camera, const Cotangents* cotangents, const Gradients* out) {
    Trainer& t = trainer_of(handle);
    return status_of([&] {
        t.moments.resize(t.lists.tile_of_pair.size() * kMoments);
        silence_unwanted(t.wanted, t.lists, t.moments.data());
        t.pool.run(t.lists.rows, [&](int row) {
            for (int column = 0; column < t.lists.columns; ++column)
                backward_tile(t.lists, t.trace, *camera, row * t.lists.columns + column, *cotangents, t.moments.data());
        });
        backward_scene(t.pool, *scene, *camera, {t.lists.projected.data(), t.lists.first_pair.data()}, t.moments.data(), *out);
    });
}

// `recorded`: one byte per pixel, which stay as long as the view; null: all were.
void* decogs_view_create(const Camera* camera, const uint8_t* recorded) {
    return created([&] { return new FixedView(*camera, recorded); });
}

void decogs_view_destroy(void* view) { delete static_cast<FixedView*>(view); }

int decogs_view_set_scene(void* handle, void* view, const Scene* scene) {
    Trainer& t = trainer_of(handle);
    return status_of([&] { view_of(view).set_scene(t.pool, t.binner, *scene); });
}

int decogs_view_detach(void* view, const int64_t* rows, int64_t count) {
    return status_of([&] { view_of(view).detach(rows, count); });
}

int decogs_view_draw(void* handle, void* view, const Scene* moving, const int64_t* rows, const Planes* out, uint8_t* met) {
    Trainer& t = trainer_of(handle);
    return status_of([&] { view_of(view).draw(t.pool, t.binner, *moving, rows, *out, met); });
}

int decogs_view_backward(void* handle, void* view, const Scene* moving, const Cotangents* cotangents, const Gradients* out) {
    return status_of([&] { view_of(view).backward(trainer_of(handle).pool, *moving, *cotangents, *out); });
}

int decogs_view_commit(void* handle, void* view, const Scene* scene, const int64_t* rows, int64_t count, const int64_t* renumbered,
                       int64_t before) {
    Trainer& t = trainer_of(handle);
    return status_of([&] { view_of(view).commit(t.pool, t.binner, *scene, rows, count, renumbered, before); });
}

int decogs_view_redraw(void* handle, void* view, const uint8_t* marks, const Planes* out, float* weights, int64_t count) {
    return status_of([&] { view_of(view).redraw(trainer_of(handle).pool, marks, *out, weights, count); });
}

void decogs_view_centres(void* view, int64_t count, float* to) { view_of(view).centres(count, to); }

int decogs_loss(void* handle, const LossInput* in, float* gradient, LossSums* sums) {
    Trainer& t = trainer_of(handle);
    return status_of([&] { *sums = t.loss.run(t.pool, *in, gradient); });
}

int decogs_adam(void* handle, const AdamStep* step, int64_t count, int columns, const float* rates, float* value,
                const float* gradient, float* first, float* second) {
    return status_of([&] { adam_rows(trainer_of(handle).pool, *step, count, columns, rates, value, gradient, first, second); });
}

// Projected means (count, 2), in pixels, and depths (count,) of the last decogs_forward; NaN where culled.
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
#pragma GCC visibility pop
