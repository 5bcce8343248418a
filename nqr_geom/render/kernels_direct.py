"""Direct light at surfaces: one pass, and the kernels around it, made for just the effects that a scene has.

A pass draws one direction by the material and one towards a light. A direction by the material is first held against
the lights, which are spheres; only one that meets a light is traced, and only as far as that light. Geometry is
float64; whether a triangle is in the way is asked of Warp's tree, which is float32: rays start `OFFSET` off the surface
(the scene is scaled to half extent 1), and what is closer than that to a surface casts no shadow on it.
"""

from functools import lru_cache
from typing import Any

from nqr_geom._warp import wp
from nqr_geom.render import kernels_bsdf, kernels_light
from nqr_geom.render.kernels_bsdf import Surface, frame_of, to_local, to_world
from nqr_geom.render.kernels_density import Packed
from nqr_geom.render.kernels_light import Chosen, Light, Node, irradiance, sphere_cone, sphere_direction, sphere_hit
from nqr_geom.render.kernels_numbers import Numbers, coordinate, shuffle

__all__ = ["EXTRA", "OFFSET", "Ball", "Pass", "Place", "World", "kernel"]

OFFSET = 1e-5
EXTRA = 30  # numbers that `observe` writes for each technique beside value and densities

_OFFSET = wp.constant(wp.float64(OFFSET))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_PI = wp.constant(wp.float64(3.141592653589793))
_SHORTER = wp.constant(wp.float64(1.0 - 1e-6))


@wp.struct
class Ball:
    """A sphere that is a surface."""

    centre: wp.vec3d
    radius: wp.float64


@wp.struct
class Place:
    """One scene's part of a world; `mesh` 0 is none."""

    mesh: wp.uint64
    corner: wp.vec3d  # from positions to the medium's box: scale * p + corner
    scale: wp.float64
    balls: wp.int32
    balls_end: wp.int32
    lights: wp.int32
    lights_end: wp.int32
    root: wp.int32
    volume: wp.int32  # -1 is none


@wp.struct
class World:
    """All scenes of a problem, one behind the other."""

    places: wp.array(dtype=Place)
    balls: wp.array(dtype=Ball)
    lights: wp.array(dtype=Light)
    nodes: wp.array(dtype=Node)
    coat: wp.array2d(dtype=wp.float64)
    medium: Packed


@wp.struct
class Sample:
    """What one technique brought: value is f/p, `own` and `other` the densities of both techniques at it.

    `lambert` is cos/p, the sample's part of the irradiance from a light of radiance 1 that nothing hides.
    """

    direction: wp.vec3d
    f: wp.vec3d
    share: wp.vec3d  # part of the diffuse lobe in f
    value: wp.vec3d
    own: wp.float64
    other: wp.float64
    lambert: wp.float64
    chance: wp.float64
    visible: wp.float64  # part of the light that arrives
    light: wp.int32
    rays: wp.int32
    marched: wp.int32  # density queries


@wp.struct
class Pass:
    """Both techniques."""

    bsdf: Sample
    nee: Sample


@wp.func
def part_of(part: wp.vec3d, whole: wp.vec3d) -> wp.vec3d:
    share = wp.vec3d(_ZERO, _ZERO, _ZERO)
    for c in range(3):
        if whole[c] > _ZERO:
            share[c] = part[c] / whole[c]
    return share


@wp.func
def single(w: wp.vec3d) -> wp.vec3:
    return wp.vec3(wp.float32(w[0]), wp.float32(w[1]), wp.float32(w[2]))


@wp.func
def first_light(world: World, place: Place, p: wp.vec3d, w: wp.vec3d) -> Chosen:
    """The nearest light along w, with its distance in the place of a chance."""
    nearest = Chosen()
    nearest.light = wp.int32(-1)
    nearest.chance = wp.float64(1e299)
    for j in range(place.lights, place.lights_end):
        t = sphere_hit(world.lights[j].centre, world.lights[j].radius, p, w)
        if t < nearest.chance:
            nearest.light = j
            nearest.chance = t
    return nearest


@wp.func
def hidden_by_light(
    world: World, place: Place, p: wp.vec3d, w: wp.vec3d, distance: wp.float64, light: wp.int32
) -> wp.bool:
    """Whether another light stands before this one."""
    for j in range(place.lights, place.lights_end):
        if j != light and sphere_hit(world.lights[j].centre, world.lights[j].radius, p, w) < distance:
            return True
    return False


@wp.func
def never_hidden(
    world: World, place: Place, p: wp.vec3d, w: wp.vec3d, distance: wp.float64, light: wp.int32
) -> wp.bool:
    return False


@wp.func
def occluded(world: World, place: Place, p: wp.vec3d, w: wp.vec3d, distance: wp.float64) -> wp.bool:
    """Whether a surface is in the way."""
    for j in range(place.balls, place.balls_end):
        if sphere_hit(world.balls[j].centre, world.balls[j].radius, p, w) < distance:
            return True
    if place.mesh == wp.uint64(0):
        return False
    return wp.mesh_query_ray_anyhit(place.mesh, single(p), single(w), wp.float32(distance * _SHORTER))


@wp.func
def never_occluded(world: World, place: Place, p: wp.vec3d, w: wp.vec3d, distance: wp.float64) -> wp.bool:
    return False


@wp.func
def clear_air(world: World, place: Place, p: wp.vec3d, w: wp.vec3d, distance: wp.float64) -> wp.vec2d:
    return wp.vec2d(_ONE, _ZERO)


