// The decoder's kernel behind the few functions that the player calls; their signatures are mirrored in renderer.ts.
//
// All of one scene and one picture lies here: the page copies stored values in and pixels out.
#include <cmath>
#include <cstdlib>

#include "composite.h"

using namespace decogs;

namespace {
struct Room {  // grows, never shrinks: pictures of one player are of about one size
    float* at = nullptr;
    size_t holds = 0;

    // Room for so many floats; null when memory runs out.
    float* of(size_t floats) {
        if (at && floats <= holds) return at;
        std::free(at);
        at = static_cast<float*>(std::malloc(std::max<size_t>(floats, 1) * sizeof(float)));
        holds = at ? floats : 0;
        return at;
    }
};

Pool pool(1);
Binner binner;
TileLists lists;
Camera camera;
Scene scene;
Room scene_room, plane_room, pixel_room;

// As Python's to_8bit: clipped, times 255 in float32, rounded to nearest, ties to even.
uint8_t to_8bit(float value) {
    const float clipped = value < 0.0f ? 0.0f : value > 1.0f ? 1.0f : value;
    return static_cast<uint8_t>(std::rint(clipped * 255.0f));
}
}  // namespace

extern "C" {

int exact_failure() { return failure; }

// Where the stored values of `count` Gaussians go, one array behind the other: means (3 each), log scales (3), quaternions
// (4), opacity logits (1), SH (3 (degree + 1)^2). Null when memory runs out.
float* exact_scene(int32_t count, int32_t sh_degree) {
    const int32_t coefficients = (sh_degree + 1) * (sh_degree + 1);
    const size_t n = static_cast<size_t>(count);
    float* at = scene_room.of(n * (11 + 3 * coefficients));
    scene = {at ? count : 0, coefficients, sh_degree, at, at + 3 * n, at + 6 * n, at + 10 * n, at + 11 * n};
    return at;
}

// Where the camera goes: 23 floats and two integers (project.h).
Camera* exact_camera() { return &camera; }

// Draws the scene: colour (3, height, width), alpha and depth (height, width), one plane behind the other. Null when
// memory runs out; traps above `max_pairs` of a tile and a Gaussian.
float* exact_draw(float red, float green, float blue, uint32_t max_pairs) {
    const size_t plane = static_cast<size_t>(camera.width) * camera.height;
    float* at = plane_room.of(5 * plane);
    if (!at) return nullptr;
    const Planes planes = {at, at + 3 * plane, at + 4 * plane, {red, green, blue}};
    render_picture(pool, binner, scene, camera, planes, lists, nullptr, max_pairs);
    return at;
}

// The picture that was drawn last as bytes, RGBA and opaque; null when memory runs out.
uint8_t* exact_pixels() {
    const size_t plane = static_cast<size_t>(camera.width) * camera.height;
    auto* to = reinterpret_cast<uint8_t*>(pixel_room.of(plane));
    if (!to) return nullptr;
    for (size_t i = 0; i < plane; ++i) {
        for (int c = 0; c < 3; ++c) to[4 * i + c] = to_8bit(plane_room.at[c * plane + i]);
        to[4 * i + 3] = 255;
    }
    return to;
}
}
