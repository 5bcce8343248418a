"""The sampling network of direct light in kernels: what it knows of lamps, and a round of passes by its densities.

The numbers of `LampSlabs`, `GridHead` and `sight_tokens`, to the rounding of the network's single precision.
"""

from functools import lru_cache
from typing import Any

from nqr_geom._warp import wp
from nqr_geom.render.direct_slabs import FAINT, KINDS, SIGHT_TOKENS, SLABS, LampSlabs
from nqr_geom.render.kernels_bsdf import Surface, frame_of, to_local
from nqr_geom.render.kernels_direct import OFFSET, World, one_pass_for
from nqr_geom.render.kernels_known import known_for
from nqr_geom.render.kernels_lamps import Lamp, Record, doubt, note, record, survey
from nqr_geom.render.kernels_numbers import Numbers, coordinate, shuffle
from nqr_geom.render.kernels_tokens import compressed, logarithm, put

__all__ = ["CONTEXT", "SIGHT", "TABLE", "begin", "place"]

CONTEXT = LampSlabs.context  # of a pixel
SIGHT = 1 + SIGHT_TOKENS.size  # of a technique's sample: its round's size and its tokens
CELLS = SLABS**3
TABLE = SLABS + SLABS**2 + CELLS  # probabilities of slabs, of columns and of cells
OCTAVES = 5

_OFFSET = wp.constant(wp.float64(OFFSET))
_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_TWO = wp.constant(wp.float64(2.0))
_PI = wp.constant(wp.float64(3.141592653589793))
_FAINT = wp.constant(wp.float64(FAINT))
_BELOW_ONE = wp.constant(wp.float64(1.0 - 2.0**-53))
_LARGEST = wp.constant(wp.float64(16.0))
_EIGHT = wp.constant(wp.int32(SLABS))
_SIZE = wp.constant(wp.float64(SLABS))
_OCTAVES = wp.constant(wp.int32(OCTAVES))
_CELLS = wp.constant(wp.float64(CELLS))
_KINDS = wp.constant(wp.int32(KINDS))


@wp.func
def slab_density(lamps: wp.array(dtype=Lamp), count: wp.int32, slab: wp.int32, doubtful: wp.bool) -> wp.float64:
    """Logarithm of a slab's density by the worth of lamps, or by that and their doubt."""
    total = wp.float64(0.0)
    density = wp.float64(0.0)
    for j in range(count):
        lamp = lamps[j]
        worth = lamp.worth
        if doubtful:
            worth = worth * doubt(lamp.visible, lamp.number)
        total += worth
        if lamp.length > _ZERO:
            inside = wp.min(wp.float64(slab + 1) / _SIZE, lamp.low + lamp.length)
            inside = inside - wp.max(wp.float64(slab) / _SIZE, lamp.low)
            density += worth * (_SIZE * wp.max(_ZERO, inside) / lamp.length)
    if total > _ZERO:
        return wp.log(density / total + _FAINT)
    return _ZERO


@lru_cache(maxsize=2)
def begin(gloss: bool) -> Any:
    """The kernel that fills in what is known before the first round, in scenes with or without glossy lobes."""
    fill = known_for(gloss)

    @wp.kernel(enable_backward=False, module="unique")
    def begun(
        first: wp.int32,
        world: World,
        surfaces: wp.array(dtype=Surface),
        points: wp.array(dtype=wp.vec2d),
        known: wp.array2d(dtype=wp.vec3d),
        all_lamps: wp.array2d(dtype=Lamp),
        context: wp.array2d(dtype=wp.float32),
    ):
        at = first + wp.tid()
        s = surfaces[at]
        for k in range(context.shape[1]):
            context[at, k] = wp.float32(0.0)
        if s.kind >= 0:
            place = world.places[s.scene]
            fill(world, place, s, to_local(frame_of(s.normal), s.outgoing), points, known[at])
            lamps = all_lamps[at]
            survey(world, s, known[at], lamps)
            for slab in range(_EIGHT):
                context[at, slab] = wp.float32(
                    slab_density(lamps, place.lights_end - place.lights, slab, wp.bool(False))
                )
            context[at, 2 * _EIGHT + s.kind] = wp.float32(1.0)
        context[at, 2 * _EIGHT + _KINDS] = wp.float32(wp.log(wp.clamp(s.roughness, wp.float64(1e-3), _ONE)))

    return begun


