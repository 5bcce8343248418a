"""Passes of direct light by "random", "pmj" or "lamp-spread" that are kept until a row is full, and `direct-known`.

The same numbers as sampler and rule one after the other.
"""

from functools import lru_cache
from typing import Any

from nqr_geom._warp import wp
from nqr_geom.keyed_warp import mixed, unit
from nqr_geom.render import kernels_bsdf
from nqr_geom.render.kernels_bsdf import Surface, frame_of, to_local
from nqr_geom.render.kernels_direct import OFFSET, Sample, World, one_pass_for
from nqr_geom.render.kernels_fused import balance
from nqr_geom.render.kernels_known import known_for, span_of
from nqr_geom.render.kernels_numbers import Numbers, coordinate, owen, shuffle

__all__ = ["Lamp", "Record", "Rounds", "doubt", "kernel", "note", "record", "survey"]

_OFFSET = wp.constant(wp.float64(OFFSET))
_ZERO = wp.constant(wp.float64(0.0))
_HALF = wp.constant(wp.float64(0.5))
_ONE = wp.constant(wp.float64(1.0))
_THREE = wp.constant(wp.float64(3.0))
_TINY = wp.constant(wp.float64(1e-300))
_BELOW_ONE = wp.constant(wp.float64(1.0 - 2.0**-53))
_LAMPS = wp.constant(wp.int64(4096))


@wp.struct
class Lamp:
    """What is kept of a light while a row's samples are placed and added up."""

    expected: wp.vec3d
    shown: wp.vec3d
    worth: wp.float64
    low: wp.float64
    length: wp.float64
    share: wp.float64
    number: wp.float64  # samples that could see it
    visible: wp.float64  # sum of their visibilities
    taken: wp.int32
    padding: wp.int32


@wp.struct
class Record:
    """What is kept of a sample until it is known how many each lamp got."""

    expected: wp.vec3d
    visible: wp.float64
    own: wp.float64
    other: wp.float64
    weight: wp.float64  # by the balance heuristic, as if lamps were chosen by the tree
    chance: wp.float64
    diffuse: wp.float64  # mean part of the diffuse lobe
    light: wp.int32
    padding: wp.int32


@wp.struct
class Rounds:
    """Keys and sizes of the rounds of "lamp-spread"; of no use to the others."""

    start_0: wp.uint64
    start_1: wp.uint64
    key: wp.uint64
    scramble: wp.uint64
    early: wp.int32
    even: wp.float64


@wp.func
def record(s: Sample, world: World, through: wp.vec3d, first: wp.int32) -> Record:
    kept = Record()
    kept.light = wp.int32(-1)
    if s.light >= 0:
        kept.light = s.light - first
        kept.expected = wp.cw_mul(wp.cw_mul(s.f, world.lights[s.light].radiance) * s.lambert, through)
    kept.own = s.own
    kept.other = s.other
    kept.weight = balance(s)
    kept.visible = s.visible
    kept.chance = s.chance
    kept.diffuse = (s.share[0] + s.share[1] + s.share[2]) / _THREE
    return kept


@wp.func
def spread_weight(kept: Record, t: wp.int32, lamp: Lamp, n: wp.int32) -> wp.float64:
    """The balance heuristic's weight where a lamp's samples are as dense as their number says."""
    density = _ZERO
    if lamp.length > _ZERO:
        density = wp.float64(lamp.taken) / (wp.float64(n) * wp.max(lamp.length, _TINY))
    both = kept.own + kept.other * density
    if t == 1:
        both = kept.own * density + kept.other
    if both > _ZERO:
        return kept.own / both
    return _ZERO


@wp.func
def survey(world: World, s: Surface, known: wp.array(dtype=wp.vec3d), lamps: wp.array(dtype=Lamp)):
    """Fill in where axis 3 chooses each lamp, and what it is worth."""
    place = world.places[s.scene]
    for j in range(place.lights_end - place.lights):
        span = span_of(world, s, place.lights + j)
        lamps[j].low = span[0]
        lamps[j].length = span[1]
        if span[1] > _ZERO:
            lamps[j].worth = kernels_bsdf.luminance(known[j])


