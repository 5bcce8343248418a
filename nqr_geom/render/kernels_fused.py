"""The kernels around a pass of direct light: all that is seen, the balance heuristic, diffuse light in closed form."""

from functools import lru_cache
from typing import Any

from nqr_geom._warp import wp
from nqr_geom.render import kernels_light
from nqr_geom.render.kernels_bsdf import Surface, frame_of, to_local
from nqr_geom.render.kernels_direct import OFFSET, Sample, World, one_pass_for
from nqr_geom.render.kernels_light import irradiance
from nqr_geom.render.kernels_numbers import Numbers, coordinate, shuffle

__all__ = ["EXTRA", "kernel"]

EXTRA = 30  # numbers that `observe` writes for each technique beside value and densities

_OFFSET = wp.constant(wp.float64(OFFSET))
_ZERO = wp.constant(wp.float64(0.0))


@wp.func
def balance(s: Sample) -> wp.float64:
    """The balance heuristic's weight of a sample."""
    total = s.own + s.other
    if total > _ZERO:
        return s.own / total
    return _ZERO


@wp.func
def write_extra(
    extra: wp.array(dtype=wp.float64),
    s: Sample,
    world: World,
    surface: Surface,
    unhidden: wp.vec3d,
    nee: wp.float64,
    bsdf: wp.float64,
):
    """The features of one sample, in the order of `direct_problem.LAYOUT`."""
    for c in range(3):
        extra[c] = s.direction[c]
        extra[8 + c] = s.f[c]
        extra[19 + c] = s.share[c]
        extra[27 + c] = unhidden[c]
    extra[3] = nee
    extra[7] = bsdf
    extra[17] = s.lambert
    extra[26] = s.visible
    extra[22] = wp.float64(-1.0)
    if s.light >= 0:
        light = world.lights[s.light]
        chance = kernels_light.chance_of(world.nodes, light.leaf, surface.position, surface.normal)
        away = light.centre - surface.position
        distance = wp.length(away)
        for c in range(3):
            if chance[3] > _ZERO:
                extra[4 + c] = chance[c] / chance[3]
            if distance > _ZERO:
                extra[11 + c] = away[c] / distance
        extra[14] = distance
        extra[15] = light.radius
        for c in range(3):
            extra[23 + c] = light.radiance[c]
        extra[16] = s.chance
        extra[18] = irradiance(light.centre, light.radius, surface.position, surface.normal)
        extra[22] = wp.float64(s.light - world.places[surface.scene].lights)


def _observe(one_pass: Any) -> Any:
    """Kernel that writes all that is known of every sample."""

    @wp.kernel(enable_backward=False, module="unique")
    def observe(
        first: wp.int32,
        world: World,
        surfaces: wp.array(dtype=Surface),
        x: wp.array3d(dtype=wp.float64),
        value: wp.array3d(dtype=wp.vec3d),
        density: wp.array4d(dtype=wp.float64),
        extra: wp.array4d(dtype=wp.float64),
        rays: wp.array2d(dtype=wp.int32),
    ):
        row = first + wp.tid()
        s = surfaces[row]
        if s.kind >= 0:
            place = world.places[s.scene]
            out = to_local(frame_of(s.normal), s.outgoing)
            start = s.position + _OFFSET * s.geometric
            unhidden = wp.vec3d()
            for j in range(place.lights, place.lights_end):
                light = world.lights[j]
                unhidden += irradiance(light.centre, light.radius, s.position, s.normal) * light.radiance
            for i in range(x.shape[1]):
                made = one_pass(
                    world, place, s, out, start,
                    x[row, i, 0], x[row, i, 1], x[row, i, 2], x[row, i, 3], x[row, i, 4], x[row, i, 5],
                )  # fmt: skip
                value[row, i, 0] = wp.cw_mul(made.bsdf.value, s.through)
                value[row, i, 1] = wp.cw_mul(made.nee.value, s.through)
                density[row, i, 0, 0] = made.bsdf.own
                density[row, i, 0, 1] = made.bsdf.other
                density[row, i, 1, 0] = made.nee.other
                density[row, i, 1, 1] = made.nee.own
                write_extra(extra[row][i][0], made.bsdf, world, s, unhidden, made.bsdf.other, made.bsdf.own)
                write_extra(extra[row][i][1], made.nee, world, s, unhidden, made.nee.own, made.nee.other)
                rays[row, 0] = rays[row, 0] + made.bsdf.rays
                rays[row, 1] = rays[row, 1] + made.nee.rays
                rays[row, 2] = rays[row, 2] + made.bsdf.marched + made.nee.marched

    return observe


