"""The densities of all kinds of volumes as Warp functions, put together from the effects that a volume has.

A kernel that is built on `components(kind, noisy)` holds no branch for another kind, and no noise where there is none.
"""

from functools import cache

from nqr_geom._warp import wp

__all__ = ["Packed", "components", "trilinear"]


@wp.struct
class Packed:
    """S volumes of one kind; every length is in their common unit, every position relative to a box's low corner."""

    size: wp.array(dtype=wp.vec3d)  # (S,) of the box
    density: wp.array(dtype=wp.float64)  # (S,) where u = 1
    parts: wp.array3d(dtype=wp.float64)  # (S, K, 8)
    count: wp.array(dtype=wp.int32)  # (S,) parts that are there
    values: wp.array(dtype=wp.float64)  # grids, one after the other
    offset: wp.array(dtype=wp.int64)  # (S,) where a grid begins
    nodes: wp.array2d(dtype=wp.int32)  # (S, 3) of a grid
    noise: wp.array2d(dtype=wp.float64)  # (S, 6): amplitude, frequency, gain, lacunarity, bound, always
    octaves: wp.array2d(dtype=wp.int32)  # (S, 2): octaves, seed


@wp.func
def _at(m: Packed, v: int, i: int, j: int, k: int) -> wp.float64:
    return m.values[m.offset[v] + wp.int64((i * m.nodes[v, 1] + j) * m.nodes[v, 2] + k)]


@wp.func
def _cell(place: wp.float64, size: wp.float64, nodes: int) -> wp.float64:
    """A coordinate in units of a grid's cells, inside the grid."""
    last = wp.float64(nodes - 1)
    return wp.clamp(place / size * last, wp.float64(0.0), last)


@wp.func
def trilinear(m: Packed, v: int, p: wp.vec3d) -> wp.vec4d:
    """A grid's value and gradient at p; a grid of one layer does not depend on z."""
    one = wp.float64(1.0)
    n = m.nodes[v, 2]
    x, y = _cell(p[0], m.size[v][0], m.nodes[v, 0]), _cell(p[1], m.size[v][1], m.nodes[v, 1])
    z = _cell(p[2], m.size[v][2], n)
    i = wp.min(int(x), m.nodes[v, 0] - 2)
    j = wp.min(int(y), m.nodes[v, 1] - 2)
    k = wp.max(wp.min(int(z), n - 2), 0)
    up = wp.min(k + 1, n - 1)
    x, y, z = x - wp.float64(i), y - wp.float64(j), z - wp.float64(k)
    a, b = _at(m, v, i, j, k), _at(m, v, i, j, up)
    c, d = _at(m, v, i, j + 1, k), _at(m, v, i, j + 1, up)
    e, f = _at(m, v, i + 1, j, k), _at(m, v, i + 1, j, up)
    g, h = _at(m, v, i + 1, j + 1, k), _at(m, v, i + 1, j + 1, up)
    ac, bd, eg, fh = a + y * (c - a), b + y * (d - b), e + y * (g - e), f + y * (h - f)
    ae, bf, cg, dh = a + x * (e - a), b + x * (f - b), c + x * (g - c), d + x * (h - d)
    low, high = ac + x * (eg - ac), bd + x * (fh - bd)
    along_x = (one - z) * (eg - ac) + z * (fh - bd)
    along_y = (one - z) * (cg - ae) + z * (dh - bf)
    cells = wp.vec3d(
        wp.float64(m.nodes[v, 0] - 1) / m.size[v][0],
        wp.float64(m.nodes[v, 1] - 1) / m.size[v][1],
        wp.float64(n - 1) / m.size[v][2],
    )
    return wp.vec4d(low + z * (high - low), along_x * cells[0], along_y * cells[1], (high - low) * cells[2])


# Geometry: u_geo at p, its slope along d, and half its second derivative along d. Where one ball is nearest u_geo is a
# quadratic, so that one point tells it along the whole chord.


@wp.func
def _homogeneous(m: Packed, v: int, p: wp.vec3d, d: wp.vec3d) -> wp.vec3d:
    return wp.vec3d()


@wp.func
def _grid(m: Packed, v: int, p: wp.vec3d, d: wp.vec3d) -> wp.vec3d:
    u = trilinear(m, v, p)
    slope = -(u[1] * d[0] + u[2] * d[1] + u[3] * d[2])
    return wp.vec3d(wp.float64(1.0) - u[0], slope, wp.float64(0.0))


@wp.func
def _spheres(m: Packed, v: int, p: wp.vec3d, d: wp.vec3d) -> wp.vec3d:
    nearest = wp.float64(1.0e300)
    along = wp.float64(0.0)
    bend = wp.float64(0.0)
    for k in range(m.count[v]):
        away = p - wp.vec3d(m.parts[v, k, 0], m.parts[v, k, 1], m.parts[v, k, 2])
        inverse = wp.float64(1.0) / (m.parts[v, k, 3] * m.parts[v, k, 3])
        square = wp.dot(away, away) * inverse
        if square < nearest:
            nearest, along, bend = square, wp.dot(away, d) * inverse, inverse
    return wp.vec3d(nearest, wp.float64(2.0) * along, bend)


