"""What a glossy lobe reflects of a sphere that nothing hides, inside kernels: a smooth integral over microfacet slopes.

By slopes t (cos phi, sin phi) of the normals h = (t cos phi, t sin phi, 1) the GGX density is a function of t alone,
and with t = a tan(beta) the radiance of a lobe of roughness a is, without a peaked factor left,

    G1(o) / (2 pi o_z)  int dphi int dbeta  sin(2 beta) F G1(w) (o.h)        w = 2 (o.h)/(h.h) h - o.

Points are Gauss's in tan(beta / 2), by which everything is rational or a root: no trigonometry along a ray.

Along a ray of slopes "w sees the sphere" and "w is above the surface" are quadratic in t, so that the limits of beta
come from roots; the rays that touch the sphere are roots of a quadratic form in (cos phi, sin phi). Slopes that reflect
to a sphere lie inside a conic (outside, if it hides the direction against the viewer), and those that reflect above
the surface in a circle. Between the angles where conic, circle and rays touch or meet, Gauss's rule does the rest.

References: Walter et al., Microfacet models for refraction through rough surfaces, 2007, for the densities; Heitz,
Dupuy, Hill, Neubelt, Real-time polygonal-light shading with linearly transformed cosines, 2016, approximate the same.
"""

from functools import lru_cache

import numpy as np

from nqr_geom._warp import wp
from nqr_geom.render.kernels_bsdf import Surface, fresnel, unmasked

__all__ = ["GAUSS", "gauss", "gauss_points", "gloss"]

GAUSS = 5  # points of a stretch of tan(beta / 2)


@lru_cache(maxsize=16)
def gauss_points(count: int) -> np.ndarray:
    """Gauss's rule on the unit interval: points and weights, (count, 2)."""
    node, weight = np.polynomial.legendre.leggauss(count)
    return np.column_stack([0.5 + 0.5 * node, 0.5 * weight])


_Points = wp.types.vector(length=GAUSS, dtype=wp.float64)
_NODES, _WEIGHTS = (wp.constant(_Points(*column)) for column in gauss_points(GAUSS).T.tolist())

_ZERO = wp.constant(wp.float64(0.0))
_HALF = wp.constant(wp.float64(0.5))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_THREE = wp.constant(wp.float64(3.0))
_SIX = wp.constant(wp.float64(6.0))
_EIGHT = wp.constant(wp.float64(8.0))
_PI = wp.constant(wp.float64(3.141592653589793))
_LONG = wp.constant(wp.int32(2))  # pieces of a stretch longer than 1/2 for one of another


@wp.func
def gauss(i: wp.int32) -> wp.vec2d:
    """One of `gauss_points(GAUSS)`."""
    return wp.vec2d(_NODES[i], _WEIGHTS[i])


@wp.struct
class Sight:
    """A viewer and a cone of directions in a shading frame."""

    out: wp.vec3d
    axis: wp.vec3d
    inside: wp.float64  # cosine of the mirror direction to the axis, less that of the half angle
    outside: wp.float64  # cosine of the half angle, less that of the direction against the viewer


@wp.struct
class Stretch:
    """Parts of a ray of slopes, the second beyond a hole; a part is empty unless it ends behind its start."""

    low: wp.float64
    high: wp.float64
    again: wp.float64
    end: wp.float64


@wp.func
def sight_of(out: wp.vec3d, axis: wp.vec3d, cone: wp.float64) -> Sight:
    """`cone` is 1 - cos of the half angle: differences keep the digits of a small one."""
    sight = Sight()
    sight.out = out
    sight.axis = axis
    off = wp.vec3d(-out[0], -out[1], out[2]) - axis
    sight.inside = cone - _HALF * wp.dot(off, off)
    sight.outside = _ONE - cone + wp.dot(out, axis)
    return sight


