"""Direct light at surfaces: scenes in memory, and one pass, made for just the effects that a scene has.

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
from nqr_geom.render.kernels_light import Chosen, Light, Node, sphere_cone, sphere_direction, sphere_hit

__all__ = ["OFFSET", "Ball", "Pass", "Place", "Sample", "World", "one_pass_for", "part_of"]

OFFSET = 1e-5

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
def one_pass_for(shadows: bool, gloss: bool, selection: bool, medium: tuple[str, bool] | None) -> Any:
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
        elif wp.dot(w, s.geometric) <= _ZERO:
            made.other = _ZERO  # it would have been dropped
        elif lobes.pdf > _ZERO:
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
