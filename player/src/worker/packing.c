/**
 * Gaussians as words of the data textures (packing.ts says which), a batch of rows at a time.
 *
 * Row after row: `batch_means` and so on hold the stored values, `batch_base` and `batch_rest` take the words.
 */
#include "../kernel/kernel.h"

#define MOST_COEFFICIENTS 16
#define BASE_WORDS 8
#define MOST_REST_WORDS 24

static const float LOG_SCALE_LIMIT = 40;
static const float LOG_SCALE_STEPS = 65535.0f / 80;
static const float ROTATION_STEPS = 16383;

static float batch_means[3 * BATCH];
static float batch_log_scales[3 * BATCH];
static float batch_quaternions[4 * BATCH];
static float batch_opacity_logits[BATCH];
static float batch_sh[3 * MOST_COEFFICIENTS * BATCH];
static uint32_t batch_base[BASE_WORDS * BATCH];
static uint32_t batch_rest[MOST_REST_WORDS * BATCH];

EXPORT(means_at) float *means_at(void) { return batch_means; }
EXPORT(log_scales_at) float *log_scales_at(void) { return batch_log_scales; }
EXPORT(quaternions_at) float *quaternions_at(void) { return batch_quaternions; }
EXPORT(opacity_logits_at) float *opacity_logits_at(void) { return batch_opacity_logits; }
EXPORT(sh_at) float *sh_at(void) { return batch_sh; }
EXPORT(base_at) uint32_t *base_at(void) { return batch_base; }
EXPORT(rest_at) uint32_t *rest_at(void) { return batch_rest; }

/** A float32 and its bits. */
typedef union {
    float value;
    uint32_t bits;
} Word;

static uint32_t bits_of(float value) { return (Word){.value = value}.bits; }

/** The half (IEEE 754 binary16) nearest to a number, ties away from zero; the largest one for all beyond. */
static uint32_t half_bits(float value) {
    const uint32_t bits = bits_of(value);
    const uint32_t size = bits & 0x7fffffff;
    const uint32_t sign = bits >> 16 & 0x8000;
    // Infinities have no place in a scene.
    if (size >= 0x477ff000) return sign | 0x7bff;
    // Below 2^-14 halves are multiples of 2^-24.
    if (size < 0x38800000) return sign | (uint32_t)(__builtin_fabsf(value) * 0x1p24f + 0.5f);
    return sign | (size - 0x38000000 + 0x1000) >> 13;
}

/** e to a power of at most 0 to some 1e-7 of itself: a power of two, and the series of e to what is left of it. */
static float exponential(float power) {
    if (power < -80) return 0;
    const float whole = __builtin_floorf(power * 1.44269504f + 0.5f);
    const float x = power - whole * 0.693359375f + whole * 2.12194440e-4f;
    const float series = 1 + x * (1 + x * (0.5f + x * (1.0f / 6 + x * (1.0f / 24 + x * (1.0f / 120 + x / 720)))));
    return series * (Word){.bits = (uint32_t)((int32_t)whole + 127) << 23}.value;
}

static uint32_t opacity_bits(float logit) {
    const float part = exponential(logit < 0 ? logit : -logit);
    const float opacity = (logit < 0 ? part : 1.0f) / (1 + part);
    return (uint32_t)(opacity * 65535 + 0.5f);
}

static uint32_t log_scale_bits(float value) {
    const float steps = (value + LOG_SCALE_LIMIT) * LOG_SCALE_STEPS + 0.5f;
    return steps < 0 ? 0 : steps > 65535 ? 65535 : (uint32_t)steps;
}

/** The smaller three components, upper half of the word at `words` first. A zero quaternion is no rotation. */
static void pack_rotation(const float *quaternion, uint32_t *words) {
    double part[4] = {quaternion[0], quaternion[1], quaternion[2], quaternion[3]};
    const double square = part[0] * part[0] + part[1] * part[1] + part[2] * part[2] + part[3] * part[3];
    if (square == 0) part[0] = 1;
    uint32_t largest = 0;
    for (uint32_t i = 1; i < 4; i++) {
        if (__builtin_fabs(part[i]) > __builtin_fabs(part[largest])) largest = i;
    }
    const double norm = square == 0 ? 1 : __builtin_sqrt(square);
    const double scale = (part[largest] < 0 ? -1.4142135623730951 : 1.4142135623730951) * ROTATION_STEPS / norm;
    uint32_t steps[3];
    for (uint32_t i = 0; i < 3; i++) steps[i] = (uint32_t)(part[i < largest ? i : i + 1] * scale + ROTATION_STEPS + 0.5);
    words[0] |= steps[0] << 16;
    words[1] = steps[1] | (largest & 1) << 15 | steps[2] << 16 | largest >> 1 << 31;
}

static void pack_base(uint32_t row, const float *sh) {
    uint32_t *words = batch_base + BASE_WORDS * row;
    const float *scales = batch_log_scales + 3 * row;
    for (uint32_t axis = 0; axis < 3; axis++) words[axis] = bits_of(batch_means[3 * row + axis]);
    words[3] = half_bits(sh[0]) | half_bits(sh[1]) << 16;
    words[4] = half_bits(sh[2]) | opacity_bits(batch_opacity_logits[row]) << 16;
    words[5] = log_scale_bits(scales[0]) | log_scale_bits(scales[1]) << 16;
    words[6] = log_scale_bits(scales[2]);
    pack_rotation(batch_quaternions + 4 * row, words + 6);
}

/** Words of so many rows; `rest_words` is 0 where there are no higher harmonics. */
EXPORT(pack) void pack(uint32_t rows, uint32_t coefficients, uint32_t rest_words) {
    const uint32_t halves = 3 * (coefficients - 1);
    for (uint32_t row = 0; row < rows; row++) {
        const float *sh = batch_sh + 3 * coefficients * row;
        pack_base(row, sh);
        uint32_t *rest = batch_rest + rest_words * row;
        for (uint32_t i = 0; i < halves; i += 2) {
            rest[i / 2] = half_bits(sh[3 + i]) | (i + 1 < halves ? half_bits(sh[4 + i]) << 16 : 0);
        }
    }
}