@wp.func
def chosen(of: wp.array(dtype=wp.float32), first: wp.int32, u: wp.float64) -> wp.vec2d:
    """One of eight from `first` on, drawn by inversion, and what u left over."""
    total = wp.float64(0.0)
    for k in range(_EIGHT):
        total += wp.float64(of[first + k])
    index = wp.int32(0)
    below = wp.float64(0.0)
    mass = wp.float64(of[first])
    while index < _EIGHT - 1 and below + mass <= u * total:
        index += 1
        below += mass
        mass = wp.float64(of[first + index])
    rest = wp.clamp((u * total - below) / wp.max(mass, wp.float64(1e-300)), _ZERO, _BELOW_ONE)
    return wp.vec2d(wp.float64(index), rest)


@wp.func
def inverted(of: wp.array(dtype=wp.float32), u: wp.vec3d) -> wp.vec3d:
    """The point of a density with 8 x 8 x 8 cells that stands for three numbers; `of` holds its sums, see `TABLE`."""
    x = wp.vec3d()
    first = wp.int32(0)  # of this axis
    cell = wp.int32(0)
    stride = wp.int32(_EIGHT)
    for axis in range(3):
        found = chosen(of, first + cell * _EIGHT, u[axis])
        x[axis] = wp.min((found[0] + found[1]) / _SIZE, _BELOW_ONE)
        cell = cell * _EIGHT + wp.int32(found[0])
        first += stride
        stride = stride * _EIGHT
    return x


@wp.func
def density_at(of: wp.array(dtype=wp.float32), x: wp.vec3d) -> wp.float64:
    """Density at a point."""
    cell = wp.int32(0)
    for axis in range(3):
        cell = cell * _EIGHT + wp.min(wp.int32(x[axis] * _SIZE), _EIGHT - 1)
    return wp.float64(of[_EIGHT + _EIGHT * _EIGHT + cell]) * _CELLS


@wp.func
def write_sight(
    token: wp.array(dtype=wp.float32), kept: Record, t: wp.int32, x: wp.vec3d, known: wp.vec3d, unit: wp.float64,
    size: wp.float64,
):  # fmt: skip
    """What the sampling network reads of a sample, in the order of `sight_tokens`."""
    put(token, 0, size)
    for axis in range(3):
        sine = wp.sin(_PI * x[axis])
        cosine = wp.cos(_PI * x[axis])
        for k in range(_OCTAVES):
            put(token, 1 + axis * _OCTAVES + k, sine)
            put(token, 1 + (3 + axis) * _OCTAVES + k, cosine)
            doubled = _TWO * sine * cosine
            cosine = _ONE - _TWO * sine * sine
            sine = doubled
    at = 1 + 6 * _OCTAVES
    hit = wp.where(kept.light >= 0, _ONE, _ZERO)
    expected = (kept.expected[0] + kept.expected[1] + kept.expected[2]) / unit
    put(token, at, hit)
    put(token, at + 1, hit * kept.visible)
    put(token, at + 2, wp.min(kept.weight, _LARGEST))
    put(token, at + 3, compressed(kept.weight * expected))
    put(token, at + 4, compressed(kept.weight * expected * kept.visible))
    put(token, at + 5, compressed(hit * (known[0] + known[1] + known[2]) / unit))
    put(token, at + 6, logarithm(wp.where(t == 0, kept.other, kept.own)))
    put(token, at + 7, logarithm(wp.where(t == 0, kept.own, kept.other)))
    put(token, at + 8, kept.diffuse)


