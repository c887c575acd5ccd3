// The lanes of decoder/rasterise/kernel/simd.h where there is one: a CUDA thread is one. In its place before project.h.
#pragma once

#if defined(__CUDACC_RTC__)  // compiles without any of the standard library
typedef signed int int32_t;
typedef unsigned char uint8_t;
typedef unsigned int uint32_t;
typedef long long int64_t;
typedef unsigned long long uint64_t;
#define DECOGS_INLINE static __device__ __forceinline__
#else
#define DECOGS_INLINE inline __attribute__((always_inline))
#endif

namespace decogs {

constexpr int kLanes = 1;

typedef float F;
typedef int32_t I;
typedef bool M;

DECOGS_INLINE F splat(float x) { return x; }
DECOGS_INLINE F load(const float* a) { return *a; }
DECOGS_INLINE void store(float* a, F x) { *a = x; }
DECOGS_INLINE bool any(M mask) { return mask; }
DECOGS_INLINE F select(M mask, F a, F b) { return mask ? a : b; }
DECOGS_INLINE F min(F a, F b) { return a < b ? a : b; }
DECOGS_INLINE F max(F a, F b) { return a > b ? a : b; }
DECOGS_INLINE F sqrt(F x) { return sqrtf(x); }
DECOGS_INLINE F log(F x) { return logf(x); }
DECOGS_INLINE F exp(F x) { return expf(min(max(x, -87.0f), 88.0f)); }
DECOGS_INLINE F exp2_negative(F t) { return exp2f(-t); }

}  // namespace decogs