@wp.func
def _torus(m: Packed, v: int, p: wp.vec3d, d: wp.vec3d) -> wp.vec3d:
    away = p - wp.vec3d(m.parts[v, 0, 0], m.parts[v, 0, 1], m.parts[v, 0, 2])
    axis = wp.vec3d(m.parts[v, 0, 3], m.parts[v, 0, 4], m.parts[v, 0, 5])
    major = wp.float64(m.parts[v, 0, 6])
    inverse = wp.float64(1.0) / (m.parts[v, 0, 7] * m.parts[v, 0, 7])
    height, climb = wp.dot(away, axis), wp.dot(d, axis)
    flat, turn = away - height * axis, d - climb * axis
    radius = wp.max(wp.length(flat), wp.float64(1.0e-150))
    outward = wp.dot(flat, turn) / radius
    curl = (wp.dot(turn, turn) - outward * outward) / radius
    apart = radius - major
    slope = wp.float64(2.0) * (apart * outward + height * climb)
    bend = outward * outward + apart * curl + climb * climb
    if bend < wp.float64(0.0):
        # Two sides of the ring are nearly as near as each other, which ends soon: a downward bend carried on would be a
        # shape where there is none. The ball around the nearest point of the ring is one that is there.
        bend = wp.float64(1.0)
    return inverse * wp.vec3d(apart * apart + height * height, slope, bend)


@wp.func
def _extrusion(m: Packed, v: int, p: wp.vec3d, d: wp.vec3d) -> wp.vec3d:
    middle, half, radius = m.parts[v, 0, 0], m.parts[v, 0, 1], m.parts[v, 0, 2]
    inverse = wp.float64(1.0) / (radius * radius)
    zero = wp.float64(0.0)
    outline = trilinear(m, v, p)
    height = p[2] - middle
    aside, over = wp.max(outline[0], zero), wp.max(wp.abs(height) - half, zero)
    outward, climb = zero, zero
    if aside > zero:
        outward = outline[1] * d[0] + outline[2] * d[1]
    if over > zero:
        climb = wp.sign(height) * d[2]
    slope = wp.float64(2.0) * (aside * outward + over * climb)
    return inverse * wp.vec3d(aside * aside + over * over, slope, outward * outward + climb * climb)


_GEOMETRY = {
    "homogeneous": _homogeneous,
    "grid": _grid,
    "spheres": _spheres,
    "torus": _torus,
    "extrusion": _extrusion,
}


@wp.func
def _fbm(m: Packed, v: int, p: wp.vec3d) -> wp.float64:
    """Sum of octaves; the noise itself is single precision, at places relative to the box."""
    total = wp.float64(0.0)
    amplitude = wp.float64(m.noise[v, 0])
    frequency = wp.float64(m.noise[v, 1])
    for k in range(m.octaves[v, 0]):
        at = p * frequency
        place = wp.vec3(float(at[0]), float(at[1]), float(at[2]))
        total += amplitude * wp.float64(wp.noise(wp.rand_init(m.octaves[v, 1], k), place))
        amplitude = amplitude * m.noise[v, 2]
        frequency = frequency * m.noise[v, 3]
    return total


@cache
def components(kind: str, noisy: bool):
    """The function (volumes, v, p, d) -> (u, u_geo, u_fBm, slope, bend, 1 if noise was evaluated) of a kind of volume.

    Noise is evaluated only where some value of it could make the density positive, or always if the volume says so.
    """
    geometry = _GEOMETRY[kind]

    if not noisy:

        @wp.func
        def smooth(m: Packed, v: int, p: wp.vec3d, d: wp.vec3d):
            zero = wp.float64(0.0)
            g = geometry(m, v, p, d)
            u = wp.clamp(wp.float64(1.0) - g[0], zero, wp.float64(1.0))
            return u, g[0], zero, g[1], g[2], 0

        return smooth

    @wp.func
    def rough(m: Packed, v: int, p: wp.vec3d, d: wp.vec3d):
        one = wp.float64(1.0)
        g = geometry(m, v, p, d)
        noise = wp.float64(0.0)
        evaluated = wp.int32(0)
        matters = g[0] < one + m.noise[v, 4]
        if matters or m.noise[v, 5] > wp.float64(0.0):
            noise = _fbm(m, v, p)
            evaluated = 1
        if not matters:
            noise = wp.float64(0.0)
        return wp.clamp(one - g[0] + noise, wp.float64(0.0), one), g[0], noise, g[1], g[2], evaluated

    return rough