@wp.func
def note(lamps: wp.array(dtype=Lamp), kept: Record):
    """Count a sample for its lamp's doubt."""
    if kept.light >= 0 and kept.expected[0] + kept.expected[1] + kept.expected[2] > _ZERO:
        lamps[kept.light].number = lamps[kept.light].number + _ONE
        lamps[kept.light].visible = lamps[kept.light].visible + kept.visible


@wp.func
def doubt(visible: wp.float64, number: wp.float64) -> wp.float64:
    """Standard deviation of a lamp's visibility, as `direct_slabs.lamp_doubt`."""
    shown = (visible + _HALF) / (number + _ONE)
    return wp.sqrt(wp.max(_ZERO, shown * (_ONE - shown)))


@wp.func
def share_out(lamps: wp.array(dtype=Lamp), count: wp.int32, later: wp.bool, even: wp.float64) -> wp.float64:
    """Fill in the share of each lamp in a round; their sum."""
    total = wp.float64(0.0)
    for j in range(count):
        worth = lamps[j].worth
        if later:
            worth = worth * doubt(lamps[j].visible, lamps[j].number)
        lamps[j].share = worth
        total += worth
    given = wp.float64(0.0)
    for j in range(count):
        if total > _ZERO:
            lamps[j].share = (_ONE - even) * lamps[j].share / total
        else:
            lamps[j].share = _ZERO
        given += lamps[j].share
    total = _ZERO
    for j in range(count):
        lamps[j].share = lamps[j].share + (_ONE - given) * lamps[j].length
        total += lamps[j].share
    return total


@wp.func
def pick(lamps: wp.array(dtype=Lamp), count: wp.int32, at: wp.float64) -> wp.int32:
    """The lamp in whose share a number lies."""
    below = wp.float64(0.0)
    for j in range(count):
        below += lamps[j].share
        if below > at:
            return j
    return wp.max(count - 1, 0)


