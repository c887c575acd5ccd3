// Applies the MLP's outputs to Gaussians, sixteen at a time, and its backward pass: mu' = mu + scale * shift,
// q' = normalise(q) (x) normalise(turn) (DecoGS stage 1; 3DGStream, equation 5). Quaternions wxyz.
#pragma once

#include "simd.h"

namespace decogs {

constexpr float kTiny = 1e-30f;  // a quaternion with a smaller norm is the identity

struct Quaternions {
    F c[4];
};

DECOGS_INLINE Quaternions conjugate(const Quaternions& q) { return {{q.c[0], -q.c[1], -q.c[2], -q.c[3]}}; }

DECOGS_INLINE Quaternions multiply(const Quaternions& a, const Quaternions& b) {  // Hamilton product
    const F *p = a.c, *q = b.c;
    return {{
        p[0] * q[0] - p[1] * q[1] - p[2] * q[2] - p[3] * q[3],
        p[0] * q[1] + p[1] * q[0] + p[2] * q[3] - p[3] * q[2],
        p[0] * q[2] - p[1] * q[3] + p[2] * q[0] + p[3] * q[1],
        p[0] * q[3] + p[1] * q[2] - p[2] * q[1] + p[3] * q[0],
    }};
}

DECOGS_INLINE F dot(const Quaternions& a, const Quaternions& b) {
    return a.c[0] * b.c[0] + a.c[1] * b.c[1] + a.c[2] * b.c[2] + a.c[3] * b.c[3];
}

// Unit quaternions and their former norms, without overflow or division by zero; (nearly) zero ones become the identity.
DECOGS_INLINE Quaternions normalise(const Quaternions& q, F& norm) {
    F size = splat(kTiny);
    for (const F& c : q.c) size = max(size, max(c, -c));
    Quaternions unit{{q.c[0] / size, q.c[1] / size, q.c[2] / size, q.c[3] / size}};
    const F length = sqrt(dot(unit, unit));
    norm = length * size;
    const M usable = norm > kTiny;
    for (int k = 0; k < 4; ++k) unit.c[k] = select(usable, unit.c[k] / max(length, kTiny), splat(k == 0 ? 1.0f : 0.0f));
    return unit;
}

// Cotangents of quaternions from those of their unit quaternions: (v - u (u . v)) / norm; zero where not usable.
DECOGS_INLINE Quaternions through_norm(const Quaternions& unit, const F& norm, const M& usable, const Quaternions& v) {
    const F along = dot(unit, v);
    Quaternions r;
    for (int k = 0; k < 4; ++k) r.c[k] = select(usable, (v.c[k] - unit.c[k] * along) / norm, splat(0.0f));
    return r;
}

}  // namespace decogs
