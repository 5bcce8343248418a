"""Kernels that track photons through a medium with a majorant: ratio tracking and its track-length relative."""

from functools import cache

import torch

from nqr_geom._warp import array, launch, wp
from nqr_geom.keyed_warp import mixed, unit, unsigned
from nqr_geom.render.kernels_density import Packed, components
from nqr_geom.render.kernels_march import Rays, place

__all__ = ["track"]


@cache
def _kernel(kind, noisy, ratio):
    density = components(kind, noisy)

    @wp.kernel(enable_backward=False, module="unique")
    def tracked(
        first: wp.int32,
        m: Packed,
        rays: Rays,
        rows: wp.array(dtype=wp.int64),
        key: wp.uint64,
        enough: wp.int32,
        most: wp.int32,
        out: wp.array2d(dtype=wp.float64),
        work: wp.array2d(dtype=wp.int32),
    ):
        row = first + wp.tid()
        v = rays.volume[row]
        one = wp.float64(1.0)
        total = rays.total[row]
        depth = m.density[v] * total
        direction = rays.direction[row]
        state = mixed(key, rows[row])
        runs = wp.int32(0)
        queries = wp.int32(0)
        noise = wp.int32(0)
        mean = wp.float64(0.0)
        square = wp.float64(0.0)
        while runs < most and queries <= enough:
            run = mixed(state, wp.int64(runs))
            weight = wp.float64(1.0)
            x = wp.float64(0.0)  # part of the ray's optical length at the majorant
            step = wp.int32(0)
            going = bool(depth > wp.float64(0.0))
            while going:
                x -= wp.log(unit(mixed(run, wp.int64(2 * step)))) / depth
                if x >= one:
                    going = False
                else:
                    p = rays.entry[row] + place(rays, row, x) * direction
                    u, _geometry, _noise, _slope, _bend, evaluated = density(m, v, p, direction)
                    queries += 1
                    noise += evaluated
                    if wp.static(ratio):
                        weight *= one - u
                    elif unit(mixed(run, wp.int64(2 * step + 1))) < u:
                        weight = wp.float64(0.0)
                    step += 1
                    going = bool(weight > wp.float64(0.0))
            runs += 1
            delta = weight - mean
            mean += delta / wp.float64(runs)
            square += delta * (weight - mean)
        out[row, 0] = mean
        out[row, 1] = square
        work[row, 0] = runs
        work[row, 1] = queries
        work[row, 2] = noise

    return tracked


def track(medium, rays, rows, key, *, ratio, enough, most):
    """Mean of tracked runs and their squared deviations (B, 2), and runs, queries and noise evaluations (B, 3).

    Parameters
    ----------
    medium, rays, rows
        As of a `TransmittanceProblem`.
    key : int
        Of a stream; run and step of a ray are further counters.
    ratio : bool
        Ratio tracking (a run's weight is the product of 1 - u at its collisions) or track length (a run counts if it
        gets through without a real collision).
    enough, most : int
        Runs go on until more than `enough` queries are spent, and there are at most `most` of them.
    """
    out = torch.zeros(len(rows), 2, dtype=torch.float64, device=rows.device)
    work = torch.zeros(len(rows), 3, dtype=torch.int32, device=rows.device)
    arguments = [medium.packed, rays.packed, array(rows, wp.int64), unsigned(key), enough, most]
    outputs = [array(out, wp.float64), array(work, wp.int32)]
    launch(_kernel(medium.kind, medium.noisy, bool(ratio)), len(rows), [*arguments, *outputs], str(rows.device))
    return out, work
