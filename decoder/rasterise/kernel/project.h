// Projection of Gaussians, sixteen at a time: EWA splatting, Sigma' = J W Sigma W^T J^T (Zwicker 2001; Kerbl 2023, equation
// 5), with the opacity compensation of the 2D low-pass filter (Yu 2024, Mip-Splatting, equation 9).
#pragma once

#include <algorithm>
#include <cmath>

#include "simd.h"

namespace decogs {

constexpr float kBlur = 0.3f;               // low-pass filter, variance in square pixels
constexpr float kAlphaMin = 1.0f / 255.0f;  // contributions below this alpha are skipped
constexpr float kAlphaMax = 0.99f;
constexpr float kTransmittanceMin = 1e-4f;  // a pixel ends before its transmittance falls below this
constexpr float kClosest = 0.5f;            // a Gaussian is culled if nearer than this multiple of its largest sigma
constexpr float kLog2E = 1.44269504088896341f;
constexpr int kTile = 16;

struct Camera {  // mirrored by ctypes in native.py
    float rotation[9];
    float translation[3];
    float centre[3];
    float origin[3];  // subtracted from positions first; translation and centre are relative to it
    float fx, fy, cx, cy, near;
    int32_t width, height;
};

struct Scene {  // mirrored by ctypes in native.py
    int64_t count;
    int32_t sh_coefficients;  // stored per channel
    int32_t sh_degree;        // evaluated; at most the stored one
    const float* means;
    const float* log_scales;
    const float* quaternions;
    const float* opacity_logits;
    const float* sh;
};

// A projected Gaussian: alpha = opacity 2^-exponent with exponent(dx, dy) = (p dx + q dy)^2 + (r dy)^2, the Cholesky form of
// the conic. As a sum of squares it suffers no cancellation, however thin the ellipse is.
struct alignas(64) Projected {
    float x, y, p, q, r;
    float opacity;
    float cut;  // exponent at which alpha falls to kAlphaMin; culled when <= 0
    float depth;
    float rgb[3];
    float extent_x, extent_y;  // half extents of the ellipse's bounding box, pixels
    float pad[3];
};
static_assert(sizeof(Projected) == 64, "one cache line each");

DECOGS_INLINE void scatter(float* array, const int64_t* rows, int rows_used, int stride, int column, const F& value) {
    float lanes[kLanes];
    store(lanes, value);
    for (int i = 0; i < rows_used; ++i) array[rows[i] * stride + column] = lanes[i];
}

DECOGS_INLINE F gather(const float* array, const int64_t* rows, int stride, int column) {
    float lanes[kLanes];
    for (int i = 0; i < kLanes; ++i) lanes[i] = array[rows[i] * stride + column];
    return load(lanes);
}

// Transposes sixteen rows of an array to `count` columns, one lane per row, and back, in 4x4 parts: a load of four values
// costs as much as a load of one.
inline void load_columns(const float* array, const int64_t* rows, int stride, int count, F* columns) {
    int k = 0;
#if defined(__SSE4_1__)
    for (; k + 4 <= count; k += 4)
        for (int i = 0; i < kLanes; i += 4) {
            __m128 part[4];
            for (int j = 0; j < 4; ++j) part[j] = _mm_loadu_ps(array + rows[i + j] * stride + k);
            _MM_TRANSPOSE4_PS(part[0], part[1], part[2], part[3]);
            for (int j = 0; j < 4; ++j) _mm_storeu_ps(reinterpret_cast<float*>(&columns[k + j]) + i, part[j]);
        }
#endif
    for (; k < count; ++k) columns[k] = gather(array, rows, stride, k);
}
inline void store_columns(float* array, const int64_t* rows, int rows_used, int stride, int count, const F* columns) {
    int k = 0;
#if defined(__SSE4_1__)
    for (; k + 4 <= count; k += 4)
        for (int i = 0; i < rows_used; i += 4) {
            __m128 part[4];
            for (int j = 0; j < 4; ++j) part[j] = _mm_loadu_ps(reinterpret_cast<const float*>(&columns[k + j]) + i);
            _MM_TRANSPOSE4_PS(part[0], part[1], part[2], part[3]);
            if (i + 4 <= rows_used)
                for (int j = 0; j < 4; ++j) _mm_storeu_ps(array + rows[i + j] * stride + k, part[j]);
            else
                for (int j = 0; j < rows_used - i; ++j) _mm_storeu_ps(array + rows[i + j] * stride + k, part[j]);
        }
#endif
    for (; k < count; ++k) scatter(array, rows, rows_used, stride, k, columns[k]);
}

// Spherical-harmonics basis of unit directions, in 3DGS's order of coefficients.
DECOGS_INLINE void sh_basis(int degree, const F& x, const F& y, const F& z, F* basis) {
    basis[0] = splat(0.28209479177387814f);
    if (degree < 1) return;
    basis[1] = y * -0.4886025119029199f;
    basis[2] = z * 0.4886025119029199f;
    basis[3] = x * -0.4886025119029199f;
    if (degree < 2) return;
    const F xx = x * x, yy = y * y, zz = z * z;
    basis[4] = x * y * 1.0925484305920792f;
    basis[5] = y * z * -1.0925484305920792f;
    basis[6] = (zz + zz - xx - yy) * 0.31539156525252005f;
    basis[7] = x * z * -1.0925484305920792f;
    basis[8] = (xx - yy) * 0.5462742152960396f;
    if (degree < 3) return;
    basis[9] = y * (xx * 3.0f - yy) * -0.5900435899266435f;
    basis[10] = x * y * z * 2.890611442640554f;
    basis[11] = y * (zz * 4.0f - xx - yy) * -0.4570457994644658f;
    basis[12] = z * (zz * 2.0f - xx * 3.0f - yy * 3.0f) * 0.3731763325901154f;
    basis[13] = x * (zz * 4.0f - xx - yy) * -0.4570457994644658f;
    basis[14] = z * (xx - yy) * 1.445305721320277f;
    basis[15] = x * (xx - yy * 3.0f) * -0.5900435899266435f;
}

// Intermediate values of the projection of sixteen Gaussians; the backward pass reads them again.
struct Group {
    F x, y, z;           // camera coordinates
    F kx, ky;            // x/z and y/z clamped to a widened field of view, as EWA needs
    M free_x, free_y;    // where the clamp is inactive
    F rot[9];            // rotation of the unit quaternion
    F unit[4], norm;     // unit quaternion, and the norm of the stored one
    F scale[3];
    F t[6];              // J W, 2x3
    F tr[6];             // J W R, 2x3
    F m[6];              // J W R S, 2x3
    F n[3];              // cross product of its rows
    F a0, b0, c0, det0;  // 2D covariance (a b; b c) and its determinant before the low-pass filter
    F a, c, det;         // and after it (b is unchanged)
    F sigmoid, compensation;
    F mean2d_x, mean2d_y;
};

DECOGS_INLINE Group project_group(const Scene& scene, const Camera& cam, const int64_t* rows) {
    Group g;
    const F mx = gather(scene.means, rows, 3, 0) - cam.origin[0], my = gather(scene.means, rows, 3, 1) - cam.origin[1],
            mz = gather(scene.means, rows, 3, 2) - cam.origin[2];
    const float* w = cam.rotation;
    g.x = mx * w[0] + my * w[1] + mz * w[2] + cam.translation[0];
    g.y = mx * w[3] + my * w[4] + mz * w[5] + cam.translation[1];
    g.z = mx * w[6] + my * w[7] + mz * w[8] + cam.translation[2];
    const F inverse_z = 1.0f / g.z;

    for (int k = 0; k < 3; ++k) g.scale[k] = exp(gather(scene.log_scales, rows, 3, k));
    F q[4];
    for (int k = 0; k < 4; ++k) q[k] = gather(scene.quaternions, rows, 4, k);
    F square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3], enlarged = splat(1.0f);
    const M huge = square > 1e36f;  // the squared norm overflows, or nearly
    if (any(huge)) {
        for (int k = 0; k < 4; ++k) q[k] = select(huge, q[k] * 0x1p-66f, q[k]);
        square = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
        enlarged = select(huge, splat(0x1p66f), enlarged);
    }
    const F length = sqrt(square);
    g.norm = length * enlarged;
    const M turned = length > 1e-18f;  // a zero quaternion is the identity
    for (int k = 0; k < 4; ++k) g.unit[k] = select(turned, q[k] / length, splat(k == 0 ? 1.0f : 0.0f));
    const F &qw = g.unit[0], &qx = g.unit[1], &qy = g.unit[2], &qz = g.unit[3];
    g.rot[0] = 1.0f - (qy * qy + qz * qz) * 2.0f;
    g.rot[1] = (qx * qy - qw * qz) * 2.0f;
    g.rot[2] = (qx * qz + qw * qy) * 2.0f;
    g.rot[3] = (qx * qy + qw * qz) * 2.0f;
    g.rot[4] = 1.0f - (qx * qx + qz * qz) * 2.0f;
    g.rot[5] = (qy * qz - qw * qx) * 2.0f;
    g.rot[6] = (qx * qz - qw * qy) * 2.0f;
    g.rot[7] = (qy * qz + qw * qx) * 2.0f;
    g.rot[8] = 1.0f - (qx * qx + qy * qy) * 2.0f;

