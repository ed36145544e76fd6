"""The backward pass on the CPU: from the picture's gradient to the Gaussians' parameters, through
blending, projection and harmonics.

The forward pass is repeated front to back, so nothing per pixel has to be kept from it. With d the
gradient of the loss for a pixel's colour, what lies behind a Gaussian enters through one number per
pixel, the remaining sum of weight * (colour . d), which starts at picture . d and shrinks on the
way.
"""

from __future__ import annotations

import numpy as np

from codec.kernel import kernel, prange
from codec.splats import SH_C0
from player.render.blend import blend_pixel, from_centre, rows_hit, tile_corner, unclamped_alpha
from player.render.project import (
    ALPHA_MAX,
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
    OPACITY,
    Q_MAX,
    RED,
    SH_C1,
    SH_C2,
    SH_C3,
    TILE_PX,
    X,
    Y,
    camera_rotation,
    higher_harmonics,
    rotation_of,
)

# Columns of a pair's gradient, named after what it is for.
G_X, G_Y, G_CONIC_A, G_CONIC_B, G_CONIC_C, G_LOGIT, G_RED, G_GREEN, G_BLUE = range(9)
PAIR_GRADIENT = 9

# Planes of a row's pixels: transmittance, remaining sum, d.
SEEN, BEHIND, D_RED, D_GREEN, D_BLUE = range(5)
PLANES = 5

# Sums over the rows of a tile for one pair, a lane for each column of pixels: `flow` times powers
# of the offset from the Gaussian's centre, weight times d.
FLOW, FLOW_X, FLOW_Y, FLOW_XX, FLOW_XY, FLOW_YY, SUM_RED, SUM_GREEN, SUM_BLUE = range(9)
SUMS = 9


@kernel(fastmath=True, inline="always")
def _pass_frozen(projected, g, x_px, y_px, pixels, row_open, open_rows):  # type: ignore[no-untyped-def]
    """Puts Gaussian g before what is left of a tile, without a gradient; the rows still open."""
    zero = np.float32(0)
    a, b, c = projected[g, CONIC_A], projected[g, CONIC_B], projected[g, CONIC_C]
    opacity, q_max = projected[g, OPACITY], projected[g, Q_MAX]
    red, green, blue = projected[g, RED], projected[g, GREEN], projected[g, BLUE]
    left, top = from_centre(x_px, projected[g, X]), from_centre(y_px, projected[g, Y])
    first, end = rows_hit(a, b, c, q_max, left, top)
    for row in range(first, end):
        if not row_open[row]:
            continue
        dy = top + np.float32(row)
        light = zero
        for x in range(TILE_PX):
            unclamped = unclamped_alpha(a, b, c, opacity, left + np.float32(x), dy)
            _, weight, after = blend_pixel(pixels[row, SEEN, x], unclamped)
            along = (
                red * pixels[row, D_RED, x]
                + green * pixels[row, D_GREEN, x]
                + blue * pixels[row, D_BLUE, x]
            )
            pixels[row, SEEN, x] = after
            pixels[row, BEHIND, x] -= weight * along
            light += after
        if light == zero:
            row_open[row] = False
            open_rows -= 1
    return open_rows


