"""The random numbers of `nqr_geom.streams` inside Warp kernels, bit for bit the same."""

from nqr_geom import streams
from nqr_geom._warp import wp

__all__ = ["mixed", "unit", "unsigned"]

_GOLDEN = wp.constant(wp.uint64(streams._GOLDEN & (2**64 - 1)))
_M1 = wp.constant(wp.uint64(streams._M1 & (2**64 - 1)))
_M2 = wp.constant(wp.uint64(streams._M2 & (2**64 - 1)))


def unsigned(key: int) -> int:
    """A stream's key as kernels take it, for a parameter of type `wp.uint64`."""
    return key & (2**64 - 1)


@wp.func
def mixed(state: wp.uint64, counter: wp.int64) -> wp.uint64:
    """Take one counter into the state; start from a stream's key, unsigned."""
    z = (wp.uint64(counter) + wp.uint64(1)) * _GOLDEN + state
    z = (z ^ (z >> wp.uint64(30))) * _M1
    z = (z ^ (z >> wp.uint64(27))) * _M2
    return z ^ (z >> wp.uint64(31))


@wp.func
def unit(state: wp.uint64) -> wp.float64:
    """The number in (0, 1) that a state stands for."""
    return (wp.float64(state >> wp.uint64(12)) + wp.float64(0.5)) * wp.float64(2.220446049250313e-16)