@wp.func
def only_light(world: World, place: Place, p: wp.vec3d, n: wp.vec3d, u: wp.float64) -> Chosen:
    chosen = Chosen()
    chosen.light = wp.where(place.lights < place.lights_end, place.lights, -1)
    chosen.chance = _ONE
    return chosen


@wp.func
def chance_of_only(world: World, place: Place, light: wp.int32, p: wp.vec3d, n: wp.vec3d) -> wp.float64:
    return _ONE


@wp.func
def choose_light(world: World, place: Place, p: wp.vec3d, n: wp.vec3d, u: wp.float64) -> Chosen:
    return kernels_light.choose(world.nodes, place.root, p, n, u)


@wp.func
def chance_of_light(world: World, place: Place, light: wp.int32, p: wp.vec3d, n: wp.vec3d) -> wp.float64:
    return kernels_light.luminous_chance_of(world.nodes, world.lights[light].leaf, p, n)


@lru_cache(maxsize=64)
def _one_pass(shadows: bool, gloss: bool, selection: bool, medium: tuple[str, bool] | None) -> Any:
    """The pass of a scene with these effects; functions of absent ones are not even compiled."""
    reflect = kernels_bsdf.reflect_any if gloss else kernels_bsdf.reflect_diffuse
    sample = kernels_bsdf.sample_any if gloss else kernels_bsdf.sample_diffuse
    choose = choose_light if selection else only_light
    chance_of = chance_of_light if selection else chance_of_only
    hidden = hidden_by_light if selection else never_hidden
    blocked = occluded if shadows else never_occluded
    ray = 1 if shadows else 0
    through = clear_air
    if medium is not None:
        from nqr_geom.render.kernels_fog import fog

        through = fog(*medium)

    @wp.func
    def by_material(
        world: World, place: Place, s: Surface, out: wp.vec3d, start: wp.vec3d, u0: wp.float64, u1: wp.float64,
        u2: wp.float64,
    ) -> Sample:  # fmt: skip
        frame = frame_of(s.normal)
        made = Sample()
        made.light = wp.int32(-1)
        made.direction = sample(s, world.coat, out, u0, u1, u2)
        lobes = reflect(s, world.coat, out, made.direction)
        made.f = lobes.whole
        made.own = lobes.pdf
        w = to_world(frame, made.direction)
        if lobes.pdf > _ZERO and wp.dot(w, s.geometric) > _ZERO:
            met = first_light(world, place, start, w)
            if met.light >= 0:
                light = world.lights[met.light]
                made.light = met.light
                made.chance = chance_of(world, place, met.light, s.position, s.normal)
                made.other = made.chance / (_TWO * _PI * sphere_cone(light.centre, light.radius, s.position))
                made.lambert = made.direction[2] / lobes.pdf
                made.share = part_of(lobes.diffuse, lobes.whole)
                made.rays = wp.static(ray)
                if not blocked(world, place, start, w, met.chance):
                    kept = through(world, place, s.position, w, met.chance)
                    made.marched = wp.int32(kept[1])
                    made.visible = kept[0]
                    made.value = wp.cw_mul(lobes.whole, light.radiance) * (made.lambert * kept[0])
        return made

    @wp.func
    def by_light(
        world: World, place: Place, s: Surface, out: wp.vec3d, start: wp.vec3d, u0: wp.float64, u1: wp.float64,
        u2: wp.float64,
    ) -> Sample:  # fmt: skip
        frame = frame_of(s.normal)
        made = Sample()
        chosen = choose(world, place, s.position, s.normal, u0)
        made.light = chosen.light
        made.chance = chosen.chance
        if chosen.light < 0:
            return made
        light = world.lights[chosen.light]
        cone = sphere_cone(light.centre, light.radius, s.position)
        w = sphere_direction(light.centre, s.position, cone, u1, u2)
        made.direction = to_local(frame, w)
        made.own = chosen.chance / (_TWO * _PI * cone)
        if made.direction[2] <= _ZERO:
            return made
        lobes = reflect(s, world.coat, out, made.direction)
        made.f = lobes.whole
        made.other = lobes.pdf
        made.lambert = made.direction[2] / made.own
        made.share = part_of(lobes.diffuse, lobes.whole)
        distance = sphere_hit(light.centre, light.radius, start, w)
        if distance > wp.float64(1e299):  # the limb, missed by a rounding
            distance = wp.dot(light.centre - start, w)
        if hidden(world, place, start, w, distance, chosen.light):
            made.other = _ZERO  # a direction by the material would have met the other light
        elif lobes.pdf > _ZERO and wp.dot(w, s.geometric) > _ZERO:
            made.rays = wp.static(ray)
            if not blocked(world, place, start, w, distance):
                kept = through(world, place, s.position, w, distance)
                made.marched = wp.int32(kept[1])
                made.visible = kept[0]
                made.value = wp.cw_mul(lobes.whole, light.radiance) * (made.lambert * kept[0])
        return made

    @wp.func
    def one_pass(
        world: World, place: Place, s: Surface, out: wp.vec3d, start: wp.vec3d, u0: wp.float64, u1: wp.float64,
        u2: wp.float64, u3: wp.float64, u4: wp.float64, u5: wp.float64,
    ) -> Pass:  # fmt: skip
        made = Pass()
        made.bsdf = by_material(world, place, s, out, start, u2, u0, u1)
        made.nee = by_light(world, place, s, out, start, u3, u4, u5)
        return made

    return one_pass


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
        extra[22] = wp.float64(s.light)


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
    return _MAKERS[name](_one_pass(shadows, gloss, selection, medium))