@kernel(fastmath=True, parallel=True)
def blend_tiles_backward(  # type: ignore[no-untyped-def]
    projected,
    starts,
    ends,
    gaussians,
    pairs,
    moves,
    order,
    tiles_x,
    picture,
    picture_grad,
    pair_grads,
):
    """Fills `pair_grads` (P, 9) float32 from `picture` and `picture_grad`, both
    (3, tiles_y * TILE_PX, tiles_x * TILE_PX), for the pairs of Gaussians that are trained.

    moves: (M,) bool, whether a Gaussian is. ends, order: see `trained_ends`; a tile's list is gone
    through up to its end, as what is frozen hides what lies behind it all the same.
    """
    alpha_max = np.float32(ALPHA_MAX)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    for k in prange(order.shape[0]):
        tile = order[k]
        x_px, y_px = tile_corner(tile, tiles_x)
        pixels = np.empty((TILE_PX, PLANES, TILE_PX), np.float32)
        sums = np.empty((SUMS, TILE_PX), np.float32)
        for row in range(TILE_PX):
            for x in range(TILE_PX):
                red = picture_grad[0, y_px + row, x_px + x]
                green = picture_grad[1, y_px + row, x_px + x]
                blue = picture_grad[2, y_px + row, x_px + x]
                pixels[row, SEEN, x] = one
                pixels[row, BEHIND, x] = (
                    red * picture[0, y_px + row, x_px + x]
                    + green * picture[1, y_px + row, x_px + x]
                    + blue * picture[2, y_px + row, x_px + x]
                )
                pixels[row, D_RED, x] = red
                pixels[row, D_GREEN, x] = green
                pixels[row, D_BLUE, x] = blue
        open_rows = TILE_PX
        row_open = np.ones(TILE_PX, np.bool_)
        for entry in range(starts[tile], ends[tile]):
            pair = pairs[entry]
            g = gaussians[entry]
            if not moves[g]:
                if open_rows > 0:
                    open_rows = _pass_frozen(projected, g, x_px, y_px, pixels, row_open, open_rows)
                continue
            if open_rows == 0:
                for column in range(PAIR_GRADIENT):
                    pair_grads[pair, column] = zero
                continue
            a, b, c = projected[g, CONIC_A], projected[g, CONIC_B], projected[g, CONIC_C]
            opacity, q_max = projected[g, OPACITY], projected[g, Q_MAX]
            red, green, blue = projected[g, RED], projected[g, GREEN], projected[g, BLUE]
            left, top = from_centre(x_px, projected[g, X]), from_centre(y_px, projected[g, Y])
            for plane in range(SUMS):
                for x in range(TILE_PX):
                    sums[plane, x] = zero
            first, end = rows_hit(a, b, c, q_max, left, top)
            for row in range(first, end):
                if not row_open[row]:
                    continue
                dy = top + np.float32(row)
                light = zero
                for x in range(TILE_PX):
                    dx = left + np.float32(x)
                    unclamped = unclamped_alpha(a, b, c, opacity, dx, dy)
                    seen = pixels[row, SEEN, x]
                    alpha, weight, after = blend_pixel(seen, unclamped)
                    d_red = pixels[row, D_RED, x]
                    d_green = pixels[row, D_GREEN, x]
                    d_blue = pixels[row, D_BLUE, x]
                    along = red * d_red + green * d_green + blue * d_blue
                    behind = pixels[row, BEHIND, x] - weight * along
                    # d loss / d alpha times alpha; none where alpha is cut or clamped
                    flow = (seen * along - behind / (one - alpha)) * alpha
                    flow = flow if weight > zero else zero
                    flow = flow if unclamped <= alpha_max else zero
                    pixels[row, SEEN, x] = after
                    pixels[row, BEHIND, x] = behind
                    light += after
                    flow_x = flow * dx
                    flow_y = flow * dy
                    sums[FLOW, x] += flow
                    sums[FLOW_X, x] += flow_x
                    sums[FLOW_Y, x] += flow_y
                    sums[FLOW_XX, x] += flow_x * dx
                    sums[FLOW_XY, x] += flow_x * dy
                    sums[FLOW_YY, x] += flow_y * dy
                    sums[SUM_RED, x] += weight * d_red
                    sums[SUM_GREEN, x] += weight * d_green
                    sums[SUM_BLUE, x] += weight * d_blue
                if light == zero:
                    row_open[row] = False
                    open_rows -= 1
            flow, flow_x, flow_y, flow_xx, flow_xy, flow_yy = zero, zero, zero, zero, zero, zero
            sum_red, sum_green, sum_blue = zero, zero, zero
            for x in range(TILE_PX):
                flow += sums[FLOW, x]
                flow_x += sums[FLOW_X, x]
                flow_y += sums[FLOW_Y, x]
                flow_xx += sums[FLOW_XX, x]
                flow_xy += sums[FLOW_XY, x]
                flow_yy += sums[FLOW_YY, x]
                sum_red += sums[SUM_RED, x]
                sum_green += sums[SUM_GREEN, x]
                sum_blue += sums[SUM_BLUE, x]
            pair_grads[pair, G_X] = a * flow_x + b * flow_y
            pair_grads[pair, G_Y] = b * flow_x + c * flow_y
            pair_grads[pair, G_CONIC_A] = -half * flow_xx
            pair_grads[pair, G_CONIC_B] = -flow_xy
            pair_grads[pair, G_CONIC_C] = -half * flow_yy
            pair_grads[pair, G_LOGIT] = flow * (one - opacity)
            pair_grads[pair, G_RED] = sum_red
            pair_grads[pair, G_GREEN] = sum_green
            pair_grads[pair, G_BLUE] = sum_blue


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


