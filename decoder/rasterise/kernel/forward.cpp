// The decoder's renderer behind a plain C interface; the signatures are mirrored in native.py.
#include "composite.h"

using namespace decogs;

namespace {
struct Renderer {
    explicit Renderer(int threads) : pool(threads) {}
    Pool pool;
    Binner binner;
    TileLists lists;
};
}  // namespace

extern "C" {

// 2 when this machine runs the AVX-512 build, 1 the AVX2 build, 0 only the base build. Asked of the base build, which
// every machine can load.
int decogs_instruction_set() {
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
        __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512cd"))
        return 2;
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2")) return 1;
#endif
    return 0;
}

void* decogs_renderer_create(int threads) { return new Renderer(threads); }

void decogs_renderer_destroy(void* renderer) { delete static_cast<Renderer*>(renderer); }

void decogs_render(void* handle, const Scene* scene, const Camera* camera, const Planes* out) {
    auto& renderer = *static_cast<Renderer*>(handle);
    render_picture(renderer.pool, renderer.binner, *scene, *camera, *out, renderer.lists, nullptr);
}
}
