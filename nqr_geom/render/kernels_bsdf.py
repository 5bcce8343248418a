"""How surfaces reflect, inside kernels: Lambert, GGX conductors, and plastic (a diffuse base under a GGX coat).

Directions are in the shading frame, z along the normal, both away from the surface. Everything is float64: a GGX lobe
of width 1e-4 has no digits to spare. References: Walter et al., Microfacet models for refraction through rough
surfaces, 2007; Heitz, Sampling the GGX distribution of visible normals, 2018; Kelemen and Szirmay-Kalos, A microfacet
based coupled specular-matte BRDF model, 2001 (the energy that the coat lets through, in place of Fresnel terms, keeps
plastic reciprocal and makes it conserve energy exactly).
"""

from nqr_geom._warp import wp

__all__ = [
    "Frame",
    "Lobes",
    "Surface",
    "albedo_of",
    "frame_of",
    "reflect_any",
    "reflect_diffuse",
    "to_local",
    "to_world",
]

_ZERO = wp.constant(wp.float64(0.0))
_HALF = wp.constant(wp.float64(0.5))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_PI = wp.constant(wp.float64(3.141592653589793))

DIFFUSE, CONDUCTOR, PLASTIC = 0, 1, 2
_CONDUCTOR = wp.constant(wp.int32(CONDUCTOR))
_PLASTIC = wp.constant(wp.int32(PLASTIC))


@wp.struct
class Surface:
    """What one pixel sees: where, how it is oriented and how it reflects. `kind` -1 sees nothing."""

    position: wp.vec3d
    geometric: wp.vec3d  # unit normals on the viewer's side
    normal: wp.vec3d
    outgoing: wp.vec3d  # unit, towards the viewer
    albedo: wp.vec3d  # of the diffuse part
    eta: wp.vec3d  # of a conductor; of plastic, the coat's index of refraction in all three
    k: wp.vec3d
    roughness: wp.float64
    transmitted: wp.float64  # of plastic: hemispherical transmittance of the coat
    through: wp.vec3d  # transmittance from the surface to the camera
    kind: wp.int32
    table: wp.int32
    scene: wp.int32
    face: wp.int32


@wp.struct
class Frame:
    """An orthonormal frame around a normal."""

    s: wp.vec3d
    t: wp.vec3d
    n: wp.vec3d


@wp.struct
class Lobes:
    """A surface's reflection between two directions: f of the diffuse part, f of all, density of sampling by it."""

    diffuse: wp.vec3d
    whole: wp.vec3d
    pdf: wp.float64


@wp.func
def frame_of(n: wp.vec3d) -> Frame:
    """Duff et al., Building an orthonormal basis, revisited, 2017."""
    sign = wp.where(n[2] < _ZERO, -_ONE, _ONE)
    a = -_ONE / (sign + n[2])
    b = n[0] * n[1] * a
    frame = Frame()
    frame.s = wp.vec3d(_ONE + sign * n[0] * n[0] * a, sign * b, -sign * n[0])
    frame.t = wp.vec3d(b, sign + n[1] * n[1] * a, -n[1])
    frame.n = n
    return frame


@wp.func
def to_local(frame: Frame, w: wp.vec3d) -> wp.vec3d:
    return wp.vec3d(wp.dot(frame.s, w), wp.dot(frame.t, w), wp.dot(frame.n, w))


@wp.func
def to_world(frame: Frame, w: wp.vec3d) -> wp.vec3d:
    return frame.s * w[0] + frame.t * w[1] + frame.n * w[2]


@wp.func
def ggx(h: wp.vec3d, alpha: wp.float64) -> wp.float64:
    """Density of microfacet normals; the sine comes from x and y, which keeps its digits near the pole."""
    part = (h[0] * h[0] + h[1] * h[1]) / (alpha * alpha) + h[2] * h[2]
    return _ONE / (_PI * alpha * alpha * part * part)


@wp.func
def unmasked(w: wp.vec3d, alpha: wp.float64) -> wp.float64:
    """Smith's G1: the part of the microfacets that is seen from w."""
    return _TWO * w[2] / (w[2] + wp.sqrt(w[2] * w[2] + alpha * alpha * (w[0] * w[0] + w[1] * w[1])))


@wp.func
def ggx_normal(out: wp.vec3d, alpha: wp.float64, u: wp.float64, v: wp.float64) -> wp.vec3d:
    """A microfacet normal by its visible area from `out`: a uniform point on a spherical cap (Dupuy, Benyoub 2023)."""
    stretched = wp.normalize(wp.vec3d(alpha * out[0], alpha * out[1], out[2]))
    phi = _TWO * _PI * u
    z = (_ONE - v) * (_ONE + stretched[2]) - stretched[2]
    radius = wp.sqrt(wp.max(_ZERO, (_ONE - z) * (_ONE + z)))
    cap = wp.vec3d(radius * wp.cos(phi), radius * wp.sin(phi), z) + stretched
    return wp.normalize(wp.vec3d(alpha * cap[0], alpha * cap[1], wp.max(cap[2], wp.float64(1e-300))))


@wp.func
def fresnel_conductor(cosine: wp.float64, eta: wp.float64, k: wp.float64) -> wp.float64:
    """Unpolarised reflectance of a metal with complex index eta + ik, seen from a vacuum."""
    c2 = cosine * cosine
    s2 = _ONE - c2
    t0 = eta * eta - k * k - s2
    ab = wp.sqrt(t0 * t0 + wp.float64(4.0) * eta * eta * k * k)
    a = wp.sqrt(wp.max(_ZERO, _HALF * (ab + t0)))
    t1 = ab + c2
    t2 = _TWO * a * cosine
    t3 = c2 * ab + s2 * s2
    # Half of (t1 - t2) / (t1 + t2), the part square to the plane, times 1 + (t3 - t4) / (t3 + t4), t4 = t2 s2.
    return (t1 - t2) * t3 / ((t1 + t2) * (t3 + t2 * s2))


