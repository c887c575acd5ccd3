// Backward pass through the projection of Gaussians, a group of lanes at a time; compiled for CUDA, too, with one lane.
#pragma once

#include "project.h"

namespace decogs {

struct Gradients {  // one row per Gaussian
    float* means;
    float* log_scales;
    float* quaternions;
    float* opacity_logits;
    float* sh;
    float* view;  // norm of the gradient of the projected mean, per pixel (densification)
};

// Sums of a pair over its pixels: of g = alpha dL/dalpha with moments of (u, v), and of alpha T times the cotangent. In the
// coordinates (u, v) every ellipse is a circle; pixel offsets would lose the digits of a thin one to cancellation.
constexpr int kMoments = 12;  // g, g u, g v, g u u, g u v, g v v, red, green, blue, depth, 2 unused

// Gradient of the view direction: adds sum_k v[k] d basis[k] / d(x, y, z) to v_dir, with v = dL/dbasis.
DECOGS_INLINE void sh_backward(int degree, const F& x, const F& y, const F& z, const F* v, F* v_dir) {
    F &vx = v_dir[0], &vy = v_dir[1], &vz = v_dir[2];
    if (degree < 1) return;
    vy = vy - v[1] * 0.4886025119029199f;
    vz = vz + v[2] * 0.4886025119029199f;
    vx = vx - v[3] * 0.4886025119029199f;
    if (degree < 2) return;
    vx = vx + v[4] * y * 1.0925484305920792f;
    vy = vy + v[4] * x * 1.0925484305920792f;
    vy = vy - v[5] * z * 1.0925484305920792f;
    vz = vz - v[5] * y * 1.0925484305920792f;
    vx = vx - v[6] * x * (2.0f * 0.31539156525252005f);
    vy = vy - v[6] * y * (2.0f * 0.31539156525252005f);
    vz = vz + v[6] * z * (4.0f * 0.31539156525252005f);
    vx = vx - v[7] * z * 1.0925484305920792f;
    vz = vz - v[7] * x * 1.0925484305920792f;
    vx = vx + v[8] * x * (2.0f * 0.5462742152960396f);
    vy = vy - v[8] * y * (2.0f * 0.5462742152960396f);
    if (degree < 3) return;
    const F xx = x * x, yy = y * y, zz = z * z;
    const F c9 = v[9] * -0.5900435899266435f, c10 = v[10] * 2.890611442640554f, c11 = v[11] * -0.4570457994644658f;
    const F c12 = v[12] * 0.3731763325901154f, c13 = v[13] * -0.4570457994644658f, c14 = v[14] * 1.445305721320277f;
    const F c15 = v[15] * -0.5900435899266435f;
    vx = vx + c9 * x * y * 6.0f + c10 * y * z - c11 * x * y * 2.0f - c12 * x * z * 6.0f;
    vx = vx + c13 * (zz * 4.0f - xx * 3.0f - yy) + c14 * x * z * 2.0f + c15 * (xx - yy) * 3.0f;
    vy = vy + c9 * (xx - yy) * 3.0f + c10 * x * z + c11 * (zz * 4.0f - xx - yy * 3.0f) - c12 * y * z * 6.0f;
    vy = vy - c13 * x * y * 2.0f - c14 * y * z * 2.0f - c15 * x * y * 6.0f;
    vz = vz + c10 * x * y + c11 * y * z * 8.0f + c12 * (zz * 6.0f - xx * 3.0f - yy * 3.0f) + c13 * x * z * 8.0f;
    vz = vz + c14 * (xx - yy);
}

// Gradients of the Gaussians `rows`, the first `used` of them, from what they were `projected` to and their moments.
inline void backward_rows(const Scene& scene, const Camera& cam, const int64_t* rows, int used, const Projected* const* projected,
                          const F* total, const Gradients& out) {
    const int stride = 3 * scene.sh_coefficients;
    const Group g = project_group(scene, cam, rows);
    const F zero = splat(0.0f);
    // The projection of a culled lane may hold NaN or infinity: mask it, although its moments are zero.
    float cuts[kLanes];
    for (int i = 0; i < kLanes; ++i) cuts[i] = projected[i]->cut;
    const M on = load(cuts) > 0.0f;

    // The conic is kFold A^T A with (u, v) = A (dx, dy), A = (p q; 0 r). dL/dcovariance = A^T B A; the term
    // -g/2 of B is the filtered determinant's part in the opacity compensation sqrt(det0 / det).
    const Ellipse a = ellipse_of(g);
    const F v_x2d = a.p * total[1] * kFold, v_y2d = (a.q * total[1] + a.r * total[2]) * kFold;
    const float square = 0.5f * kFold * kFold;
    const F determinant = total[0] * (0.5f * kFold);
    const F b_uu = total[3] * square - determinant, b_uv = total[4] * square, b_vv = total[5] * square - determinant;

    // Covariance = M M^T with M = T R S, T = J W; det0 = |n|^2 with n the cross product of the rows of M.
    const F *m = g.m, *n = g.n;
    const F f = total[0] / g.det0;
    F v_tr[6];
    for (int k = 0; k < 3; ++k) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        const F u = a.p * m[k] + a.q * m[3 + k], v = a.r * m[3 + k];
        const F v_u = (b_uu * u + b_uv * v) * 2.0f, v_v = (b_uv * u + b_vv * v) * 2.0f;
        const F cross0 = f * (m[3 + i] * n[j] - m[3 + j] * n[i]), cross1 = f * (n[i] * m[j] - n[j] * m[i]);
        const F v_log_scale = (v_u * u + v_v * v) + (cross0 * m[k] + cross1 * m[3 + k]);
        scatter(out.log_scales, rows, used, 3, k, select(on, v_log_scale, zero));
        v_tr[k] = (a.p * v_u + cross0) * g.scale[k];
        v_tr[3 + k] = (a.q * v_u + a.r * v_v + cross1) * g.scale[k];
    }
    F v_rot[9], v_t[6];
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k) v_rot[3 * i + k] = g.t[i] * v_tr[k] + g.t[3 + i] * v_tr[3 + k];
    for (int i = 0; i < 2; ++i)
        for (int k = 0; k < 3; ++k)
            v_t[3 * i + k] = v_tr[3 * i] * g.rot[3 * k] + v_tr[3 * i + 1] * g.rot[3 * k + 1] + v_tr[3 * i + 2] * g.rot[3 * k + 2];

    // Rotation matrix -> unit quaternion -> stored quaternion.
    const F &qw = g.unit[0], &qx = g.unit[1], &qy = g.unit[2], &qz = g.unit[3];
    const F* r = v_rot;
    F v_q[4];
    v_q[0] = (qx * (r[7] - r[5]) + qy * (r[2] - r[6]) + qz * (r[3] - r[1])) * 2.0f;
    v_q[1] = (qy * (r[1] + r[3]) + qz * (r[2] + r[6]) + qw * (r[7] - r[5])) * 2.0f - qx * (r[4] + r[8]) * 4.0f;
    v_q[2] = (qx * (r[1] + r[3]) + qz * (r[5] + r[7]) + qw * (r[2] - r[6])) * 2.0f - qy * (r[0] + r[8]) * 4.0f;
    v_q[3] = (qx * (r[2] + r[6]) + qy * (r[5] + r[7]) + qw * (r[3] - r[1])) * 2.0f - qz * (r[0] + r[4]) * 4.0f;
    const F along = v_q[0] * qw + v_q[1] * qx + v_q[2] * qy + v_q[3] * qz;
    const M turned = (g.norm > 1e-18f) & on;
    for (int k = 0; k < 4; ++k)
        scatter(out.quaternions, rows, used, 4, k, select(turned, (v_q[k] - along * g.unit[k]) / g.norm, zero));

    // Mean: through the Jacobian J and through the projected mean.
    const float* w = cam.rotation;
    F v_j[4];  // j00, j02, j11, j12
    v_j[0] = v_t[0] * w[0] + v_t[1] * w[1] + v_t[2] * w[2];
    v_j[1] = v_t[0] * w[6] + v_t[1] * w[7] + v_t[2] * w[8];
    v_j[2] = v_t[3] * w[3] + v_t[4] * w[4] + v_t[5] * w[5];
    v_j[3] = v_t[3] * w[6] + v_t[4] * w[7] + v_t[5] * w[8];
    const F iz = 1.0f / g.z, fx_z = iz * cam.fx, fy_z = iz * cam.fy, ray_x = g.x * iz, ray_y = g.y * iz;
    const F v_kx = select(g.free_x, -(fx_z * v_j[1]), zero), v_ky = select(g.free_y, -(fy_z * v_j[3]), zero);
    const F v_ray_x = v_x2d * cam.fx + v_kx, v_ray_y = v_y2d * cam.fy + v_ky;
    F v_cam[3];
    v_cam[0] = v_ray_x * iz;
    v_cam[1] = v_ray_y * iz;
    v_cam[2] = total[9] - (v_ray_x * ray_x + v_ray_y * ray_y) * iz -
               (fx_z * (v_j[0] - g.kx * v_j[1]) + fy_z * (v_j[2] - g.ky * v_j[3])) * iz;
    F v_mean[3];
    for (int k = 0; k < 3; ++k) v_mean[k] = v_cam[0] * w[k] + v_cam[1] * w[3 + k] + v_cam[2] * w[6 + k];

    // Colour: SH coefficients, and the mean through the view direction.
    F direction[3] = {splat(0.5f), splat(0.5f), splat(0.5f)}, length = splat(1.0f), basis[16];
    if (scene.sh_degree > 0) length = view_directions(scene, cam, rows, direction);
    for (F& d : direction) d = select(on, d, splat(0.5f));
    sh_basis(scene.sh_degree, direction[0], direction[1], direction[2], basis);
    const int coefficients = (scene.sh_degree + 1) * (scene.sh_degree + 1);
    F v_basis[16];
    for (int k = 0; k < coefficients; ++k) v_basis[k] = zero;
    F sh[48], v_sh[48];
    if (scene.sh_degree > 0) load_columns(scene.sh, rows, stride, 3 * coefficients, sh);
    for (int k = coefficients; k < scene.sh_coefficients; ++k)
        for (int c = 0; c < 3; ++c) v_sh[3 * k + c] = zero;
    for (int c = 0; c < 3; ++c) {
        float shown[kLanes];
        for (int i = 0; i < kLanes; ++i) shown[i] = projected[i]->rgb[c];
        const F v_rgb = select((load(shown) > 0.0f) & on, total[6 + c], zero);
        for (int k = 0; k < coefficients; ++k) {
            v_sh[3 * k + c] = v_rgb * basis[k];
            if (scene.sh_degree > 0) v_basis[k] = v_basis[k] + v_rgb * sh[3 * k + c];
        }
    }
    store_columns(out.sh, rows, used, stride, stride, v_sh);
    if (scene.sh_degree > 0) {
        F v_dir[3] = {zero, zero, zero};
        sh_backward(scene.sh_degree, direction[0], direction[1], direction[2], v_basis, v_dir);
        const F radial = v_dir[0] * direction[0] + v_dir[1] * direction[1] + v_dir[2] * direction[2];
        for (int k = 0; k < 3; ++k) v_mean[k] = v_mean[k] + (v_dir[k] - radial * direction[k]) / length;
    }
    for (int k = 0; k < 3; ++k) scatter(out.means, rows, used, 3, k, select(on, v_mean[k], zero));
    scatter(out.opacity_logits, rows, used, 1, 0, select(on, total[0] * (1.0f - g.sigmoid), zero));
    if (out.view) scatter(out.view, rows, used, 1, 0, select(on, sqrt(v_x2d * v_x2d + v_y2d * v_y2d), zero));
}

}  // namespace decogs