@wp.func
def quadratic(sight: Sight, x: wp.float64, y: wp.float64) -> wp.vec3d:
    """(h.h) (w.c - C), C of the half angle, along the slopes t (x, y): coefficients of t^2, 2t and 1."""
    a = sight.out[0] * x + sight.out[1] * y
    b = sight.axis[0] * x + sight.axis[1] * y
    return wp.vec3d(_TWO * a * b - sight.outside, a * sight.axis[2] + sight.out[2] * b, sight.inside)


@wp.func
def horizon(out: wp.vec3d, x: wp.float64, y: wp.float64) -> wp.float64:
    """The slope from which on directions lie below the surface."""
    a = out[0] * x + out[1] * y
    return (a + wp.sqrt(a * a + out[2] * out[2])) / out[2]


@wp.func
def stretch_of(sight: Sight, x: wp.float64, y: wp.float64) -> Stretch:
    """Slopes t (x, y) that reflect into the cone and above the surface."""
    part = Stretch()
    q = quadratic(sight, x, y)
    far = horizon(sight.out, x, y)
    discriminant = q[1] * q[1] - q[0] * q[2]
    root = wp.sqrt(wp.max(_ZERO, discriminant))
    part.high = far
    if q[2] >= _ZERO:  # the mirror direction lies inside: up to the way out, and from a way back in
        if discriminant > _ZERO:
            if q[0] < _ZERO:
                part.high = wp.where(q[1] > _ZERO, (q[1] + root) / -q[0], q[2] / (root - q[1]))
            elif q[1] < _ZERO:
                part.high = q[2] / (root - q[1])
                if q[0] > _ZERO:
                    part.again = (root - q[1]) / q[0]
                    part.end = far
    elif discriminant <= _ZERO or (q[0] <= _ZERO and q[1] <= _ZERO):
        part.high = _ZERO
    elif q[1] > _ZERO:
        part.low = -q[2] / (q[1] + root)
        if q[0] < _ZERO:
            part.high = (q[1] + root) / -q[0]
    else:
        part.low = (root - q[1]) / q[0]
    part.high = wp.min(part.high, far)
    return part


@wp.struct
class Fan:
    """Angles at which the integrand is not smooth, rising, and the frame that they are told in.

    The direction of angle psi is (cos psi) short + (sin psi) stretch long, normalized: short and long are axes.
    """

    angles: wp.vec4d
    count: wp.int32
    x: wp.float64  # of the long axis
    y: wp.float64
    stretch: wp.float64
    start: wp.float64  # angles lie in one turn from here
    parts: wp.int32  # into which to cut what lies between two angles
    closed: wp.bool  # goes all around: the peak lies in the cone, or all but a hole does


@wp.func
def turn_of(fan: Fan, x: wp.float64, y: wp.float64) -> wp.float64:
    return wp.atan2((x * fan.x + y * fan.y) / fan.stretch, x * fan.y - y * fan.x)


@wp.func
def with_angle(fan: Fan, x: wp.float64, y: wp.float64) -> Fan:
    """Insert the angle of a direction at its place."""
    psi = turn_of(fan, x, y) - fan.start
    psi = fan.start + psi - _TWO * _PI * wp.floor(psi / (_TWO * _PI))
    at = fan.count
    for k in range(4):
        i = fan.count - 1 - k
        if i >= 0 and at == i + 1 and fan.angles[i] > psi:
            fan.angles[at] = fan.angles[i]
            at = i
    fan.angles[at] = psi
    fan.count = fan.count + 1
    return fan


@wp.func
def waves(xx: wp.float64, yy: wp.float64, xy: wp.float64) -> wp.vec3d:
    """A quadratic form of (cos phi, sin phi) as mean + size cos(2 (phi - angle)); eigenvalues are mean +- size."""
    half = _HALF * (xx - yy)
    return wp.vec3d(_HALF * (xx + yy), wp.sqrt(half * half + xy * xy), _HALF * wp.atan2(xy, half))


@wp.func
def slant(sight: Sight) -> wp.vec2d:
    """The middle term of `quadratic` as a vector."""
    o = sight.out
    c = sight.axis
    return wp.vec2d(c[2] * o[0] + o[2] * c[0], c[2] * o[1] + o[2] * c[1])


