"""The numbers of `direct_tokens` from passes that are kept, and the weighted sum behind the network.

The same tokens as `tokenize` with `lamp_tokens` gives, and the same sum as `inet.correct`, to rounding.
"""

from nqr_geom._warp import wp
from nqr_geom.render.direct_tokens import MANY, TYPICAL
from nqr_geom.render.kernels_bsdf import Surface
from nqr_geom.render.kernels_direct import World
from nqr_geom.render.kernels_lamps import Record

__all__ = ["Told", "told", "weighed"]

_ZERO = wp.constant(wp.float64(0.0))
_ONE = wp.constant(wp.float64(1.0))
_THREE = wp.constant(wp.float64(3.0))
_TYPICAL = wp.constant(wp.float64(TYPICAL))
_SHARPEST = wp.constant(wp.float64(1e12))
_MANY = wp.constant(wp.float64(MANY))
_LIMIT = wp.constant(wp.float64(16.0))
_LEAST_GROWTH = wp.constant(wp.float64(-30.0))
_NOTHING = wp.constant(wp.float64(1e-3))


@wp.struct
class Told:
    """What all samples of a lamp say together, and what is known of it."""

    expected: wp.vec3d  # what they would bring under the balance heuristic if nothing hid it
    arrived: wp.vec3d  # and what they bring
    ratio: wp.vec3d  # by which `direct-known` changes their weights
    log_ratio: wp.vec3d
    share: wp.vec3d  # of all known radiance
    log_share: wp.float64
    log_radius: wp.float64  # over the distance
    total: wp.float64
    shown: wp.float64
    squares: wp.float64
    number: wp.float64


@wp.func
def logarithm(ratio: wp.float64) -> wp.float64:
    return wp.log(wp.clamp(ratio, wp.float64(1e-6), wp.float64(1e6))) / _THREE


@wp.func
def logarithms(ratios: wp.vec3d) -> wp.vec3d:
    return wp.vec3d(logarithm(ratios[0]), logarithm(ratios[1]), logarithm(ratios[2]))


@wp.func
def over(part: wp.float64, whole: wp.float64, otherwise: wp.float64) -> wp.float64:
    if whole > _ZERO:
        return part / whole
    return otherwise


@wp.func
def each_over(part: wp.vec3d, whole: wp.vec3d, otherwise: wp.float64) -> wp.vec3d:
    return wp.vec3d(
        over(part[0], whole[0], otherwise), over(part[1], whole[1], otherwise), over(part[2], whole[2], otherwise)
    )


@wp.func
def mean_of(v: wp.vec3d) -> wp.float64:
    return (v[0] + v[1] + v[2]) / _THREE


@wp.func
def put(tokens: wp.array(dtype=wp.float32), at: wp.int32, value: wp.float64):
    tokens[at] = wp.float32(wp.where(wp.isnan(value), _ZERO, wp.clamp(value, -_LIMIT, _LIMIT)))


@wp.func
def put_three(tokens: wp.array(dtype=wp.float32), at: wp.int32, values: wp.vec3d):
    for c in range(3):
        put(tokens, at + c, values[c])


@wp.func
def compressed(value: wp.float64) -> wp.float64:
    """Of a number that is not negative."""
    return wp.log(_ONE + value)


