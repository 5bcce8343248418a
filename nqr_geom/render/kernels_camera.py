"""What each camera ray meets first."""

from nqr_geom._warp import wp
from nqr_geom.render.kernels_direct import World, first_light, single
from nqr_geom.render.kernels_light import sphere_hit

__all__ = ["meet"]

_ZERO = wp.constant(wp.float64(0.0))
_FAR = wp.constant(wp.float64(1e299))
_BOUND = wp.constant(wp.float64(2.0))  # radius of a sphere that holds all surfaces, which fit into [-1, 1]^3


@wp.kernel(enable_backward=False)
def meet(
    first: wp.int32,
    world: World,
    scene: wp.int32,
    origin: wp.vec3d,
    directions: wp.array(dtype=wp.vec3d),
    kind: wp.array(dtype=wp.int32),
    index: wp.array(dtype=wp.int32),
    distance: wp.array(dtype=wp.float64),
):
    """Kind 0 is a triangle, 1 a sphere, 2 a light, -1 nothing; `index` its number in the world."""
    row = first + wp.tid()
    place = world.places[scene]
    w = directions[row]
    nearest = _FAR
    what = wp.int32(-1)
    which = wp.int32(-1)
    # Triangles are looked for in float32: the ray starts where it enters the scene, so that it keeps its digits.
    start = _ZERO
    if wp.length(origin) > _BOUND:
        start = sphere_hit(wp.vec3d(), _BOUND, origin, w)
    if place.mesh != wp.uint64(0) and start < _FAR:
        hit = wp.mesh_query_ray(place.mesh, single(origin + start * w), single(w), wp.float32(4.0))
        if hit.result:
            nearest = start + wp.float64(hit.t)
            what = 0
            which = hit.face
    for j in range(place.balls, place.balls_end):
        t = sphere_hit(world.balls[j].centre, world.balls[j].radius, origin, w)
        if t < nearest:
            nearest = t
            what = 1
            which = j
    light = first_light(world, place, origin, w)
    if light.light >= 0 and light.chance < nearest:
        nearest = light.chance
        what = 2
        which = light.light
    kind[row] = what
    index[row] = which
    distance[row] = nearest