@lru_cache(maxsize=64)
def kernel(
    answers: bool, spread: bool, shadows: bool, gloss: bool, selection: bool, medium: tuple[str, bool] | None = None
) -> Any:
    """The kernel that draws n passes of each pixel in a scene with these effects, and keeps them; made once.

    With `answers` it goes on to what `direct-known` makes of them, else it only weighs them by the balance heuristic.
    """
    one_pass = one_pass_for(shadows, gloss, selection, medium)
    fill = known_for(gloss)

    @wp.func
    def on_lamp(rounds: Rounds, numbers: Numbers, row: wp.int64, lamp: wp.int32, rank: wp.int32, axis: wp.int32):
        """Coordinate of point `rank` of a lamp's own sequence."""
        of = row * _LAMPS + wp.int64(lamp)
        scramble = wp.uint32(mixed(mixed(rounds.scramble, of), wp.int64(axis)))
        digits = owen(numbers.sobol[rank, axis], scramble)
        u = unit(mixed(mixed(mixed(rounds.key, of), wp.int64(rank)), wp.int64(axis)))
        return wp.min((wp.float64(digits) + u) * wp.float64(2.3283064365386963e-10), _BELOW_ONE)

    @wp.kernel(enable_backward=False, module="unique")
    def drawn(
        first: wp.int32,
        world: World,
        surfaces: wp.array(dtype=Surface),
        rows: wp.array(dtype=wp.int64),
        points: wp.array(dtype=wp.vec2d),
        known: wp.array2d(dtype=wp.vec3d),
        all_lamps: wp.array2d(dtype=Lamp),
        records: wp.array3d(dtype=Record),
        numbers: Numbers,
        rounds: Rounds,
        n: wp.int32,
        mean: wp.array(dtype=wp.vec3d),
        rays: wp.array2d(dtype=wp.int32),
    ):
        at = first + wp.tid()
        s = surfaces[at]
        if s.kind >= 0:
            row = rows[at]
            place = world.places[s.scene]
            count = place.lights_end - place.lights
            out = to_local(frame_of(s.normal), s.outgoing)
            start = s.position + _OFFSET * s.geometric
            shuffle(numbers, at, row, n)
            lamps = all_lamps[at]
            fill(world, place, s, out, points, known[at])
            if wp.static(spread):
                survey(world, s, known[at], lamps)
            total = wp.float64(0.0)
            base = wp.float64(0.0)
            begun = wp.int32(0)
            size = wp.int32(0)
            for i in range(n):
                u3 = coordinate(numbers, at, row, i, 3)
                u4 = _ZERO
                u5 = _ZERO
                if wp.static(spread):
                    if i == 0:
                        size = rounds.early
                        total = share_out(lamps, count, False, rounds.even)
                        base = unit(mixed(rounds.start_0, row))
                    if i == rounds.early:
                        begun = rounds.early
                        size = n - rounds.early
                        total = share_out(lamps, count, True, rounds.even)
                        base = unit(mixed(rounds.start_1, row))
                    lamp = pick(lamps, count, (wp.float64(i - begun) + base) / wp.float64(size) * total)
                    rank = lamps[lamp].taken
                    lamps[lamp].taken = rank + 1
                    u3 = wp.min(lamps[lamp].low + lamps[lamp].length * u3, _BELOW_ONE)
                    u4 = on_lamp(rounds, numbers, row, lamp, rank, 0)
                    u5 = on_lamp(rounds, numbers, row, lamp, rank, 1)
                else:
                    u4 = coordinate(numbers, at, row, i, 4)
                    u5 = coordinate(numbers, at, row, i, 5)
                made = one_pass(
                    world, place, s, out, start,
                    coordinate(numbers, at, row, i, 0), coordinate(numbers, at, row, i, 1),
                    coordinate(numbers, at, row, i, 2), u3, u4, u5,
                )  # fmt: skip
                rays[at, 0] = rays[at, 0] + made.bsdf.rays
                rays[at, 1] = rays[at, 1] + made.nee.rays
                rays[at, 2] = rays[at, 2] + made.bsdf.marched + made.nee.marched
                for t in range(2):
                    sample = made.bsdf
                    if t == 1:
                        sample = made.nee
                    kept = record(sample, world, s.through, place.lights)
                    if wp.static(spread):
                        note(lamps, kept)
                    records[at, i, t] = kept
            if wp.static(answers):
                every = wp.vec3d()
                seen = wp.vec3d()
                for i in range(n):
                    for t in range(2):
                        kept = records[at, i, t]
                        if kept.light >= 0:
                            weight = kept.weight
                            if wp.static(spread):
                                weight = spread_weight(kept, t, lamps[kept.light], n)
                            part = kept.expected * (weight / wp.float64(n))
                            lamps[kept.light].expected = lamps[kept.light].expected + part
                            lamps[kept.light].shown = lamps[kept.light].shown + part * kept.visible
                            every += part
                            seen += part * kept.visible
                answer = wp.vec3d()
                for c in range(3):
                    value = wp.float64(0.0)
                    missed = wp.float64(0.0)
                    for j in range(count):
                        expected = lamps[j].expected
                        shown = lamps[j].shown
                        if expected[c] > _ZERO:
                            value += known[at, j][c] * (shown[c] / expected[c])
                        else:
                            missed += known[at, j][c]
                    if every[c] > _ZERO:
                        value += missed * (seen[c] / every[c])
                    answer[c] = value
                mean[at] = answer
            elif wp.static(spread):
                for i in range(n):
                    for t in range(2):
                        one = records[at, i, t]
                        if one.light >= 0:
                            one.weight = spread_weight(one, t, lamps[one.light], n)
                            records[at, i, t] = one

    return drawn
