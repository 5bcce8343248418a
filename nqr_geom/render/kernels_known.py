"""What each light would send to the viewer by one reflection if nothing hid it, inside kernels: no ray is traced.

On a diffuse surface that is closed form. The base of plastic hardly varies over a light: some points tell its mean.
Glossy lobes are integrated over slopes (`kernels_gloss`), but for lights so small that no lobe varies over them.
"""

from functools import lru_cache
from typing import Any

from nqr_geom._warp import wp
from nqr_geom.render import kernels_bsdf
from nqr_geom.render.kernels_bsdf import Surface, frame_of, to_local, to_world
from nqr_geom.render.kernels_direct import Place, World
from nqr_geom.render.kernels_gloss import GAUSS, gauss
from nqr_geom.render.kernels_gloss import gloss as reflected
from nqr_geom.render.kernels_light import importance, irradiance, sphere_cone

__all__ = ["known", "known_for", "span_of", "spans"]

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_PI = wp.constant(wp.float64(3.141592653589793))
_TINY = wp.constant(wp.float64(1e-10))  # cones below are too small for differences, and for a lobe to vary over them
_DIFFUSE = wp.constant(wp.int32(kernels_bsdf.DIFFUSE))
_PLASTIC = wp.constant(wp.int32(kernels_bsdf.PLASTIC))


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
    def by_points(
        s: Surface, coat: wp.array2d(dtype=wp.float64), out: wp.vec3d, axis: wp.vec3d, cone: wp.float64,
        exact: wp.float64, rays: wp.int32,
    ):  # fmt: skip
        """Reflected radiance of a light of radiance 1: its irradiance in closed form times the mean reflection."""
        frame = frame_of(axis)
        cosines = _ZERO
        sums = wp.vec3d()
        for i in range(GAUSS):
            point = gauss(i)
            below = point[0] * cone
            sine = wp.sqrt(wp.max(_ZERO, below * (_TWO - below)))
            for k in range(rays):
                phi = _TWO * _PI * (wp.float64(k) + point[0]) / wp.float64(rays)
                w = to_world(frame, wp.vec3d(sine * wp.cos(phi), sine * wp.sin(phi), _ONE - below))
                if w[2] > _ZERO:
                    lobes = reflect(s, coat, out, w)
                    cosines += point[1] * w[2]
                    if cone < _TINY:
                        sums += (point[1] * w[2]) * lobes.whole
                    else:
                        sums += (point[1] * w[2]) * lobes.diffuse
        if cosines > _ZERO:
            sums = (exact / cosines) * sums
        return sums

    @wp.func
    def fill(
        world: World, place: Place, s: Surface, out: wp.vec3d, points: wp.array(dtype=wp.vec2d),
        radiance: wp.array(dtype=wp.vec3d),
    ):  # fmt: skip
        for j in range(place.lights_end - place.lights):
            light = world.lights[place.lights + j]
            exact = irradiance(light.centre, light.radius, s.position, s.normal)
            seen = s.albedo * (exact / _PI)
            if wp.static(gloss):  # noqa: SIM102  (only a branch of its own is left out of the compiled code)
                if s.kind != _DIFFUSE:
                    seen = wp.vec3d()
                    cone = sphere_cone(light.centre, light.radius, s.position)
                    axis = to_local(frame_of(s.normal), light.centre - s.position)
                    length = wp.length(axis)
                    axis = wp.where(length > _ZERO, axis / length, wp.vec3d(_ZERO, _ZERO, _ONE))
                    if exact > _ZERO and out[2] > _ZERO:
                        if s.kind == _PLASTIC or cone < _TINY:
                            seen = by_points(s, world.coat, out, axis, cone, exact, points.shape[0] / 2)
                        if not (cone < _TINY):
                            seen += reflected(s, out, axis, cone, points)
            radiance[j] = wp.cw_mul(wp.cw_mul(seen, light.radiance), s.through)

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
        radiance: wp.array2d(dtype=wp.vec3d),
    ):
        row = first + wp.tid()
        s = surfaces[row]
        if s.kind >= 0:
            out = to_local(frame_of(s.normal), s.outgoing)
            fill(world, world.places[s.scene], s, out, points, radiance[row])

    return fill_all
