"""What each light would send to the viewer by one reflection if nothing hid it, inside kernels: no ray is traced.

On a diffuse surface that is closed form. Other lobes are integrated by points over the cone of each light and, for the
glossy lobe, points by its own density, both under the balance heuristic: materials are evaluated there, not visibility.
"""

from functools import lru_cache
from typing import Any

from nqr_geom._warp import wp
from nqr_geom.render import kernels_bsdf
from nqr_geom.render.kernels_bsdf import Surface, frame_of, ggx, ggx_normal, to_local, to_world, unmasked
from nqr_geom.render.kernels_direct import Place, World
from nqr_geom.render.kernels_light import importance, irradiance, sphere_cone, sphere_direction, sphere_hit

__all__ = ["known", "known_for", "span_of", "spans"]

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_FOUR = wp.constant(wp.float64(4.0))
_PI = wp.constant(wp.float64(3.141592653589793))
_FAR = wp.constant(wp.float64(1e299))
_DIFFUSE = wp.constant(wp.int32(kernels_bsdf.DIFFUSE))


@wp.func
def gloss_density(s: Surface, out: wp.vec3d, w: wp.vec3d) -> wp.float64:
    """Density of directions by the microfacets that `out` sees."""
    h = wp.normalize(w + out)
    return unmasked(out, s.roughness) * ggx(h, s.roughness) / (_FOUR * out[2])


@wp.func
def turned(point: wp.vec2d, shift: wp.vec2d) -> wp.vec2d:
    """A point of the unit square, moved around the torus."""
    u = point[0] + shift[0]
    v = point[1] + shift[1]
    return wp.vec2d(u - wp.floor(u), v - wp.floor(v))


@wp.func
def span_of(world: World, s: Surface, j: wp.int32) -> wp.vec2d:
    """The part of the unit interval in which `kernels_light.choose` takes a light: lower end and length."""
    at = world.lights[j].leaf
    low = wp.float64(0.0)
    length = wp.float64(1.0)
    while world.nodes[at].parent >= 0:
        left = world.nodes[world.nodes[at].parent].child
        a = world.nodes[left].power[3] * importance(world.nodes[left], s.position, s.normal)
        b = world.nodes[left + 1].power[3] * importance(world.nodes[left + 1], s.position, s.normal)
        part = _ZERO
        if a + b > _ZERO:
            part = a / (a + b)
        if at == left:
            low = low * part
            length = length * part
        else:
            low = part + (_ONE - part) * low
            length = length * wp.where(a + b > _ZERO, _ONE - part, _ZERO)
        at = world.nodes[at].parent
    return wp.vec2d(low, length)


@wp.kernel(enable_backward=False)
def spans(first: wp.int32, world: World, surfaces: wp.array(dtype=Surface), span: wp.array2d(dtype=wp.vec2d)):
    """`span_of` every light of each surface's scene, (B, L)."""
    row = first + wp.tid()
    s = surfaces[row]
    if s.kind >= 0:
        place = world.places[s.scene]
        for j in range(place.lights, place.lights_end):
            span[row, j - place.lights] = span_of(world, s, j)


@lru_cache(maxsize=2)
def known_for(gloss: bool) -> Any:
    """The function that fills in the radiance by light, in scenes with or without glossy lobes."""
    reflect = kernels_bsdf.reflect_any if gloss else kernels_bsdf.reflect_diffuse

    @wp.func
    def by_lights(
        world: World, s: Surface, out: wp.vec3d, points: wp.array(dtype=wp.vec2d), shift: wp.vec2d, first: wp.int32,
        last: wp.int32, sums: wp.array(dtype=wp.vec3d),
    ):  # fmt: skip
        frame = frame_of(s.normal)
        count = points.shape[0]
        for j in range(first, last):
            light = world.lights[j]
            exact = irradiance(light.centre, light.radius, s.position, s.normal)
            cone = sphere_cone(light.centre, light.radius, s.position)
            density = _ONE / (_TWO * _PI * cone)
            cosines = _ZERO
            base = wp.vec3d()
            shine = wp.vec3d()
            for i in range(count):
                u = turned(points[i], shift)
                w = to_local(frame, sphere_direction(light.centre, s.position, cone, u[0], u[1]))
                lobes = reflect(s, world.coat, out, w)
                if lobes.pdf > _ZERO:
                    cosines += w[2]
                    base += w[2] * lobes.diffuse
                    shine += (w[2] / (density + gloss_density(s, out, w))) * (lobes.whole - lobes.diffuse)
            # The diffuse base hardly varies: its mean over the light, times the irradiance in closed form.
            if cosines > _ZERO:
                sums[j - first] = (exact / cosines) * base + shine / wp.float64(count)

    @wp.func
    def by_gloss(
        world: World, s: Surface, out: wp.vec3d, points: wp.array(dtype=wp.vec2d), shift: wp.vec2d, first: wp.int32,
        last: wp.int32, sums: wp.array(dtype=wp.vec3d),
    ):  # fmt: skip
        frame = frame_of(s.normal)
        count = points.shape[0]
        for i in range(count):
            u = turned(points[i], shift)
            h = ggx_normal(out, s.roughness, u[0], u[1])
            w = _TWO * wp.dot(out, h) * h - out
            lobes = reflect(s, world.coat, out, w)
            if lobes.pdf > _ZERO:
                own = gloss_density(s, out, w)
                part = w[2] * (lobes.whole - lobes.diffuse) / wp.float64(count)
                ahead = to_world(frame, w)
                for j in range(first, last):
                    light = world.lights[j]
                    if sphere_hit(light.centre, light.radius, s.position, ahead) < _FAR:
                        density = _ONE / (_TWO * _PI * sphere_cone(light.centre, light.radius, s.position))
                        sums[j - first] = sums[j - first] + part / (own + density)

    @wp.func
    def fill(
        world: World, place: Place, s: Surface, out: wp.vec3d, points: wp.array(dtype=wp.vec2d), shift: wp.vec2d,
        radiance: wp.array(dtype=wp.vec3d),
    ):  # fmt: skip
        if wp.static(gloss):  # noqa: SIM102  (only a branch of its own is left out of the compiled code)
            if s.kind != _DIFFUSE:
                by_lights(world, s, out, points, shift, place.lights, place.lights_end, radiance)
                by_gloss(world, s, out, points, shift, place.lights, place.lights_end, radiance)
        for j in range(place.lights_end - place.lights):
            light = world.lights[place.lights + j]
            if s.kind == _DIFFUSE:
                radiance[j] = s.albedo * (irradiance(light.centre, light.radius, s.position, s.normal) / _PI)
            radiance[j] = wp.cw_mul(wp.cw_mul(radiance[j], light.radiance), s.through)

    return fill


@lru_cache(maxsize=2)
def known(gloss: bool) -> Any:
    """The kernel for scenes with or without glossy lobes: radiance by light, (B, L, 3), in the order of the scene."""
    fill = known_for(gloss)

    @wp.kernel(enable_backward=False, module="unique")
    def fill_all(
        first: wp.int32,
        world: World,
        surfaces: wp.array(dtype=Surface),
        points: wp.array(dtype=wp.vec2d),
        shifts: wp.array(dtype=wp.vec2d),
        radiance: wp.array2d(dtype=wp.vec3d),
    ):
        row = first + wp.tid()
        s = surfaces[row]
        if s.kind >= 0:
            out = to_local(frame_of(s.normal), s.outgoing)
            fill(world, world.places[s.scene], s, out, points, shifts[row], radiance[row])

    return fill_all
