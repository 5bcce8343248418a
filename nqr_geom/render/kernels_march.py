"""Kernels that look at densities along rays: with all that a sample tells, and only for their mean.

Each is built for the effects of a medium when it is first needed, and kept.
"""

from functools import cache

import torch

from nqr_geom._warp import array, launch, wp
from nqr_geom.keyed_warp import mixed, unit, unsigned
from nqr_geom.render.kernels_density import Packed, components

__all__ = ["DESIGNS", "FEATURES", "Rays", "mean", "observe", "place"]

FEATURES = ("t", "u_geo", "u_fbm", "slope", "bend")
DESIGNS = ("random", "stratified", "uniform-jitter")  # samplers whose points the mean can place itself


@wp.struct
class Rays:
    """B rays and the K stretches of each that count, one after the other; lengths are from where it enters the box."""

    entry: wp.array(dtype=wp.vec3d)  # (B,) relative to the box's low corner
    direction: wp.array(dtype=wp.vec3d)
    near: wp.array(dtype=wp.float64)  # (B,) distance from the origin to `entry`
    volume: wp.array(dtype=wp.int32)
    start: wp.array2d(dtype=wp.float64)  # (B, K)
    length: wp.array2d(dtype=wp.float64)  # (B, K), zero for stretches that are not there
    total: wp.array(dtype=wp.float64)  # (B,) sum of the lengths


@wp.func
def place(rays: Rays, row: int, x: wp.float64) -> wp.float64:
    """Distance from the entry at which a part x of the stretches lies behind."""
    rest = x * rays.total[row]
    last = rays.start.shape[1] - 1
    k = wp.int32(0)
    while k < last and rest > rays.length[row, k]:
        rest -= rays.length[row, k]
        k += 1
    # Stretches that are not there have no length: the walk ends in the last one that is.
    while k > 0 and rays.length[row, k] == wp.float64(0.0):
        k -= 1
        rest += rays.length[row, k]
    return rays.start[row, k] + wp.min(rest, rays.length[row, k])


@cache
def _observe_kernel(kind, noisy):
    density = components(kind, noisy)

    @wp.kernel(enable_backward=False, module="unique")
    def observed(
        first: wp.int32,
        m: Packed,
        rays: Rays,
        everything: wp.int32,
        x: wp.array2d(dtype=wp.float64),
        value: wp.array2d(dtype=wp.float64),
        features: wp.array3d(dtype=wp.float64),
        seen: wp.array(dtype=wp.int32),
    ):
        row = first + wp.tid()
        v = rays.volume[row]
        count = wp.int32(0)
        if everything == 1 or rays.total[row] > wp.float64(0.0):
            for i in range(x.shape[1]):
                t = place(rays, row, x[row, i])
                p = rays.entry[row] + t * rays.direction[row]
                u, geometry, noise, slope, bend, evaluated = density(m, v, p, rays.direction[row])
                value[row, i] = m.density[v] * u * rays.total[row]
                features[row, i, 0] = rays.near[row] + t
                features[row, i, 1] = geometry
                features[row, i, 2] = noise
                features[row, i, 3] = slope
                features[row, i, 4] = bend
                count += evaluated
        seen[row] = count

    return observed


def observe(medium, rays, x, everything=False):
    """Value times length (B, N), features (B, N, 5) in the order of `FEATURES`, and noise evaluations a row (B,)."""
    x = x.contiguous()
    value = torch.zeros_like(x)
    features = x.new_zeros(*x.shape, len(FEATURES))
    seen = torch.zeros(len(x), dtype=torch.int32, device=x.device)
    outputs = [array(value, wp.float64), array(features, wp.float64), array(seen, wp.int32)]
    arguments = [medium.packed, rays.packed, int(everything), array(x, wp.float64), *outputs]
    launch(_observe_kernel(medium.kind, medium.noisy), len(x), arguments, str(x.device))
    return value, features, seen


@cache
def _mean_kernel(kind, noisy):
    density = components(kind, noisy)

    @wp.kernel(enable_backward=False, module="unique")
    def marched(
        first: wp.int32,
        m: Packed,
        rays: Rays,
        everything: wp.int32,
        rows: wp.array(dtype=wp.int64),
        key: wp.uint64,
        n: wp.int32,
        design: wp.int32,
        out: wp.array2d(dtype=wp.float64),
        seen: wp.array(dtype=wp.int32),
    ):
        row = first + wp.tid()
        v = rays.volume[row]
        count = wp.int32(0)
        average = wp.float64(0.0)
        square = wp.float64(0.0)
        if everything == 1 or rays.total[row] > wp.float64(0.0):
            state = mixed(key, rows[row])
            shift = unit(mixed(mixed(state, wp.int64(0)), wp.int64(0)))
            for i in range(n):
                x = shift
                if design < 2:
                    x = unit(mixed(mixed(state, wp.int64(i)), wp.int64(0)))
                if design > 0:
                    x = wp.min((wp.float64(i) + x) / wp.float64(n), wp.float64(0.9999999999999999))
                t = place(rays, row, x)
                p = rays.entry[row] + t * rays.direction[row]
                u, _geometry, _noise, _slope, _bend, evaluated = density(m, v, p, rays.direction[row])
                value = m.density[v] * u * rays.total[row]
                delta = value - average
                average += delta / wp.float64(i + 1)
                square += delta * (value - average)
                count += evaluated
        out[row, 0] = average
        out[row, 1] = square
        seen[row] = count

    return marched


def mean(medium, rays, rows, key, n, design, everything=False):
    """Mean of n values and their squared deviations (B, 2), and noise evaluations a row (B,); see `DESIGNS`."""
    out = torch.zeros(len(rows), 2, dtype=torch.float64, device=rows.device)
    seen = torch.zeros(len(rows), dtype=torch.int32, device=rows.device)
    arguments = [medium.packed, rays.packed, int(everything), array(rows, wp.int64), unsigned(key), n]
    outputs = [array(out, wp.float64), array(seen, wp.int32)]
    kernel = _mean_kernel(medium.kind, medium.noisy)
    launch(kernel, len(rows), [*arguments, DESIGNS.index(design), *outputs], str(rows.device))
    return out, seen