    // The Jacobian diverges far outside the picture: clamp the ray to 15 % of the picture's size around it, as 3DGS does.
    const float low_x = (-0.15f * cam.width - cam.cx) / cam.fx, high_x = (1.15f * cam.width - cam.cx) / cam.fx;
    const float low_y = (-0.15f * cam.height - cam.cy) / cam.fy, high_y = (1.15f * cam.height - cam.cy) / cam.fy;
    const F ray_x = g.x * inverse_z, ray_y = g.y * inverse_z;
    g.free_x = (ray_x > low_x) & (ray_x < high_x);
    g.free_y = (ray_y > low_y) & (ray_y < high_y);
    g.kx = min(max(ray_x, low_x), high_x);
    g.ky = min(max(ray_y, low_y), high_y);
    const F j00 = inverse_z * cam.fx, j11 = inverse_z * cam.fy;
    const F j02 = -(j00 * g.kx), j12 = -(j11 * g.ky);
    for (int k = 0; k < 3; ++k) {
        g.t[k] = j00 * w[k] + j02 * w[6 + k];
        g.t[3 + k] = j11 * w[3 + k] + j12 * w[6 + k];
    }
    for (int i = 0; i < 2; ++i)
        for (int k = 0; k < 3; ++k) {
            g.tr[3 * i + k] = g.t[3 * i] * g.rot[k] + g.t[3 * i + 1] * g.rot[3 + k] + g.t[3 * i + 2] * g.rot[6 + k];
            g.m[3 * i + k] = g.tr[3 * i + k] * g.scale[k];
        }
    const F* m = g.m;
    g.a0 = m[0] * m[0] + m[1] * m[1] + m[2] * m[2];
    g.b0 = m[0] * m[3] + m[1] * m[4] + m[2] * m[5];
    g.c0 = m[3] * m[3] + m[4] * m[4] + m[5] * m[5];
    // Lagrange's identity: |m0|^2 |m1|^2 - (m0 . m1)^2 = |m0 x m1|^2, without the cancellation of a c - b^2 for thin ellipses.
    g.n[0] = m[1] * m[5] - m[2] * m[4];
    g.n[1] = m[2] * m[3] - m[0] * m[5];
    g.n[2] = m[0] * m[4] - m[1] * m[3];
    g.det0 = g.n[0] * g.n[0] + g.n[1] * g.n[1] + g.n[2] * g.n[2];
    g.a = g.a0 + kBlur;
    g.c = g.c0 + kBlur;
    g.det = g.det0 + (g.a0 + g.c0) * kBlur + kBlur * kBlur;
    g.compensation = sqrt(g.det0 / g.det);
    g.sigmoid = 1.0f / (exp(-gather(scene.opacity_logits, rows, 1, 0)) + 1.0f);
    g.mean2d_x = ray_x * cam.fx + cam.cx;
    g.mean2d_y = ray_y * cam.fy + cam.cy;
    return g;
}