@kernel(inline="always")
def higher_slopes(x, y, z):  # type: ignore[no-untyped-def]
    """For each of `higher_harmonics` its three derivatives, by x, y and z."""
    zero, two, three, four = np.float32(0), np.float32(2), np.float32(3), np.float32(4)
    six, eight = np.float32(6), np.float32(8)
    xx, yy, zz = x * x, y * y, z * z
    c20, c21, c22 = np.float32(SH_C2[0]), np.float32(SH_C2[1]), np.float32(SH_C2[2])
    c30, c31, c32 = np.float32(SH_C3[0]), np.float32(SH_C3[1]), np.float32(SH_C3[2])
    c33, c34 = np.float32(SH_C3[3]), np.float32(SH_C3[4])
    return (
        (c20 * y, c20 * x, zero),
        (zero, -c20 * z, -c20 * y),
        (-two * c21 * x, -two * c21 * y, four * c21 * z),
        (-c20 * z, zero, -c20 * x),
        (two * c22 * x, -two * c22 * y, zero),
        (-six * c30 * x * y, -three * c30 * (xx - yy), zero),
        (c31 * y * z, c31 * x * z, c31 * x * y),
        (two * c32 * x * y, -c32 * (four * zz - xx - three * yy), -eight * c32 * y * z),
        (-six * c33 * x * z, -six * c33 * y * z, three * c33 * (two * zz - xx - yy)),
        (-c32 * (four * zz - three * xx - yy), two * c32 * x * y, -eight * c32 * x * z),
        (two * c34 * x * z, -two * c34 * y * z, c34 * (xx - yy)),
        (-three * c30 * (xx - yy), six * c30 * x * y, zero),
    )


@kernel(fastmath=True, parallel=True)
def colour_backward_kernel(  # type: ignore[no-untyped-def]
    means, sh, rows, trained, camera, projected, pair_starts, pair_grads, g_means, g_sh
):  # fmt: skip
    """Adds to `g_means`, and writes into `g_sh`, what comes of the harmonics of degree 2 and 3; see
    project_backward_kernel, which ran before, for the arguments."""
    zero, one = np.float32(0), np.float32(1)
    px, py, pz = camera[CAM_POSITION], camera[CAM_POSITION + 1], camera[CAM_POSITION + 2]
    count = sh.shape[1] - 4
    for k in prange(trained.shape[0]):
        i = trained[k]
        if pair_starts[i] == pair_starts[i + 1]:
            continue
        row = rows[i]
        red, green, blue = zero, zero, zero
        for pair in range(pair_starts[i], pair_starts[i + 1]):
            red += pair_grads[pair, G_RED]
            green += pair_grads[pair, G_RED + 1]
            blue += pair_grads[pair, G_RED + 2]
        # A channel cut at zero has no gradient.
        red = red if projected[i, RED] > zero else zero
        green = green if projected[i, RED + 1] > zero else zero
        blue = blue if projected[i, RED + 2] > zero else zero
        x, y, z = means[row, 0] - px, means[row, 1] - py, means[row, 2] - pz
        inv = one / np.sqrt(x * x + y * y + z * z)
        x, y, z = x * inv, y * inv, z * inv
        values, slopes = higher_harmonics(x, y, z), higher_slopes(x, y, z)
        dx, dy, dz = zero, zero, zero
        for j in range(count):
            value, slope = values[j], slopes[j]
            g_sh[row, 4 + j, 0] = value * red
            g_sh[row, 4 + j, 1] = value * green
            g_sh[row, 4 + j, 2] = value * blue
            weight = sh[row, 4 + j, 0] * red + sh[row, 4 + j, 1] * green + sh[row, 4 + j, 2] * blue
            dx += weight * slope[0]
            dy += weight * slope[1]
            dz += weight * slope[2]
        radial = dx * x + dy * y + dz * z
        g_means[row, 0] += (dx - x * radial) * inv
        g_means[row, 1] += (dy - y * radial) * inv
        g_means[row, 2] += (dz - z * radial) * inv
