"""Spherical lights inside kernels: a direction by solid angle, a choice of light by importance, the exact irradiance.

The tree of lights is walked as Conty Estevez and Kulla do (Importance sampling of many lights with adaptive tree
splitting, 2018), for lights that shine the same in all directions: a branch counts by its power, its distance and an
upper bound of the cosine at the surface. The irradiance of a sphere that the horizon may cut: Snyder, Area light
sources for real-time graphics, 1996.
"""

from nqr_geom._warp import wp

__all__ = [
    "Light",
    "Node",
    "chance_of",
    "choose",
    "importance",
    "irradiance",
    "sphere_cone",
    "sphere_direction",
    "sphere_hit",
]

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_PI = wp.constant(wp.float64(3.141592653589793))
_FAR = wp.constant(wp.float64(1e300))


@wp.struct
class Light:
    """A sphere that shines `radiance` in all directions; `leaf` is its node in the tree."""

    centre: wp.vec3d
    radiance: wp.vec3d
    radius: wp.float64
    leaf: wp.int32
    padding: wp.int32


@wp.struct
class Node:
    """A sphere around some lights with their power in red, green, blue and luminance. A leaf has no child (-1)."""

    centre: wp.vec3d
    power: wp.vec4d
    radius: wp.float64
    child: wp.int32  # the left one; the right one is the next
    parent: wp.int32
    light: wp.int32
    padding: wp.int32


@wp.struct
class Chosen:
    """A light (-1 is none) and the chance with which it was chosen."""

    light: wp.int32
    chance: wp.float64


@wp.func
def sphere_hit(centre: wp.vec3d, radius: wp.float64, p: wp.vec3d, w: wp.vec3d) -> wp.float64:
    """Distance along w to a sphere, or a huge number. From inside it is the far wall.

    The form with the product of both roots keeps its digits where the sphere is small and far.
    """
    away = centre - p
    along = wp.dot(away, w)
    across = away - along * w
    discriminant = radius * radius - wp.dot(across, across)
    if discriminant < _ZERO:
        return _FAR
    root = wp.sqrt(discriminant)
    outside = wp.dot(away, away) - radius * radius
    if outside <= _ZERO:
        return along + root
    if along <= _ZERO:
        return _FAR
    return outside / (along + root)


@wp.func
def sphere_cone(centre: wp.vec3d, radius: wp.float64, p: wp.vec3d) -> wp.float64:
    """1 - cos of the half angle under which p sees a sphere; 2 inside it."""
    away = centre - p
    s2 = radius * radius / wp.dot(away, away)
    if not (s2 < _ONE):
        return _TWO
    return wp.max(s2 / (_ONE + wp.sqrt(_ONE - s2)), wp.float64(1e-290))


@wp.func
def sphere_direction(centre: wp.vec3d, p: wp.vec3d, cone: wp.float64, u: wp.float64, v: wp.float64) -> wp.vec3d:
    """A uniform direction in the cone around the direction to `centre`."""
    away = centre - p
    length = wp.length(away)
    axis = wp.vec3d(_ZERO, _ZERO, _ONE)
    if length > _ZERO:
        axis = away / length
    below = u * cone  # 1 - cos, small where the light is
    sine = wp.sqrt(wp.max(_ZERO, below * (_TWO - below)))
    phi = _TWO * _PI * v
    sign = wp.where(axis[2] < _ZERO, -_ONE, _ONE)
    a = -_ONE / (sign + axis[2])
    b = axis[0] * axis[1] * a
    s = wp.vec3d(_ONE + sign * axis[0] * axis[0] * a, sign * b, -sign * axis[0])
    t = wp.vec3d(b, sign + axis[1] * axis[1] * a, -axis[1])
    return wp.normalize(sine * wp.cos(phi) * s + sine * wp.sin(phi) * t + (_ONE - below) * axis)


