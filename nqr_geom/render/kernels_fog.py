"""How much light a scene's medium lets through, inside kernels: closed form or marched, by what it is."""

from functools import cache
from typing import Any

from nqr_geom._warp import wp
from nqr_geom.render.kernels_bsdf import Surface
from nqr_geom.render.kernels_density import components
from nqr_geom.render.kernels_direct import Place, World

__all__ = ["STEPS", "camera_fog", "fog"]

STEPS = 64  # midpoints along the part of a ray inside a medium's box: the same for all, so that x decides the value

_COUNT = wp.constant(wp.float64(STEPS))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))


@wp.func
def stretch(world: World, place: Place, q: wp.vec3d, w: wp.vec3d, distance: wp.float64) -> wp.vec2d:
    """Where a ray enters and leaves the medium's box; the end comes first where it misses."""
    size = world.medium.size[place.volume]
    near = _ZERO
    far = distance
    for c in range(3):
        if w[c] == _ZERO:
            if q[c] < _ZERO or q[c] > size[c]:
                far = -_ONE
        else:
            a = -q[c] / w[c]
            b = (size[c] - q[c]) / w[c]
            near = wp.max(near, wp.min(a, b))
            far = wp.min(far, wp.max(a, b))
    return wp.vec2d(near, far)


@cache
def fog(kind: str, noisy: bool) -> Any:
    """The function (world, place, p, w, distance) -> (transmittance, density queries) of a kind of medium."""
    density = components(kind, noisy)
    constant = kind == "homogeneous" and not noisy

    @wp.func
    def through(world: World, place: Place, p: wp.vec3d, w: wp.vec3d, distance: wp.float64) -> wp.vec2d:
        if place.volume < 0:
            return wp.vec2d(_ONE, _ZERO)
        q = place.scale * p + place.corner
        ends = stretch(world, place, q, w, place.scale * distance)
        length = ends[1] - ends[0]
        if length <= _ZERO:
            return wp.vec2d(_ONE, _ZERO)
        most = world.medium.density[place.volume]
        if wp.static(constant):
            return wp.vec2d(wp.exp(-most * length), _ZERO)
        step = length / _COUNT
        total = _ZERO
        for i in range(wp.static(STEPS)):
            at = q + (ends[0] + (wp.float64(i) + wp.float64(0.5)) * step) * w
            u, _g, _n, _s, _b, _e = density(world.medium, place.volume, at, w)
            total += u
        return wp.vec2d(wp.exp(-most * total * step), _COUNT)

    return through


@cache
def camera_fog(kind: str, noisy: bool) -> Any:
    """Kernel that weakens what the camera sees."""
    through = fog(kind, noisy)

    @wp.kernel(enable_backward=False, module="unique")
    def weaken(first: wp.int32, world: World, surfaces: wp.array(dtype=Surface), origin: wp.vec3d):
        row = first + wp.tid()
        s = surfaces[row]
        if s.kind >= 0:
            away = s.position - origin
            kept = through(world, world.places[s.scene], origin, -s.outgoing, wp.length(away))[0]
            s.through = wp.vec3d(kept, kept, kept)
            surfaces[row] = s

    return weaken
