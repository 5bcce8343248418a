"""The points of the samplers "random" and "pmj" in six dimensions, inside kernels."""

from functools import lru_cache

import numpy as np

from nqr_geom._warp import array, wp
from nqr_geom.keyed_warp import mixed, unit, unsigned
from nqr_geom.streams import Stream

__all__ = ["Numbers", "coordinate", "numbers", "shuffle"]

DIM = 6
_BELOW_ONE = wp.constant(wp.float64(1.0 - 2.0**-53))


@wp.struct
class Numbers:
    """Keys of a sampler's streams. `order` is scratch, (rows, 2, power of two >= n); empty for random points."""

    key: wp.uint64
    scramble: wp.uint64
    shuffle_2: wp.uint64
    shuffle_4: wp.uint64
    sobol: wp.array2d(dtype=wp.uint32)
    order: wp.array3d(dtype=wp.int32)
    pmj: wp.bool


@wp.func
def reversed_bits(value: wp.uint32) -> wp.uint32:
    x = value
    x = ((x & wp.uint32(0x55555555)) << wp.uint32(1)) | ((x >> wp.uint32(1)) & wp.uint32(0x55555555))
    x = ((x & wp.uint32(0x33333333)) << wp.uint32(2)) | ((x >> wp.uint32(2)) & wp.uint32(0x33333333))
    x = ((x & wp.uint32(0x0F0F0F0F)) << wp.uint32(4)) | ((x >> wp.uint32(4)) & wp.uint32(0x0F0F0F0F))
    x = ((x & wp.uint32(0x00FF00FF)) << wp.uint32(8)) | ((x >> wp.uint32(8)) & wp.uint32(0x00FF00FF))
    return (x << wp.uint32(16)) | (x >> wp.uint32(16))


@wp.func
def owen(value: wp.uint32, key: wp.uint32) -> wp.uint32:
    """Nested uniform scrambling of bit-reversed digits, as in the sampler."""
    x = value
    x = x ^ (x * wp.uint32(0x3D20ADEA))
    x = x + key
    x = x * ((key >> wp.uint32(16)) | wp.uint32(1))
    x = x ^ (x * wp.uint32(0x05526C56))
    x = x ^ (x * wp.uint32(0x53A22864))
    return reversed_bits(x)


@wp.func
def sort_pair(key: wp.uint64, row: wp.int64, order: wp.array(dtype=wp.int32), n: wp.int32):
    """Fill order[0:n] with the indices of 0..n-1 by their scrambled values.

    Scrambling permutes the lowest digits among themselves, so that they say the place at once. The places that the
    indices from n on would take are closed up.
    """
    size = order.shape[0]
    scramble = wp.uint32(mixed(key, row))
    for slot in range(size):
        order[slot] = -1
    for i in range(n):
        order[wp.int32(owen(reversed_bits(wp.uint32(i)), scramble) & wp.uint32(size - 1))] = i
    filled = wp.int32(0)
    for slot in range(size):
        i = order[slot]
        if i >= 0:
            order[filled] = i
            filled += 1


@wp.func
def shuffle(numbers: Numbers, at: wp.int32, row: wp.int64, n: wp.int32):
    """Prepare the points of the global row `row`, which is row `at` of the scratch."""
    if numbers.pmj:
        sort_pair(numbers.shuffle_2, row, numbers.order[at][0], n)
        sort_pair(numbers.shuffle_4, row, numbers.order[at][1], n)


@wp.func
def coordinate(numbers: Numbers, at: wp.int32, row: wp.int64, i: wp.int32, axis: wp.int32) -> wp.float64:
    """Coordinate `axis` of point i, in (0, 1)."""
    u = unit(mixed(mixed(mixed(numbers.key, row), wp.int64(i)), wp.int64(axis)))
    if not numbers.pmj:
        return u
    source = i
    if axis >= 2:
        source = numbers.order[at, axis // 2 - 1, i]
    scramble = wp.uint32(mixed(mixed(numbers.scramble, row), wp.int64(axis)))
    digits = owen(numbers.sobol[source, axis % 2], scramble)
    return wp.min((wp.float64(digits) + u) * wp.float64(2.3283064365386963e-10), _BELOW_ONE)


@lru_cache(maxsize=16)
def _sobol(n: int) -> np.ndarray:
    from nqr_geom.integrator.samplers import sobol_reversed

    return np.ascontiguousarray(sobol_reversed(n, 2).astype(np.uint32))


def numbers(stream: Stream, rows: int, n: int, *, pmj: bool) -> Numbers:
    """What kernels need to draw n points for each of `rows` integrals from a stream."""
    made = Numbers()
    made.pmj = pmj
    made.key = unsigned(stream.key)
    made.scramble = unsigned(stream.child("scramble").key)
    made.shuffle_2 = unsigned(stream.child("shuffle 2").key)
    made.shuffle_4 = unsigned(stream.child("shuffle 4").key)
    size = 1 << (n - 1).bit_length() if pmj else 0
    made.sobol = array(_sobol(n) if pmj else np.zeros((0, 2), np.uint32), wp.uint32)
    made.order = array(np.empty((rows if pmj else 0, 2, size), np.int32), wp.int32)
    return made
