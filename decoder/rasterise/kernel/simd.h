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
#elif defined(__wasm_simd128__)
#include <wasm_simd128.h>
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
struct I {
    NativeI v[kParts];
};
#if defined(__AVX512F__)
struct M {  // a mask per lane
    __mmask16 bits;
};
#else
struct M {  // a mask per lane: -1 or 0
    NativeI v[kParts];
};
#endif

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
// Copies one native vector at a time: a compiler may split a whole copy differently and stall on store forwarding.
DECOGS_INLINE F load(const float* a) {
    F r;
    DECOGS_EACH std::memcpy(&r.v[p], a + p * DECOGS_NATIVE, sizeof r.v[p]);
    return r;
}
// load(a + kOffset) for aligned `a`, of which the sixteen values before and behind may be read too.
template <int kOffset>
DECOGS_INLINE F load_beside(const float* a) {
#if defined(__AVX512F__)  // a load across two cache lines costs twice, a shift across two registers does not
    const __m512i here = _mm512_load_si512(a);
    if (kOffset < 0) return {{(NativeF)_mm512_alignr_epi32(here, _mm512_load_si512(a - 16), (16 + kOffset) & 15)}};
    return {{(NativeF)_mm512_alignr_epi32(_mm512_load_si512(a + 16), here, kOffset & 15)}};
#else
    return load(a + kOffset);
#endif
}
DECOGS_INLINE I loadi(const int32_t* a) {
    I r;
    DECOGS_EACH std::memcpy(&r.v[p], a + p * DECOGS_NATIVE, sizeof r.v[p]);
    return r;
}
DECOGS_INLINE void store(float* a, const F& x) { DECOGS_EACH std::memcpy(a + p * DECOGS_NATIVE, &x.v[p], sizeof x.v[p]); }
DECOGS_INLINE void storei(int32_t* a, const I& x) { DECOGS_EACH std::memcpy(a + p * DECOGS_NATIVE, &x.v[p], sizeof x.v[p]); }

// Loads from an array that ends after `left` values; zero beyond.
DECOGS_INLINE F load_some(const float* a, int64_t left) {
    if (left >= kLanes) return load(a);
    float lanes[kLanes] = {0};
    std::memcpy(lanes, a, sizeof(float) * left);
    return load(lanes);
}
DECOGS_INLINE void store_some(float* a, int64_t left, const F& x) {
    if (left >= kLanes) return store(a, x);
    float lanes[kLanes];
    store(lanes, x);
    std::memcpy(a, lanes, sizeof(float) * left);
}

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