@wp.func
def stretched(sight: Sight, alpha: wp.float64) -> Fan:
    """The frame in which the slopes of a cone are seen most evenly from the peak of the lobe.

    On an ellipse of half axes a, b around the peak the density, integrated along rays, is constant in psi.
    """
    o = sight.out
    c = sight.axis
    fan = Fan()
    fan.y = _ONE
    fan.stretch = _ONE
    fan.start = -_PI
    fan.parts = wp.int32(1)
    fan.closed = sight.inside >= _ZERO or sight.outside < _ZERO
    # Minus the form of t^2, which is positive definite for an ellipse.
    xx = sight.outside - _TWO * o[0] * c[0]
    yy = sight.outside - _TWO * o[1] * c[1]
    form = waves(xx, yy, -(o[0] * c[1] + o[1] * c[0]))
    low = form[0] - form[1]
    high = form[0] + form[1]
    if low > _ZERO:
        fan.x = -wp.sin(form[2])  # square to the direction of the larger eigenvalue
        fan.y = wp.cos(form[2])
        g = slant(sight)
        lengthwise = g[0] * fan.x + g[1] * fan.y
        across = g[0] * fan.y - g[1] * fan.x
        middle = sight.inside + lengthwise * lengthwise / low + across * across / high
        if middle > _ZERO:
            a2 = middle / low
            b2 = wp.max(middle, across * across / high) / high  # or how far off the peak lies
            fan.stretch = wp.sqrt((_ONE + alpha * alpha / b2) / (_ONE + alpha * alpha / a2))
            fan.stretch = wp.max(fan.stretch, _ONE)
    return fan


@wp.func
def fan_of(sight: Sight, alpha: wp.float64) -> Fan:
    """Where rays of slopes touch a cone that does not hold the mirror direction, and where the surface cuts it."""
    fan = stretched(sight, alpha)
    o = sight.out
    c = sight.axis
    if not fan.closed:  # cut it open on the far side of the middle
        x = c[0] + o[0]
        y = c[1] + o[1]
        fan.start = turn_of(fan, x, y) - _PI
    if sight.inside < _ZERO or sight.outside < _ZERO:
        # Rays touch the cone where the discriminant of `quadratic` is zero.
        g = slant(sight)
        xx = g[0] * g[0] - sight.inside * (_TWO * o[0] * c[0] - sight.outside)
        yy = g[1] * g[1] - sight.inside * (_TWO * o[1] * c[1] - sight.outside)
        form = waves(xx, yy, g[0] * g[1] - sight.inside * (o[0] * c[1] + o[1] * c[0]))
        if form[1] > wp.abs(form[0]):
            away = _HALF * wp.acos(-form[0] / form[1])
            for k in range(2):
                phi = form[2] + (wp.float64(2 * k) - _ONE) * away
                x = wp.cos(phi)
                y = wp.sin(phi)
                slanted = g[0] * x + g[1] * y
                if slanted * sight.inside > _ZERO:  # it touches on the other side
                    x = -x
                    y = -y
                if wp.abs(sight.inside) < horizon(o, x, y) * wp.abs(slanted):
                    fan = with_angle(fan, x, y)
    cosine = sight.outside - wp.dot(o, c)
    across = wp.sqrt(c[0] * c[0] + c[1] * c[1])
    if across > wp.abs(cosine):  # the surface cuts the cone
        middle = wp.atan2(c[1], c[0])
        away = wp.acos(cosine / across)
        fan.parts = wp.int32(2)  # hardest, and rare
        for k in range(2):
            phi = middle + (wp.float64(2 * k) - _ONE) * away
            fan = with_angle(fan, wp.cos(phi) + o[0], wp.sin(phi) + o[1])
    return fan


@wp.func
def half_tangent(t: wp.float64, alpha: wp.float64) -> wp.float64:
    """tan(beta / 2) of a slope t = alpha tan(beta), which may be infinite."""
    if t > alpha:
        cotangent = alpha / t
        return _ONE / (cotangent + wp.sqrt(cotangent * cotangent + _ONE))
    return t / (alpha + wp.sqrt(alpha * alpha + t * t))