@lru_cache(maxsize=64)
def place(shadows: bool, gloss: bool, selection: bool, medium: tuple[str, bool] | None = None) -> Any:
    """The kernel of a round of passes, for a scene with these effects, made once."""
    one_pass = one_pass_for(shadows, gloss, selection, medium)

    @wp.kernel(enable_backward=False, module="unique")
    def placed(
        first: wp.int32,
        world: World,
        surfaces: wp.array(dtype=Surface),
        rows: wp.array(dtype=wp.int64),
        numbers: Numbers,
        begun: wp.int32,
        count: wp.int32,
        table: wp.array3d(dtype=wp.float32),
        all_known: wp.array2d(dtype=wp.vec3d),
        all_lamps: wp.array2d(dtype=Lamp),
        all_records: wp.array3d(dtype=Record),
        context: wp.array2d(dtype=wp.float32),
        tokens: wp.array3d(dtype=wp.float32),
        rays: wp.array2d(dtype=wp.int32),
    ):
        """Passes `begun` to `begun` + `count` of each pixel; their tokens unless they are the last ones."""
        at = first + wp.tid()
        s = surfaces[at]
        lamps = all_lamps[at]
        known = all_known[at]
        place = world.places[s.scene]
        lights = place.lights_end - place.lights
        out = to_local(frame_of(s.normal), s.outgoing)
        start = s.position + _OFFSET * s.geometric
        shuffle(numbers, at, rows[at], count)
        unit = wp.float64(0.0)
        if s.kind >= 0:
            for j in range(lights):
                unit += known[j][0] + known[j][1] + known[j][2]
        if not (unit > _ZERO):
            unit = _ONE
        size = wp.log(wp.float64(count) / wp.float64(32.0))
        by_material = table[at][0]
        by_lamp = table[at][1]
        for i in range(count):
            u = wp.vec3d(
                coordinate(numbers, at, rows[at], i, 0), coordinate(numbers, at, rows[at], i, 1),
                coordinate(numbers, at, rows[at], i, 2),
            )  # fmt: skip
            v = wp.vec3d(
                coordinate(numbers, at, rows[at], i, 3), coordinate(numbers, at, rows[at], i, 4),
                coordinate(numbers, at, rows[at], i, 5),
            )  # fmt: skip
            x = inverted(by_material, u)
            y = inverted(by_lamp, v)
            one = Record()
            two = Record()
            one.light = wp.int32(-1)
            two.light = wp.int32(-1)
            if s.kind >= 0:
                made = one_pass(world, place, s, out, start, x[0], x[1], x[2], y[0], y[1], y[2])
                rays[at, 0] = rays[at, 0] + made.bsdf.rays
                rays[at, 1] = rays[at, 1] + made.nee.rays
                rays[at, 2] = rays[at, 2] + made.bsdf.marched + made.nee.marched
                one = record(made.bsdf, world, s.through, place.lights)
                two = record(made.nee, world, s.through, place.lights)
                one.weight = one.weight / density_at(by_material, x)
                two.weight = two.weight / density_at(by_lamp, y)
                note(lamps, one)
                note(lamps, two)
            all_records[at, begun + i, 0] = one
            all_records[at, begun + i, 1] = two
            if tokens.shape[1] > 0:
                of_one = wp.vec3d()
                of_two = wp.vec3d()
                if one.light >= 0:
                    of_one = known[one.light]
                if two.light >= 0:
                    of_two = known[two.light]
                write_sight(tokens[at][2 * i], one, 0, wp.vec3d(x[2], x[0], x[1]), of_one, unit, size)
                write_sight(tokens[at][2 * i + 1], two, 1, y, of_two, unit, size)
        if s.kind >= 0 and tokens.shape[1] > 0:
            for slab in range(_EIGHT):
                changed = wp.float32(slab_density(lamps, lights, slab, wp.bool(True)))
                context[at, _EIGHT + slab] = changed - context[at, slab]

    return placed