@wp.func
def fresnel_dielectric(cosine: wp.float64, eta: wp.float64) -> wp.float64:
    """Unpolarised reflectance of a dielectric, eta > 1, from outside."""
    inside = wp.sqrt(wp.max(_ZERO, _ONE - (_ONE - cosine * cosine) / (eta * eta)))
    p = (eta * cosine - inside) / (eta * cosine + inside)
    s = (cosine - eta * inside) / (cosine + eta * inside)
    return _HALF * (p * p + s * s)


@wp.func
def fresnel(s: Surface, cosine: wp.float64) -> wp.vec3d:
    """Reflectance of a conductor, or of the coat of plastic."""
    if s.kind == _CONDUCTOR:
        return wp.vec3d(
            fresnel_conductor(cosine, s.eta[0], s.k[0]),
            fresnel_conductor(cosine, s.eta[1], s.k[1]),
            fresnel_conductor(cosine, s.eta[2], s.k[2]),
        )
    f = fresnel_dielectric(cosine, s.eta[0])
    return wp.vec3d(f, f, f)


@wp.func
def luminance(c: wp.vec3d) -> wp.float64:
    """Rec. 709."""
    return wp.float64(0.2126) * c[0] + wp.float64(0.7152) * c[1] + wp.float64(0.0722) * c[2]


@wp.func
def albedo_of(coat: wp.array2d(dtype=wp.float64), table: wp.int32, cosine: wp.float64) -> wp.float64:
    """Directional albedo of a coat, linear between the nodes of its table."""
    last = coat.shape[1] - 1
    x = wp.clamp(cosine, _ZERO, _ONE) * wp.float64(last)
    i = wp.min(wp.int32(x), last - 1)
    part = x - wp.float64(i)
    return (_ONE - part) * coat[table, i] + part * coat[table, i + 1]


@wp.func
def cosine_direction(u: wp.float64, v: wp.float64) -> wp.vec3d:
    """A direction by its cosine to the normal."""
    radius = wp.sqrt(u)
    phi = _TWO * _PI * v
    return wp.vec3d(radius * wp.cos(phi), radius * wp.sin(phi), wp.sqrt(_ONE - u))


@wp.func
def reflect_diffuse(s: Surface, coat: wp.array2d(dtype=wp.float64), out: wp.vec3d, w: wp.vec3d) -> Lobes:
    """The only lobe there is in a scene without gloss."""
    lobes = Lobes()
    if w[2] > _ZERO:
        lobes.diffuse = s.albedo / _PI
        lobes.whole = lobes.diffuse
        lobes.pdf = w[2] / _PI
    return lobes


@wp.func
def sample_diffuse(
    s: Surface, coat: wp.array2d(dtype=wp.float64), out: wp.vec3d, lobe: wp.float64, u: wp.float64, v: wp.float64
) -> wp.vec3d:
    return cosine_direction(u, v)


@wp.func
def gloss_chance(s: Surface, coat: wp.array2d(dtype=wp.float64), out: wp.vec3d) -> wp.float64:
    """Chance of sampling plastic by its coat: its part of what the viewer gets."""
    mirrored = albedo_of(coat, s.table, out[2])
    return mirrored / (mirrored + (_ONE - mirrored) * luminance(s.albedo))


@wp.func
def reflect_any(s: Surface, coat: wp.array2d(dtype=wp.float64), out: wp.vec3d, w: wp.vec3d) -> Lobes:
    """Any of the materials."""
    lobes = Lobes()
    if w[2] <= _ZERO or out[2] <= _ZERO:
        return lobes
    gloss = _ONE
    if s.kind != _CONDUCTOR:
        lobes.diffuse = s.albedo / _PI
        lobes.pdf = w[2] / _PI
        gloss = _ZERO
    if s.kind == _PLASTIC:
        enters = _ONE - albedo_of(coat, s.table, w[2])
        leaves = _ONE - albedo_of(coat, s.table, out[2])
        lobes.diffuse = lobes.diffuse * (enters * leaves / s.transmitted)
        gloss = gloss_chance(s, coat, out)
        lobes.pdf = lobes.pdf * (_ONE - gloss)
    lobes.whole = lobes.diffuse
    if gloss > _ZERO:
        h = wp.normalize(w + out)
        cosine = wp.min(wp.dot(h, out), _ONE)
        masked = unmasked(out, s.roughness) * ggx(h, s.roughness) / (wp.float64(4.0) * out[2])
        lobes.pdf += gloss * masked
        lobes.whole += (masked * unmasked(w, s.roughness) / w[2]) * fresnel(s, cosine)
    return lobes


@wp.func
def sample_any(
    s: Surface, coat: wp.array2d(dtype=wp.float64), out: wp.vec3d, lobe: wp.float64, u: wp.float64, v: wp.float64
) -> wp.vec3d:
    """A direction by the material; it may lie below the surface, where nothing is reflected."""
    gloss = wp.where(s.kind == _CONDUCTOR, _ONE, _ZERO)
    if s.kind == _PLASTIC:
        gloss = gloss_chance(s, coat, out)
    if lobe < gloss:
        h = ggx_normal(out, s.roughness, u, v)
        return _TWO * wp.dot(out, h) * h - out
    return cosine_direction(u, v)
