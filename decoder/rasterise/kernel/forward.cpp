// The decoder's renderer behind a plain C interface; the signatures are mirrored in native.py.
#include "incremental_view.h"

using namespace decogs;

namespace {
struct Renderer {
    explicit Renderer(int threads) : pool(threads) {}
    Pool pool;
    Binner binner;
    TileLists lists;
};
Renderer& renderer_of(void* handle) { return *static_cast<Renderer*>(handle); }
IncrementalView& view_of(void* handle) { return *static_cast<IncrementalView*>(handle); }
}  // namespace

#pragma GCC visibility push(default)
extern "C" {

// Sizes of the structs of this interface, in the order in which Python's loader states them, and a 0 at the end.
const int64_t* decogs_sizes() {
    static const int64_t sizes[] = {sizeof(Scene), sizeof(Camera), sizeof(Planes), sizeof(Picture), 0};
    return sizes;
}

void* decogs_renderer_create(int threads) {
    return created([&] { return new Renderer(threads); });
}

void decogs_renderer_destroy(void* renderer) { delete static_cast<Renderer*>(renderer); }

int decogs_render(void* handle, const Scene* scene, const Camera* camera, const Planes* out, uint64_t max_pairs) {
    Renderer& renderer = renderer_of(handle);
    return status_of([&] {
        render_picture(renderer.pool, renderer.binner, *scene, *camera, *out, renderer.lists, nullptr, max_pairs);
    });
}

void* decogs_incremental_create(const Camera* camera) {
    return created([&] { return new IncrementalView(*camera); });
}

void decogs_incremental_allow(void* view, uint64_t max_pairs) { view_of(view).allow(max_pairs); }

void decogs_incremental_destroy(void* view) { delete static_cast<IncrementalView*>(view); }

int decogs_incremental_set_scene(void* handle, void* view, const Scene* scene) {
    Renderer& renderer = renderer_of(handle);
    return status_of([&] { view_of(view).set_scene(renderer.pool, renderer.binner, *scene); });
}

// Detaches the `gone_count` Gaussians `gone` and commits the Gaussians of `changed` as `rows`.
int decogs_incremental_change(void* handle, void* view, const int64_t* gone, int64_t gone_count, const Scene* changed, const int64_t* rows,
                           int64_t population, const int64_t* renumbered, int64_t before) {
    Renderer& renderer = renderer_of(handle);
    return status_of([&] {
        view_of(view).detach(gone, gone_count);
        view_of(view).commit(renderer.pool, renderer.binner, *changed, nullptr, rows, changed->count, population, renumbered, before);
    });
}

// `redrawn`: number of redrawn tiles.
int decogs_incremental_redraw(void* handle, void* view, const Planes* planes, const Picture* to, int64_t* redrawn) {
    return status_of([&] { *redrawn = view_of(view).redraw(renderer_of(handle).pool, *planes, *to); });
}
}
#pragma GCC visibility pop