// Comparisons (false for NaN), masks and selection. Intrinsics where a compiler would need several instructions; each
// matches the plain loop at the end.
#if defined(__AVX512F__)
#define DECOGS_COMPARE(op, code)                                                                              \
    DECOGS_INLINE M operator op(const F& a, const F& b) {                                                     \
        return {_mm512_cmp_ps_mask((__m512)a.v[0], (__m512)b.v[0], _CMP_##code##_OQ)};                        \
    }                                                                                                         \
    DECOGS_INLINE M operator op(const I& a, const I& b) {                                                     \
        return {_mm512_cmp##code##_epi32_mask((__m512i)a.v[0], (__m512i)b.v[0])};                             \
    }
#define _mm512_cmpLT_epi32_mask _mm512_cmplt_epi32_mask
#define _mm512_cmpLE_epi32_mask _mm512_cmple_epi32_mask
#define _mm512_cmpGT_epi32_mask _mm512_cmpgt_epi32_mask
#define _mm512_cmpGE_epi32_mask _mm512_cmpge_epi32_mask
DECOGS_COMPARE(<, LT)
DECOGS_COMPARE(<=, LE)
DECOGS_COMPARE(>, GT)
DECOGS_COMPARE(>=, GE)
#undef DECOGS_COMPARE
DECOGS_INLINE M operator&(M a, M b) { return {static_cast<__mmask16>(a.bits & b.bits)}; }
DECOGS_INLINE M and_not(M a, M b) { return {static_cast<__mmask16>(a.bits & ~b.bits)}; }
DECOGS_INLINE unsigned bits(M a) { return a.bits; }
DECOGS_INLINE F select(M mask, const F& a, const F& b) {
    return {{(NativeF)_mm512_mask_blend_ps(mask.bits, (__m512)b.v[0], (__m512)a.v[0])}};
}
DECOGS_INLINE I select(M mask, const I& a, const I& b) {
    return {{(NativeI)_mm512_mask_blend_epi32(mask.bits, (__m512i)b.v[0], (__m512i)a.v[0])}};
}
#else
#define DECOGS_COMPARE(op)                              \
    DECOGS_INLINE M operator op(const F& a, const F& b) { \
        M r;                                            \
        DECOGS_EACH r.v[p] = a.v[p] op b.v[p];          \
        return r;                                       \
    }                                                   \
    DECOGS_INLINE M operator op(const I& a, const I& b) { \
        M r;                                            \
        DECOGS_EACH r.v[p] = a.v[p] op b.v[p];          \
        return r;                                       \
    }
DECOGS_COMPARE(<)
DECOGS_COMPARE(<=)
DECOGS_COMPARE(>)
DECOGS_COMPARE(>=)
#undef DECOGS_COMPARE
DECOGS_INLINE M operator&(const M& a, const M& b) {
    M r;
    DECOGS_EACH r.v[p] = a.v[p] & b.v[p];
    return r;
}
DECOGS_INLINE M and_not(const M& a, const M& b) {  // a and not b
    M r;
    DECOGS_EACH r.v[p] = a.v[p] & ~b.v[p];
    return r;
}
DECOGS_INLINE unsigned bits(const M& a) {  // bit i: lane i
    unsigned r = 0;
#if defined(__AVX2__)
    DECOGS_EACH r |= static_cast<unsigned>(_mm256_movemask_ps((__m256)a.v[p])) << (8 * p);
#elif defined(__SSE4_1__)
    DECOGS_EACH r |= static_cast<unsigned>(_mm_movemask_ps((__m128)a.v[p])) << (4 * p);
#elif defined(__wasm_simd128__)
    DECOGS_EACH r |= static_cast<unsigned>(wasm_i32x4_bitmask((v128_t)a.v[p])) << (4 * p);
#else
    DECOGS_EACH for (int i = 0; i < DECOGS_NATIVE; ++i) r |= static_cast<unsigned>(a.v[p][i] & 1) << (DECOGS_NATIVE * p + i);
#endif
    return r;
}
DECOGS_INLINE F select(const M& mask, const F& a, const F& b) {
    F r;
#if defined(__AVX2__)
    DECOGS_EACH r.v[p] = (NativeF)_mm256_blendv_ps((__m256)b.v[p], (__m256)a.v[p], (__m256)mask.v[p]);
#elif defined(__SSE4_1__)
    DECOGS_EACH r.v[p] = (NativeF)_mm_blendv_ps((__m128)b.v[p], (__m128)a.v[p], (__m128)mask.v[p]);
#elif defined(__wasm_simd128__)
    DECOGS_EACH r.v[p] = (NativeF)wasm_v128_bitselect((v128_t)a.v[p], (v128_t)b.v[p], (v128_t)mask.v[p]);
#else
    DECOGS_EACH r.v[p] = mask.v[p] ? a.v[p] : b.v[p];
#endif
    return r;
}
DECOGS_INLINE I select(const M& mask, const I& a, const I& b) {
    I r;
    DECOGS_EACH r.v[p] = (mask.v[p] & a.v[p]) | (~mask.v[p] & b.v[p]);
    return r;
}
#endif
DECOGS_INLINE M operator<(const F& a, float b) { return a < splat(b); }
DECOGS_INLINE M operator<=(const F& a, float b) { return a <= splat(b); }
DECOGS_INLINE M operator>(const F& a, float b) { return a > splat(b); }
DECOGS_INLINE M operator>=(const F& a, float b) { return a >= splat(b); }

DECOGS_INLINE bool any(const M& mask) {
#if defined(__AVX512F__)
    return mask.bits != 0;
#elif defined(__AVX2__)
    return _mm256_movemask_ps((__m256)(mask.v[0] | mask.v[1])) != 0;
#elif defined(__SSE4_1__)
    return _mm_movemask_ps((__m128)(mask.v[0] | mask.v[1] | mask.v[2] | mask.v[3])) != 0;
#elif defined(__wasm_simd128__)
    return wasm_v128_any_true((v128_t)(mask.v[0] | mask.v[1] | mask.v[2] | mask.v[3]));
#else
    return bits(mask) != 0;
#endif
}

DECOGS_INLINE F min(const F& a, const F& b) {  // a < b ? a : b
    F r;
#if defined(__AVX512F__)
    DECOGS_EACH r.v[p] = (NativeF)_mm512_min_ps((__m512)a.v[p], (__m512)b.v[p]);
#elif defined(__AVX2__)
    DECOGS_EACH r.v[p] = (NativeF)_mm256_min_ps((__m256)a.v[p], (__m256)b.v[p]);
#elif defined(__SSE4_1__)
    DECOGS_EACH r.v[p] = (NativeF)_mm_min_ps((__m128)a.v[p], (__m128)b.v[p]);
#elif defined(__wasm_simd128__)
    DECOGS_EACH r.v[p] = (NativeF)wasm_f32x4_pmin((v128_t)b.v[p], (v128_t)a.v[p]);
#else
    r = select(a < b, a, b);
#endif
    return r;
}
DECOGS_INLINE F max(const F& a, const F& b) {  // a > b ? a : b
    F r;
#if defined(__AVX512F__)
    DECOGS_EACH r.v[p] = (NativeF)_mm512_max_ps((__m512)a.v[p], (__m512)b.v[p]);
#elif defined(__AVX2__)
    DECOGS_EACH r.v[p] = (NativeF)_mm256_max_ps((__m256)a.v[p], (__m256)b.v[p]);
#elif defined(__SSE4_1__)
    DECOGS_EACH r.v[p] = (NativeF)_mm_max_ps((__m128)a.v[p], (__m128)b.v[p]);
#elif defined(__wasm_simd128__)
    DECOGS_EACH r.v[p] = (NativeF)wasm_f32x4_pmax((v128_t)b.v[p], (v128_t)a.v[p]);
#else
    r = select(a > b, a, b);
#endif
    return r;
}
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
    DECOGS_EACH r.v[p] = (NativeF)a.v[p];
    return r;
}
DECOGS_INLINE I float_to_bits(const F& a) {
    I r;
    DECOGS_EACH r.v[p] = (NativeI)a.v[p];
    return r;
}
DECOGS_INLINE F sqrt(const F& a) {
    F r;
#if defined(__AVX512F__)
    DECOGS_EACH r.v[p] = (NativeF)_mm512_sqrt_ps((__m512)a.v[p]);
#elif defined(__AVX2__)
    DECOGS_EACH r.v[p] = (NativeF)_mm256_sqrt_ps((__m256)a.v[p]);
#elif defined(__SSE4_1__)
    DECOGS_EACH r.v[p] = (NativeF)_mm_sqrt_ps((__m128)a.v[p]);
#elif defined(__wasm_simd128__)
    DECOGS_EACH r.v[p] = (NativeF)wasm_f32x4_sqrt((v128_t)a.v[p]);
#else
    DECOGS_EACH for (int i = 0; i < DECOGS_NATIVE; ++i) r.v[p][i] = __builtin_sqrtf(a.v[p][i]);
#endif
    return r;
}

// Sums of the sixteen lanes of each of twelve vectors, always in this order: with q[i] = (x[i] + x[8+i]) + (x[4+i] + x[12+i]),
// (q[0] + q[1]) + (q[2] + q[3]).
DECOGS_INLINE void sum_lanes(const F* x, float* to) {
#if defined(__AVX512F__)
    __m512 sums[3];
    for (int k = 0; k < 3; ++k) {
        const __m512 a = (__m512)x[4 * k].v[0], b = (__m512)x[4 * k + 1].v[0];
        const __m512 c = (__m512)x[4 * k + 2].v[0], d = (__m512)x[4 * k + 3].v[0];
        const __m512 ab = _mm512_add_ps(_mm512_shuffle_f32x4(a, b, 0x44), _mm512_shuffle_f32x4(a, b, 0xee));
        const __m512 cd = _mm512_add_ps(_mm512_shuffle_f32x4(c, d, 0x44), _mm512_shuffle_f32x4(c, d, 0xee));
        const __m512 q = _mm512_add_ps(_mm512_shuffle_f32x4(ab, cd, 0x88), _mm512_shuffle_f32x4(ab, cd, 0xdd));
        const __m512 pair = _mm512_add_ps(q, _mm512_permute_ps(q, 0xb1));
        sums[k] = _mm512_add_ps(pair, _mm512_permute_ps(pair, 0x4e));  // each sum four times
    }
    const __m512 mixed = _mm512_mask_blend_ps(0x4444, _mm512_mask_blend_ps(0x2222, sums[0], sums[1]), sums[2]);
    const __m512i order = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 0, 0, 0, 0);
    _mm512_mask_storeu_ps(to, 0x0fff, _mm512_permutexvar_ps(order, mixed));
#elif defined(__SSE4_1__)
    for (int k = 0; k < 3; ++k) {
        __m128 q[4];
        for (int i = 0; i < 4; ++i) {
            __m128 part[4];
            std::memcpy(part, &x[4 * k + i], sizeof part);
            q[i] = _mm_add_ps(_mm_add_ps(part[0], part[2]), _mm_add_ps(part[1], part[3]));
        }
        _MM_TRANSPOSE4_PS(q[0], q[1], q[2], q[3]);
        _mm_storeu_ps(to + 4 * k, _mm_add_ps(_mm_add_ps(q[0], q[1]), _mm_add_ps(q[2], q[3])));
    }
#else
    for (int k = 0; k < 12; ++k) {
        float l[kLanes], q[4];
        store(l, x[k]);
        for (int i = 0; i < 4; ++i) q[i] = (l[i] + l[8 + i]) + (l[4 + i] + l[12 + i]);
        to[k] = (q[0] + q[1]) + (q[2] + q[3]);
    }
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
    const M small = m < 0.707106781186547524f;
    e = select(small, e - splati(1), e);
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