@wp.kernel(enable_backward=False)
def told(
    first: wp.int32,
    world: World,
    surfaces: wp.array(dtype=Surface),
    n: wp.int32,
    all_known: wp.array2d(dtype=wp.vec3d),
    all_records: wp.array3d(dtype=Record),
    all_lights: wp.array2d(dtype=Told),
    low: wp.vec3d,
    high: wp.vec3d,
    tokens: wp.array3d(dtype=wp.float32),
    balanced: wp.array2d(dtype=wp.vec3d),
    bounded: wp.array2d(dtype=wp.vec3d),
    units: wp.array(dtype=wp.vec3d),
    steady: wp.array(dtype=wp.vec3d),
    inside: wp.array(dtype=wp.bool),
):
    """Tokens (B, 2 n, 28) of records, what weights multiply, and what `direct-known` says; `all_lights` are zero."""
    at = first + wp.tid()
    s = surfaces[at]
    known = all_known[at]
    records = all_records[at]
    lights = all_lights[at]
    place = world.places[s.scene]
    count = place.lights_end - place.lights
    if s.kind < 0:
        count = 0
        for i in range(n):
            for t in range(2):
                nothing = Record()
                nothing.light = wp.int32(-1)
                records[i, t] = nothing
    sizes = wp.vec3d()
    for i in range(n):
        for t in range(2):
            kept = records[i, t]
            if kept.light >= 0:
                one = kept.expected * (kept.weight / wp.float64(n))
                lights[kept.light].expected = lights[kept.light].expected + one
                lights[kept.light].arrived = lights[kept.light].arrived + one * kept.visible
                sizes += kept.expected * kept.visible
    unit = wp.vec3d(_ONE, _ONE, _ONE)
    for c in range(3):
        if sizes[c] > _ZERO:
            unit[c] = sizes[c] / wp.float64(2 * n)
    everything = wp.vec3d()
    expected = wp.vec3d()
    arrived = wp.vec3d()
    for j in range(count):
        everything += known[j]
        expected += lights[j].expected
        arrived += lights[j].arrived
    answer = wp.vec3d()
    for j in range(count):
        light = world.lights[place.lights + j]
        of = lights[j]
        of.ratio = each_over(known[j], of.expected, _ONE)
        answer += wp.cw_mul(of.ratio, of.arrived)
        of.log_ratio = logarithms(of.ratio)
        of.share = each_over(known[j], everything, _ZERO)
        of.log_share = logarithm(mean_of(of.share))
        of.log_radius = logarithm(over(light.radius, wp.length(light.centre - s.position), _TYPICAL))
        lights[j] = of
    met = wp.vec3d()
    every = wp.float64(0.0)
    seen = wp.float64(0.0)
    for i in range(n):
        for t in range(2):
            kept = records[i, t]
            j = kept.light
            if j >= 0:
                one = kept.expected * (kept.weight / wp.float64(n))
                bring = wp.cw_mul(one, lights[j].ratio)
                part = bring[0] + bring[1] + bring[2]
                lights[j].total = lights[j].total + part
                lights[j].shown = lights[j].shown + part * kept.visible
                lights[j].squares = lights[j].squares + part * part
                lights[j].number = lights[j].number + _ONE
                met += bring
                every += part
                seen += part * kept.visible
    for c in range(3):  # lamps that no sample has met are as visible as the others
        answer[c] = answer[c] + wp.max(everything[c] - met[c], _ZERO) * over(arrived[c], expected[c], _ZERO)
    steady[at] = answer
    missed = logarithms(each_over(everything, met, _ONE))
    shown_of_all = over(seen, every, _ZERO)
    brightness = logarithm(mean_of(everything) / mean_of(unit))
    size = wp.log(wp.float64(n) / wp.float64(32.0))
    within = wp.bool(True)
    for i in range(n):
        for t in range(2):
            kept = records[i, t]
            j = kept.light
            token = tokens[at][2 * i + t]
            pdf = kept.own
            nee = kept.other
            if t == 1:
                pdf = kept.other
                nee = kept.own
            of = Told()
            if j >= 0:
                of = lights[j]
            else:
                of.ratio = wp.vec3d(_ONE, _ONE, _ONE)
                of.log_radius = logarithm(_TYPICAL)
                of.log_share = logarithm(_ZERO)
            value = kept.expected * kept.visible
            scaled = wp.cw_div(value, unit)
            sharpness = wp.log(_ONE + wp.clamp(pdf, _ZERO, _SHARPEST))
            chosen = logarithm(wp.where(kept.chance > _ZERO, kept.chance, _ONE))
            within = within and low[0] <= sharpness and sharpness <= high[0]
            within = within and low[1] <= of.log_radius and of.log_radius <= high[1]
            within = within and low[2] <= chosen and chosen <= high[2]
            bring = wp.cw_mul(kept.expected * (kept.weight / wp.float64(n)), of.ratio)
            shown = over(of.shown, of.total, _ZERO)
            put(token, 0, size)
            put(token, 1, sharpness)
            put(token, 2, of.log_radius)
            put(token, 3, chosen)
            put(token, 4, wp.float64(1 - t))
            put(token, 5, wp.where(j >= 0, _ONE, _ZERO))
            put(token, 6, kept.visible)
            put(token, 7, kept.weight)
            put_three(token, 8, of.log_ratio)
            put_three(token, 11, of.share)
            put(token, 14, of.log_share)
            put(token, 15, over(bring[0] + bring[1] + bring[2], of.total, _ZERO))
            put(token, 16, shown)
            put(token, 17, over(of.squares, of.total * of.total, _ZERO))
            put(token, 18, logarithm(of.number / _MANY))
            put(token, 19, kept.visible * (kept.visible - shown))
            put_three(token, 20, missed)
            put(token, 23, shown_of_all)
            put(token, 24, logarithm(nee))
            put(token, 25, kept.diffuse)
            put(token, 26, compressed(kept.weight * mean_of(wp.cw_mul(of.ratio, scaled))))
            put(token, 27, brightness)
            balanced[at, 2 * i + t] = kept.weight * value
            least = wp.vec3d()
            for c in range(3):
                least[c] = value[c] * (unit[c] / wp.max(value[c], unit[c]))
            bounded[at, 2 * i + t] = least
    units[at] = unit
    inside[at] = within


@wp.kernel(enable_backward=False)
def weighed(
    first: wp.int32,
    n: wp.int32,
    outputs: wp.array3d(dtype=wp.float32),
    most: wp.float64,
    balanced: wp.array2d(dtype=wp.vec3d),
    bounded: wp.array2d(dtype=wp.vec3d),
    units: wp.array(dtype=wp.vec3d),
    learned: wp.array(dtype=wp.vec3d),
    safe: wp.array(dtype=wp.vec3d),
    gave_way: wp.array(dtype=wp.bool),
):
    """Sums by the weights that outputs g and h (B, 2 n, 6) stand for, and by the balance heuristic alone.

    Where the first is not positive it is the second one, and flagged if that is not nothing.
    """
    at = first + wp.tid()
    plain = wp.vec3d()
    mine = wp.vec3d()
    for i in range(balanced.shape[1]):
        plain += balanced[at, i]
        for c in range(3):
            growth = wp.clamp(wp.float64(outputs[at, i, c]), _LEAST_GROWTH, most)
            mine[c] = (
                mine[c] + wp.exp(growth) * balanced[at, i][c] + wp.float64(outputs[at, i, 3 + c]) * bounded[at, i][c]
            )
    plain = plain / wp.float64(n)
    mine = mine / wp.float64(n)
    positive = wp.bool(True)
    something = wp.bool(False)
    for c in range(3):
        positive = positive and mine[c] > _ZERO
        something = something or plain[c] > _NOTHING * units[at][c]
    if not positive:
        mine = plain
        gave_way[at] = something
    learned[at] = mine
    safe[at] = plain