@wp.func
def importance(node: Node, p: wp.vec3d, n: wp.vec3d) -> wp.float64:
    """Bound of what a branch sends to a surface, without its power."""
    away = node.centre - p
    d2 = wp.dot(away, away)
    r2 = node.radius * node.radius
    if d2 <= r2:
        return _ONE / r2
    d = wp.sqrt(d2)
    cosine = wp.clamp(wp.dot(away, n) / d, -_ONE, _ONE)
    sine_r = node.radius / d
    cosine_r = wp.sqrt(_ONE - sine_r * sine_r)
    bound = _ONE
    if cosine < cosine_r:
        bound = wp.max(_ZERO, cosine * cosine_r + wp.sqrt(_ONE - cosine * cosine) * sine_r)
    return bound / d2


@wp.func
def choose(nodes: wp.array(dtype=Node), root: wp.int32, p: wp.vec3d, n: wp.vec3d, u: wp.float64) -> Chosen:
    """Walk down the tree, at every fork by the importance of the two branches; u is stretched and used again."""
    chosen = Chosen()
    chosen.light = wp.int32(-1)
    chosen.chance = _ONE
    at = root
    rest = u
    while nodes[at].child >= 0:
        left = nodes[at].child
        a = nodes[left].power[3] * importance(nodes[left], p, n)
        b = nodes[left + 1].power[3] * importance(nodes[left + 1], p, n)
        if not (a + b > _ZERO):
            return chosen
        part = a / (a + b)
        if rest < part:
            rest = rest / part
            chosen.chance = chosen.chance * part
            at = left
        else:
            rest = (rest - part) / (_ONE - part)
            chosen.chance = chosen.chance * (b / (a + b))
            at = left + 1
    chosen.light = nodes[at].light
    return chosen


@wp.func
def chance_of(nodes: wp.array(dtype=Node), leaf: wp.int32, p: wp.vec3d, n: wp.vec3d) -> wp.vec4d:
    """Chance that `choose` gives this leaf, by power in red, green, blue and luminance."""
    chance = wp.vec4d(_ONE, _ONE, _ONE, _ONE)
    at = leaf
    while nodes[at].parent >= 0:
        left = nodes[nodes[at].parent].child
        other = left + left + 1 - at
        own = importance(nodes[at], p, n)
        its = importance(nodes[other], p, n)
        for c in range(4):
            a = nodes[at].power[c] * own
            b = nodes[other].power[c] * its
            if a + b > _ZERO:
                chance[c] = chance[c] * (a / (a + b))
            else:
                chance[c] = _ZERO
        at = nodes[at].parent
    return chance


@wp.func
def irradiance(centre: wp.vec3d, radius: wp.float64, p: wp.vec3d, n: wp.vec3d) -> wp.float64:
    """Irradiance at p from a sphere of radiance 1 that nothing hides but the horizon, in [0, pi]."""
    away = centre - p
    d2 = wp.dot(away, away)
    s2 = radius * radius / d2
    if not (s2 < _ONE):
        return _PI
    cosine = wp.dot(away, n) / wp.sqrt(d2)
    s = wp.sqrt(s2)
    if cosine >= s:
        return _PI * s2 * cosine
    if cosine <= -s:
        return _ZERO
    sine = wp.sqrt(wp.max(_ZERO, _ONE - cosine * cosine))
    x = wp.sqrt((_ONE - s2) / s2)
    y = -x * cosine / sine
    root = wp.sqrt(wp.max(_ZERO, _ONE - y * y))
    cut = s2 * (cosine * wp.acos(wp.clamp(y, -_ONE, _ONE)) - x * sine * root) + wp.atan(sine * root / x)
    return wp.max(_ZERO, cut)


@wp.func
def luminous_chance_of(nodes: wp.array(dtype=Node), leaf: wp.int32, p: wp.vec3d, n: wp.vec3d) -> wp.float64:
    """The last of `chance_of`."""
    chance = wp.float64(1.0)
    at = leaf
    while nodes[at].parent >= 0:
        left = nodes[nodes[at].parent].child
        other = left + left + 1 - at
        a = nodes[at].power[3] * importance(nodes[at], p, n)
        b = nodes[other].power[3] * importance(nodes[other], p, n)
        if not (a > _ZERO):
            return _ZERO
        chance = chance * (a / (a + b))
        at = nodes[at].parent
    return chance