constexpr float kFold = 1.38629436111989062f;  // 2 ln 2: 2^-(u^2 + v^2) = exp(-kFold / 2 (u^2 + v^2))

// Cholesky factor of the conic: u = p dx + q dy, v = r dy.
struct Ellipse {
    F p, q, r;
};

DECOGS_INLINE Ellipse ellipse_of(const Group& g) {
    const F half_in_bits = splat(0.5f * kLog2E);
    Ellipse e;
    e.p = sqrt(half_in_bits * g.c / g.det);
    e.q = -(g.b0 / g.det) * half_in_bits / e.p;
    e.r = sqrt(half_in_bits / g.c);
    return e;
}

// Unit view directions from the camera to the means; returns the distances.
DECOGS_INLINE F view_directions(const Scene& scene, const Camera& cam, const int64_t* rows, F* direction) {
    for (int k = 0; k < 3; ++k) direction[k] = (gather(scene.means, rows, 3, k) - cam.origin[k]) - cam.centre[k];
    const F length = sqrt(direction[0] * direction[0] + direction[1] * direction[1] + direction[2] * direction[2]);
    for (int k = 0; k < 3; ++k) direction[k] = direction[k] / length;
    return length;
}

// Projects the Gaussians rows[0..16) to out[0..16).
inline void project_rows(const Scene& scene, const Camera& cam, const int64_t* rows, Projected* out) {
    const Group g = project_group(scene, cam, rows);
    const F opacity = g.sigmoid * g.compensation;
    const F largest = max(max(g.scale[0], g.scale[1]), g.scale[2]);
    const F cut = log(max(opacity * 255.0f, 1e-30f));
    const F reach = max(cut, 0.0f) * 2.0f;
    const F extent_x = sqrt(reach * g.a), extent_y = sqrt(reach * g.c);
    // Every comparison is false for NaN, so that such a Gaussian is culled.
    const M drawn = (g.z > 0.0f) & (g.z >= cam.near) & (g.z >= largest * kClosest) & (cut > 0.0f) & (g.mean2d_x + extent_x > 0.0f) &
                    (g.mean2d_x - extent_x < static_cast<float>(cam.width)) & (g.mean2d_y + extent_y > 0.0f) &
                    (g.mean2d_y - extent_y < static_cast<float>(cam.height)) & (g.det > 0.0f) & (extent_x < 1e9f) &
                    (extent_y < 1e9f);
    if (!any(drawn)) {
        for (int i = 0; i < kLanes; ++i) out[i].cut = 0.0f;
        return;
    }
    const Ellipse e = ellipse_of(g);
    const F half = splat(0.5f);

    F rgb[3] = {half, half, half};
    const int stride = 3 * scene.sh_coefficients, used = (scene.sh_degree + 1) * (scene.sh_degree + 1);
    F basis[16];
    F direction[3] = {half, half, half};
    if (scene.sh_degree > 0) view_directions(scene, cam, rows, direction);
    sh_basis(scene.sh_degree, direction[0], direction[1], direction[2], basis);
    F sh[48];
    load_columns(scene.sh, rows, stride, 3 * used, sh);
    for (int k = 0; k < used; ++k)
        for (int c = 0; c < 3; ++c) rgb[c] = rgb[c] + basis[k] * sh[3 * k + c];

    float lanes[13][kLanes];
    const F zero = splat(0.0f);
    const F columns[13] = {g.mean2d_x,       g.mean2d_y,       e.p, e.q, e.r, opacity, select(drawn, cut * kLog2E, zero), g.z, max(rgb[0], 0.0f),
                           max(rgb[1], 0.0f), max(rgb[2], 0.0f), extent_x, extent_y};
    for (int k = 0; k < 13; ++k) store(lanes[k], columns[k]);
    for (int i = 0; i < kLanes; ++i) {
        float* to = &out[i].x;
        for (int k = 0; k < 13; ++k) to[k] = lanes[k][i];
    }
}

}  // namespace decogs
