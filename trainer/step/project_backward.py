"""Gradients of the projection: from 2D Gaussians back to the parameters of the 3D Gaussians."""

from __future__ import annotations

import numpy as np

from codec.kernel import kernel, prange
from codec.splats import SH_C0
from player.render.project import (
    BLUE,
    CAM_FX,
    CAM_FY,
    CAM_LIMIT_X,
    CAM_LIMIT_Y,
    CAM_POSITION,
    CAM_TRANSLATION,
    CONIC_A,
    CONIC_B,
    CONIC_C,
    GREEN,
    RED,
    camera_rotation,
    rotation_of,
)
from player.render.recipe import SH_C1

from .blend_backward import (
    G_BLUE,
    G_CONIC_A,
    G_CONIC_B,
    G_CONIC_C,
    G_GREEN,
    G_LOGIT,
    G_RED,
    G_X,
    G_Y,
)


@kernel(fastmath=True, parallel=True)
def project_backward_kernel(  # type: ignore[no-untyped-def]
    means, log_scales, quats, logit_opacities, sh, rows, trained, camera,
    projected, pair_starts, pair_grads, opacity_reg, scale_reg,
    g_means, g_log_scales, g_quats, g_logits, g_sh,
):  # fmt: skip
    """Writes the gradients of the Gaussians `trained` into their rows of the g_ arrays.

    rows (M,) int32: what was projected; trained (T,) int32: places in it, the others are frozen.
    opacity_reg, scale_reg: the regularisers' weights, already divided by what their means run over;
    they reach rows that no pixel shows, too.
    """
    half, one, two = np.float32(0.5), np.float32(1), np.float32(2)
    zero = np.float32(0)
    c0, c1 = np.float32(SH_C0), np.float32(SH_C1)
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = camera_rotation(camera)
    linear = sh.shape[1] >= 4
    for k in prange(trained.shape[0]):
        i = trained[k]
        row = rows[i]
        opacity = one / (one + np.exp(-logit_opacities[row]))
        s0, s1, s2 = (
            np.exp(log_scales[row, 0]),
            np.exp(log_scales[row, 1]),
            np.exp(log_scales[row, 2]),
        )
        g_logits[row] = opacity_reg * opacity * (one - opacity)
        g_log_scales[row, 0] = scale_reg * s0
        g_log_scales[row, 1] = scale_reg * s1
        g_log_scales[row, 2] = scale_reg * s2
        for j in range(3):
            g_means[row, j] = zero
        for j in range(4):
            g_quats[row, j] = zero
        for j in range(sh.shape[1]):
            g_sh[row, j, 0] = zero
            g_sh[row, j, 1] = zero
            g_sh[row, j, 2] = zero
        if pair_starts[i] == pair_starts[i + 1]:
            continue
        gx, gy, ga, gb, gc, g_logit = zero, zero, zero, zero, zero, zero
        g_red, g_green, g_blue = zero, zero, zero
        for pair in range(pair_starts[i], pair_starts[i + 1]):
            gx += pair_grads[pair, G_X]
            gy += pair_grads[pair, G_Y]
            ga += pair_grads[pair, G_CONIC_A]
            gb += pair_grads[pair, G_CONIC_B]
            gc += pair_grads[pair, G_CONIC_C]
            g_logit += pair_grads[pair, G_LOGIT]
            g_red += pair_grads[pair, G_RED]
            g_green += pair_grads[pair, G_GREEN]
            g_blue += pair_grads[pair, G_BLUE]
        g_logits[row] += g_logit
        # The forward pass once more, up to the covariance's two factors.
        mx, my, mz = means[row, 0], means[row, 1], means[row, 2]
        x = r00 * mx + r01 * my + r02 * mz + camera[CAM_TRANSLATION]
        y = r10 * mx + r11 * my + r12 * mz + camera[CAM_TRANSLATION + 1]
        z = r20 * mx + r21 * my + r22 * mz + camera[CAM_TRANSLATION + 2]
        fx, fy = camera[CAM_FX], camera[CAM_FY]
        limit_x, limit_y = camera[CAM_LIMIT_X], camera[CAM_LIMIT_Y]
        inv_z = one / z
        u, v = x * inv_z, y * inv_z
        tx, ty = min(max(u, -limit_x), limit_x), min(max(v, -limit_y), limit_y)
        jx, jy = fx * inv_z, fy * inv_z
        d0, d1, d2 = r00 - tx * r20, r01 - tx * r21, r02 - tx * r22
        e0, e1, e2 = r10 - ty * r20, r11 - ty * r21, r12 - ty * r22
        a0, a1, a2 = jx * d0, jx * d1, jx * d2
        b0, b1, b2 = jy * e0, jy * e1, jy * e2
        qw, qx, qy, qz = quats[row, 0], quats[row, 1], quats[row, 2], quats[row, 3]
        norm = one / np.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
        qw, qx, qy, qz = qw * norm, qx * norm, qy * norm, qz * norm
        g00, g01, g02, g10, g11, g12, g20, g21, g22 = rotation_of(qw, qx, qy, qz)
        va0 = (a0 * g00 + a1 * g10 + a2 * g20) * s0
        va1 = (a0 * g01 + a1 * g11 + a2 * g21) * s1
        va2 = (a0 * g02 + a1 * g12 + a2 * g22) * s2
        vb0 = (b0 * g00 + b1 * g10 + b2 * g20) * s0
        vb1 = (b0 * g01 + b1 * g11 + b2 * g21) * s1
        vb2 = (b0 * g02 + b1 * g12 + b2 * g22) * s2
        # conic = inverse(covariance): d covariance = -conic G conic
        ca, cb, cc = projected[i, CONIC_A], projected[i, CONIC_B], projected[i, CONIC_C]
        gb = half * gb
        m00, m01 = ga * ca + gb * cb, ga * cb + gb * cc
        m10, m11 = gb * ca + gc * cb, gb * cb + gc * cc
        d_cov_a = -(ca * m00 + cb * m10)
        d_cov_b = -two * (ca * m01 + cb * m11)
        d_cov_c = -(cb * m01 + cc * m11)
        dva0 = two * d_cov_a * va0 + d_cov_b * vb0
        dva1 = two * d_cov_a * va1 + d_cov_b * vb1
        dva2 = two * d_cov_a * va2 + d_cov_b * vb2
        dvb0 = two * d_cov_c * vb0 + d_cov_b * va0
        dvb1 = two * d_cov_c * vb1 + d_cov_b * va1
        dvb2 = two * d_cov_c * vb2 + d_cov_b * va2
        g_log_scales[row, 0] += dva0 * va0 + dvb0 * vb0
        g_log_scales[row, 1] += dva1 * va1 + dvb1 * vb1
        g_log_scales[row, 2] += dva2 * va2 + dvb2 * vb2
        dva0, dva1, dva2 = dva0 * s0, dva1 * s1, dva2 * s2
        dvb0, dvb1, dvb2 = dvb0 * s0, dvb1 * s1, dvb2 * s2
        # the rotation's nine entries, then its quaternion
        n00, n01, n02 = dva0 * a0 + dvb0 * b0, dva1 * a0 + dvb1 * b0, dva2 * a0 + dvb2 * b0
        n10, n11, n12 = dva0 * a1 + dvb0 * b1, dva1 * a1 + dvb1 * b1, dva2 * a1 + dvb2 * b1
        n20, n21, n22 = dva0 * a2 + dvb0 * b2, dva1 * a2 + dvb1 * b2, dva2 * a2 + dvb2 * b2
        dw = two * (qz * (n10 - n01) + qy * (n02 - n20) + qx * (n21 - n12))
        dx = two * (qy * (n01 + n10) + qz * (n02 + n20) + qw * (n21 - n12) - two * qx * (n11 + n22))
        dy = two * (qx * (n01 + n10) + qz * (n12 + n21) + qw * (n02 - n20) - two * qy * (n00 + n22))
        dz = two * (qx * (n02 + n20) + qy * (n12 + n21) + qw * (n10 - n01) - two * qz * (n00 + n11))
        radial = dw * qw + dx * qx + dy * qy + dz * qz
        g_quats[row, 0] = (dw - qw * radial) * norm
        g_quats[row, 1] = (dx - qx * radial) * norm
        g_quats[row, 2] = (dy - qy * radial) * norm
        g_quats[row, 3] = (dz - qz * radial) * norm
        # the Jacobian, then the centre in the camera
        da0 = dva0 * g00 + dva1 * g01 + dva2 * g02
        da1 = dva0 * g10 + dva1 * g11 + dva2 * g12
        da2 = dva0 * g20 + dva1 * g21 + dva2 * g22
        db0 = dvb0 * g00 + dvb1 * g01 + dvb2 * g02
        db1 = dvb0 * g10 + dvb1 * g11 + dvb2 * g12
        db2 = dvb0 * g20 + dvb1 * g21 + dvb2 * g22
        d_u, d_v = fx * gx, fy * gy
        if tx == u:
            d_u -= jx * (da0 * r20 + da1 * r21 + da2 * r22)
        if ty == v:
            d_v -= jy * (db0 * r20 + db1 * r21 + db2 * r22)
        d_z = -(d_u * u + d_v * v) * inv_z
        d_z -= (
            (da0 * d0 + da1 * d1 + da2 * d2) * jx + (db0 * e0 + db1 * e1 + db2 * e2) * jy
        ) * inv_z
        d_x, d_y = d_u * inv_z, d_v * inv_z
        dmx = r00 * d_x + r10 * d_y + r20 * d_z
        dmy = r01 * d_x + r11 * d_y + r21 * d_z
        dmz = r02 * d_x + r12 * d_y + r22 * d_z
        # colour; a channel cut at zero has no gradient
        g_red = g_red if projected[i, RED] > zero else zero
        g_green = g_green if projected[i, GREEN] > zero else zero
        g_blue = g_blue if projected[i, BLUE] > zero else zero
        g_sh[row, 0, 0] = c0 * g_red
        g_sh[row, 0, 1] = c0 * g_green
        g_sh[row, 0, 2] = c0 * g_blue
        if linear:
            ox, oy, oz = (
                mx - camera[CAM_POSITION],
                my - camera[CAM_POSITION + 1],
                mz - camera[CAM_POSITION + 2],
            )
            inv = one / np.sqrt(ox * ox + oy * oy + oz * oz)
            ox, oy, oz = ox * inv, oy * inv, oz * inv
            g_sh[row, 1, 0] = -c1 * oy * g_red
            g_sh[row, 1, 1] = -c1 * oy * g_green
            g_sh[row, 1, 2] = -c1 * oy * g_blue
            g_sh[row, 2, 0] = c1 * oz * g_red
            g_sh[row, 2, 1] = c1 * oz * g_green
            g_sh[row, 2, 2] = c1 * oz * g_blue
            g_sh[row, 3, 0] = -c1 * ox * g_red
            g_sh[row, 3, 1] = -c1 * ox * g_green
            g_sh[row, 3, 2] = -c1 * ox * g_blue
            dox = -c1 * (sh[row, 3, 0] * g_red + sh[row, 3, 1] * g_green + sh[row, 3, 2] * g_blue)
            doy = -c1 * (sh[row, 1, 0] * g_red + sh[row, 1, 1] * g_green + sh[row, 1, 2] * g_blue)
            doz = c1 * (sh[row, 2, 0] * g_red + sh[row, 2, 1] * g_green + sh[row, 2, 2] * g_blue)
            radial = dox * ox + doy * oy + doz * oz
            dmx += (dox - ox * radial) * inv
            dmy += (doy - oy * radial) * inv
            dmz += (doz - oz * radial) * inv
        g_means[row, 0] = dmx
        g_means[row, 1] = dmy
        g_means[row, 2] = dmz