def _balance(one_pass: Any) -> Any:
    """Kernel that draws n passes and gives their mean under the balance heuristic."""

    @wp.kernel(enable_backward=False, module="unique")
    def fused(
        first: wp.int32,
        world: World,
        surfaces: wp.array(dtype=Surface),
        rows: wp.array(dtype=wp.int64),
        numbers: Numbers,
        n: wp.int32,
        mean: wp.array(dtype=wp.vec3d),
        m2: wp.array(dtype=wp.vec3d),
        rays: wp.array2d(dtype=wp.int32),
    ):
        at = first + wp.tid()
        s = surfaces[at]
        if s.kind >= 0:
            row = rows[at]
            place = world.places[s.scene]
            out = to_local(frame_of(s.normal), s.outgoing)
            start = s.position + _OFFSET * s.geometric
            shuffle(numbers, at, row, n)
            average = wp.vec3d()
            spread = wp.vec3d()
            traced_bsdf = wp.int32(0)
            traced_nee = wp.int32(0)
            marched = wp.int32(0)
            for i in range(n):
                made = one_pass(
                    world, place, s, out, start,
                    coordinate(numbers, at, row, i, 0), coordinate(numbers, at, row, i, 1),
                    coordinate(numbers, at, row, i, 2), coordinate(numbers, at, row, i, 3),
                    coordinate(numbers, at, row, i, 4), coordinate(numbers, at, row, i, 5),
                )  # fmt: skip
                term = balance(made.bsdf) * made.bsdf.value + balance(made.nee) * made.nee.value
                step = term - average  # Welford's way: no cancellation in the spread
                average += step / wp.float64(i + 1)
                spread += wp.cw_mul(step, term - average)
                traced_bsdf += made.bsdf.rays
                traced_nee += made.nee.rays
                marched += made.bsdf.marched + made.nee.marched
            mean[at] = wp.cw_mul(average, s.through)
            m2[at] = wp.cw_mul(spread, wp.cw_mul(s.through, s.through))
            rays[at, 0] = traced_bsdf
            rays[at, 1] = traced_nee
            rays[at, 2] = marched

    return fused


@wp.struct
class Unhidden:
    """Sums over samples under the balance heuristic, see `direct_rules.UnhiddenLight`."""

    rest: wp.vec3d  # what keeps the balance heuristic: gloss, and lights that may be missed
    missed: wp.vec3d  # unhidden irradiance from lights that may be missed
    reflected: wp.vec3d  # diffuse reflection, by the next sum
    lambert: wp.float64
    sure: wp.float64  # the last one, of lights that are sure to be sampled
    visible: wp.float64  # and what of it arrives


@wp.func
def gather(
    sums: wp.array(dtype=wp.vec4d), so_far: Unhidden, world: World, s: Sample, first: wp.int32, sure: wp.float64
) -> Unhidden:
    """Add a sample; the diffuse part of a light that is sure to be sampled goes to that light's sums."""
    made = so_far
    if s.light < 0:
        return made
    weight = balance(s)
    value = weight * s.value
    part = weight * s.lambert
    made.reflected += part * wp.cw_mul(s.f, s.share)
    made.lambert += part
    if s.chance < sure:
        made.rest += value
        made.missed += part * world.lights[s.light].radiance
        return made
    diffuse = wp.cw_mul(value, s.share)
    sums[s.light - first] = sums[s.light - first] + wp.vec4d(diffuse[0], diffuse[1], diffuse[2], part)
    made.rest += value - diffuse
    made.sure += part
    made.visible += part * s.visible
    return made


def _structured(one_pass: Any) -> Any:
    """Kernel that draws n passes and takes diffuse light in closed form, see `direct_rules.UnhiddenLight`."""

    @wp.kernel(enable_backward=False, module="unique")
    def fused(
        first: wp.int32,
        world: World,
        surfaces: wp.array(dtype=Surface),
        rows: wp.array(dtype=wp.int64),
        numbers: Numbers,
        n: wp.int32,
        sure: wp.float64,
        sums: wp.array2d(dtype=wp.vec4d),
        mean: wp.array(dtype=wp.vec3d),
        rays: wp.array2d(dtype=wp.int32),
    ):
        at = first + wp.tid()
        s = surfaces[at]
        if s.kind >= 0:
            row = rows[at]
            place = world.places[s.scene]
            out = to_local(frame_of(s.normal), s.outgoing)
            start = s.position + _OFFSET * s.geometric
            shuffle(numbers, at, row, n)
            so_far = Unhidden()
            for i in range(n):
                made = one_pass(
                    world, place, s, out, start,
                    coordinate(numbers, at, row, i, 0), coordinate(numbers, at, row, i, 1),
                    coordinate(numbers, at, row, i, 2), coordinate(numbers, at, row, i, 3),
                    coordinate(numbers, at, row, i, 4), coordinate(numbers, at, row, i, 5),
                )  # fmt: skip
                so_far = gather(sums[at], so_far, world, made.bsdf, place.lights, sure)
                so_far = gather(sums[at], so_far, world, made.nee, place.lights, sure)
                rays[at, 0] = rays[at, 0] + made.bsdf.rays
                rays[at, 1] = rays[at, 1] + made.nee.rays
                rays[at, 2] = rays[at, 2] + made.bsdf.marched + made.nee.marched
            total = so_far.rest / wp.float64(n)
            missed = -so_far.missed / wp.float64(n)
            for j in range(place.lights_end - place.lights):
                light = world.lights[place.lights + j]
                exact = irradiance(light.centre, light.radius, s.position, s.normal)
                sum = sums[at, j]
                if sum[3] > _ZERO:
                    total += (exact / sum[3]) * wp.vec3d(sum[0], sum[1], sum[2])
                else:
                    missed += exact * light.radiance
            if so_far.sure > _ZERO:
                share = so_far.visible / (so_far.sure * so_far.lambert)
                total += share * wp.cw_mul(so_far.reflected, missed)
            mean[at] = wp.cw_mul(total, s.through)

    return fused


_MAKERS = {"observe": _observe, "balance": _balance, "structured": _structured}


@lru_cache(maxsize=64)
def kernel(name: str, shadows: bool, gloss: bool, selection: bool, medium: tuple[str, bool] | None = None) -> Any:
    """The kernel called "observe", "balance" or "structured" for a scene with these effects, made once."""
    return _MAKERS[name](one_pass_for(shadows, gloss, selection, medium))