@wp.func
def along(
    s: Surface, out: wp.vec3d, x: wp.float64, y: wp.float64, first: wp.float64, last: wp.float64, pieces: wp.int32
) -> wp.vec3d:
    """Integral over slopes a tan(beta) in the direction (x, y), tan(beta / 2) from `first` to `last`."""
    total = wp.vec3d()
    parts = wp.where(last - first > _HALF, _LONG * pieces, pieces)
    size = (last - first) / wp.float64(parts)
    for piece in range(parts):
        for i in range(GAUSS):
            point = gauss(i)
            tangent = first + size * (wp.float64(piece) + point[0])
            slope = _TWO * s.roughness * tangent
            h = wp.vec3d(slope * x, slope * y, _ONE - tangent * tangent)
            square = wp.dot(h, h)
            seen = wp.dot(out, h)
            w = (_TWO * seen / square) * h - out
            if w[2] > _ZERO:
                below = _ONE + tangent * tangent  # sin(2 beta) dbeta / h_z is 8 tangent dtangent / below^3
                weight = size * point[1] * tangent / (below * below * below) * seen * unmasked(w, s.roughness)
                total += weight * fresnel(s, wp.min(seen / wp.sqrt(square), _ONE))
    return _EIGHT * total


@wp.func
def gloss(s: Surface, out: wp.vec3d, axis: wp.vec3d, cone: wp.float64, points: wp.array(dtype=wp.vec2d)) -> wp.vec3d:
    """Radiance towards `out` by the glossy lobe, of a sphere of radiance 1 whose cone is not tiny.

    Parameters
    ----------
    s : Surface
        Not diffuse.
    out, axis : vec3d
        To the viewer and to the middle of the sphere, in the shading frame.
    cone : float64
        1 - cos of the half angle under which the sphere is seen; 2 inside it.
    points : array of vec2d
        From `gauss_points`: rays of slopes between any two angles at which the
        integrand is not smooth. Every ray has GAUSS points for each dozen of rays.
    """
    rays = points.shape[0]
    sight = sight_of(out, axis, cone)
    fan = fan_of(sight, s.roughness)
    smooth = fan.closed and fan.count == 0
    spans = wp.where(fan.closed, wp.max(1, fan.count), wp.max(0, fan.count - 1))
    total = wp.vec3d()
    for part in range(spans * fan.parts):
        span = part / fan.parts
        begin = fan.angles[span]
        end = begin + _TWO * _PI
        if span + 1 < fan.count:
            end = fan.angles[span + 1]
        elif span > 0:
            end = fan.angles[0] + _TWO * _PI
        size = (end - begin) / wp.float64(fan.parts)
        begin += wp.float64(part - span * fan.parts) * size
        for k in range(rays):
            psi = _TWO * _PI * wp.float64(k) / wp.float64(rays)
            weight = _TWO * _PI / wp.float64(rays)
            if not smooth:
                u = points[k][0]
                psi = begin + size * u * u * (_THREE - _TWO * u)
                weight = size * points[k][1] * _SIX * u * (_ONE - u)
            cosine = wp.cos(psi)
            sine = fan.stretch * wp.sin(psi)
            square = cosine * cosine + sine * sine
            weight = weight * fan.stretch / square
            x = (cosine * fan.y + sine * fan.x) / wp.sqrt(square)
            y = (sine * fan.y - cosine * fan.x) / wp.sqrt(square)
            seen = stretch_of(sight, x, y)
            for side in range(2):
                first = wp.where(side == 0, seen.low, seen.again)
                last = wp.where(side == 0, seen.high, seen.end)
                if first < last:
                    first = half_tangent(first, s.roughness)
                    last = half_tangent(last, s.roughness)
                    total += weight * along(s, out, x, y, first, last, (rays + 11) / 12)
    return total * (unmasked(out, s.roughness) / (_TWO * _PI * out[2]))
