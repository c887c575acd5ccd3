// Sixteen float lanes, the width of one 4x4 pixel block, whatever the instruction set.
//
// The same source is compiled once per instruction set; lanes are spread over as many native vectors as it takes.
// Every operation is a single IEEE operation per lane and no multiply-add is contracted (-ffp-contract=off), so all
// builds give the same bits.
#pragma once

#include <cstdint>
#include <cstring>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#if defined(__AVX512F__)
#define DECOGS_NATIVE 16
#elif defined(__AVX2__)
#define DECOGS_NATIVE 8
#else
#define DECOGS_NATIVE 4
#endif
#define DECOGS_INLINE inline __attribute__((always_inline))

namespace decogs {

constexpr int kLanes = 16;
constexpr int kParts = kLanes / DECOGS_NATIVE;

typedef float NativeF __attribute__((vector_size(4 * DECOGS_NATIVE)));
typedef int32_t NativeI __attribute__((vector_size(4 * DECOGS_NATIVE)));

struct F {
    NativeF v[kParts];
};
struct I {  // integers, or a mask of -1 (true) and 0 (false)
    NativeI v[kParts];
};

#define DECOGS_EACH for (int p = 0; p < kParts; ++p)

DECOGS_INLINE F splat(float x) {
    F r;
    DECOGS_EACH r.v[p] = x - NativeF{};
    return r;
}
DECOGS_INLINE I splati(int32_t x) {
    I r;
    DECOGS_EACH r.v[p] = x - NativeI{};
    return r;
}
DECOGS_INLINE F load(const float* a) {
    F r;
    std::memcpy(&r, a, sizeof r);
    return r;
}
DECOGS_INLINE I loadi(const int32_t* a) {
    I r;
    std::memcpy(&r, a, sizeof r);
    return r;
}
DECOGS_INLINE void store(float* a, const F& x) { std::memcpy(a, &x, sizeof x); }
DECOGS_INLINE void storei(int32_t* a, const I& x) { std::memcpy(a, &x, sizeof x); }

#define DECOGS_BINARY(op)                          \
    DECOGS_INLINE F operator op(const F& a, const F& b) { \
        F r;                                       \
        DECOGS_EACH r.v[p] = a.v[p] op b.v[p];     \
        return r;                                  \
    }                                              \
    DECOGS_INLINE F operator op(const F& a, float b) { return a op splat(b); } \
    DECOGS_INLINE F operator op(float a, const F& b) { return splat(a) op b; }
DECOGS_BINARY(+)
DECOGS_BINARY(-)
DECOGS_BINARY(*)
DECOGS_BINARY(/)
#undef DECOGS_BINARY

DECOGS_INLINE F operator-(const F& a) {
    F r;
    DECOGS_EACH r.v[p] = -a.v[p];
    return r;
}

#define DECOGS_COMPARE(op)                              \
    DECOGS_INLINE I operator op(const F& a, const F& b) { \
        I r;                                            \
        DECOGS_EACH r.v[p] = a.v[p] op b.v[p];          \
        return r;                                       \
    }                                                   \
    DECOGS_INLINE I operator op(const F& a, float b) { return a op splat(b); } \
    DECOGS_INLINE I operator op(const I& a, const I& b) { \
        I r;                                            \
        DECOGS_EACH r.v[p] = a.v[p] op b.v[p];          \
        return r;                                       \
    }
DECOGS_COMPARE(<)
DECOGS_COMPARE(<=)
DECOGS_COMPARE(>)
DECOGS_COMPARE(>=)
#undef DECOGS_COMPARE

#define DECOGS_BITS(op)                                 \
    DECOGS_INLINE I operator op(const I& a, const I& b) { \
        I r;                                            \
        DECOGS_EACH r.v[p] = a.v[p] op b.v[p];          \
        return r;                                       \
    }
DECOGS_BITS(&)
DECOGS_BITS(|)
DECOGS_BITS(+)
DECOGS_BITS(-)
#undef DECOGS_BITS

DECOGS_INLINE I shift_left(const I& a, int n) {
    I r;
    DECOGS_EACH r.v[p] = a.v[p] << n;
    return r;
}
DECOGS_INLINE I shift_right(const I& a, int n) {  // arithmetic
    I r;
    DECOGS_EACH r.v[p] = a.v[p] >> n;
    return r;
}
DECOGS_INLINE F select(const I& mask, const F& a, const F& b) {
    F r;
    DECOGS_EACH r.v[p] = mask.v[p] ? a.v[p] : b.v[p];
    return r;
}
DECOGS_INLINE I select(const I& mask, const I& a, const I& b) {
    I r;
    DECOGS_EACH r.v[p] = mask.v[p] ? a.v[p] : b.v[p];
    return r;
}
DECOGS_INLINE F min(const F& a, const F& b) { return select(a < b, a, b); }
DECOGS_INLINE F max(const F& a, const F& b) { return select(a > b, a, b); }
DECOGS_INLINE F min(const F& a, float b) { return min(a, splat(b)); }
DECOGS_INLINE F max(const F& a, float b) { return max(a, splat(b)); }

DECOGS_INLINE I to_int(const F& a) {  // towards zero
    I r;
    DECOGS_EACH r.v[p] = __builtin_convertvector(a.v[p], NativeI);
    return r;
}
DECOGS_INLINE F to_float(const I& a) {
    F r;
    DECOGS_EACH r.v[p] = __builtin_convertvector(a.v[p], NativeF);
    return r;
}
DECOGS_INLINE F bits_to_float(const I& a) {
    F r;
    std::memcpy(&r, &a, sizeof r);
    return r;
}
DECOGS_INLINE I float_to_bits(const F& a) {
    I r;
    std::memcpy(&r, &a, sizeof r);
    return r;
}
DECOGS_INLINE F sqrt(const F& a) {
    F r;
    DECOGS_EACH for (int i = 0; i < DECOGS_NATIVE; ++i) r.v[p][i] = __builtin_sqrtf(a.v[p][i]);
    return r;
}
DECOGS_INLINE bool any(const I& mask) {  // of a mask, whose lanes are -1 or 0
#if defined(__AVX512F__)
    return _mm512_test_epi32_mask((__m512i)mask.v[0], (__m512i)mask.v[0]) != 0;
#elif defined(__AVX2__)
    return _mm256_movemask_ps((__m256)(mask.v[0] | mask.v[1])) != 0;
#elif defined(__SSE2__)
    return _mm_movemask_ps((__m128)(mask.v[0] | mask.v[1] | mask.v[2] | mask.v[3])) != 0;
#else
    int32_t all = 0;
    DECOGS_EACH for (int i = 0; i < DECOGS_NATIVE; ++i) all |= mask.v[p][i];
    return all != 0;
#endif
}

// exp(x) for x in [-87, 88]; clamped outside. Relative error below 2e-7 (Cephes polynomial).
DECOGS_INLINE F exp(F x) {
    x = min(max(x, -87.0f), 88.0f);
    const F scaled = x * 1.44269504088896341f;
    const I n = to_int(scaled + select(scaled < 0.0f, splat(-0.5f), splat(0.5f)));
    const F k = to_float(n);
    const F r = (x - k * 0.693359375f) - k * -2.12194440e-4f;
    F p = r * 1.9875691500e-4f + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    const F y = (p * r) * r + (r + 1.0f);
    return y * bits_to_float(shift_left(n + splati(127), 23));
}

// 2^-t for t in [0, 126], anything outside. Relative error below 2e-7.
DECOGS_INLINE F exp2_negative(const F& t) {
    const I n = to_int(t + 0.5f);
    const F f = to_float(n) - t;  // in [-0.5, 0.5]
    F p = f * 1.3276471992e-3f + 9.6755413344e-3f;
    p = p * f + 5.5507132734e-2f;
    p = p * f + 2.4022119656e-1f;
    p = p * f + 6.9314697171e-1f;
    p = p * f + 1.0f;
    return bits_to_float(float_to_bits(p) - shift_left(n, 23));
}

// log(x) for normal positive x. Absolute error below 2e-7 (Cephes polynomial).
DECOGS_INLINE F log(const F& x) {
    const I bits = float_to_bits(x);
    I e = shift_right(bits, 23) - splati(126);
    F m = bits_to_float((bits & splati(0x007fffff)) | splati(0x3f000000));  // 0.5 <= m < 1
    const I small = m < 0.707106781186547524f;
    e = e + (small & splati(-1));
    m = select(small, m + m, m) - 1.0f;
    const F z = m * m;
    F p = m * 7.0376836292e-2f - 1.1514610310e-1f;
    p = p * m + 1.1676998740e-1f;
    p = p * m - 1.2420140846e-1f;
    p = p * m + 1.4249322787e-1f;
    p = p * m - 1.6668057665e-1f;
    p = p * m + 2.0000714765e-1f;
    p = p * m - 2.4999993993e-1f;
    p = p * m + 3.3333331174e-1f;
    const F k = to_float(e);
    F y = p * m * z;
    y = y + k * -2.12194440e-4f;
    y = y - z * 0.5f;
    return m + y + k * 0.693359375f;
}

}  // namespace decogs
