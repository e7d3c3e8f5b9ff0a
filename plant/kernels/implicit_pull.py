"""Force of one cell's wheels at a velocity, by the coefficients that ``implicit_step`` lists."""

from __future__ import annotations

from plant.kernels import implicit_layout as im
from plant.kernels.jit import kernel


@kernel
def clamped(q, b, c):
    """A force within its limit, and how it answers to slip."""
    if q > c:
        return c, 0.0
    if q < -c:
        return -c, 0.0
    return q, b


@kernel
def pull(row, w, isotropic):
    """Force of one cell's wheels without the push, and its derivative by slip: (fx, fy, kxx, kxy, kyy)."""
    b, c = row[im.B], row[im.C]
    qx = row[im.LX] + b * (row[im.SX] - w[0] - row[im.AX] * w[2])
    qy = row[im.LY] + b * (row[im.SY] - w[1] - row[im.AY] * w[2])
    if isotropic == 0.0:
        fx, kx = clamped(qx, b, c)
        fy, ky = clamped(qy, b, c)
        return fx, fy, kx, 0.0, ky
    size = (qx * qx + qy * qy) ** 0.5
    if size <= c:
        return qx, qy, b, 0.0, b
    ex, ey, k = qx / size, qy / size, b * c / size
    return c * ex, c * ey, k * ey * ey, -k * ex * ey, k * ex * ex
