"""The parameter of a curve: s in [0, 1] spread evenly over k pieces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check

__all__ = ["locate"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def locate(s: ArrayLike, piece: ArrayLike | None, k: int) -> tuple[Ints, Floats]:
    """Piece and local parameter of s on a curve of k pieces; see `Curve.locate`.

    Examples
    --------
    >>> locate([0.25, 0.5], None, 2), locate(0.5, 0, 2)
    ((array([0, 1]), array([0.5, 0. ])), (array(0), array(1.)))
    """
    try:
        shape = np.shape(s)
    except ValueError as error:
        raise TypeError("s: expected numbers, got a ragged nest of them") from error
    parameter = check.array("s", s, shape)
    if parameter.size and (parameter.min() < 0.0 or parameter.max() > 1.0):
        bad = parameter[(parameter < 0.0) | (parameter > 1.0)].flat[0]
        raise ValueError(f"s: expected numbers in [0, 1], got {bad}")
    if k == 0 and parameter.size:
        raise ValueError("s: expected none, because the curve is empty")
    u = parameter * k
    # s = j/k and the product are rounded once each, so u may fall one step short of j.
    joint = np.rint(u)
    u = np.where(np.abs(u - joint) <= 2.0**-52 * joint, joint, u)
    index = np.minimum(u.astype(np.int64), k - 1) if piece is None else _explicit(piece, u, k)
    return np.asarray(index), np.asarray(np.clip(u - index, 0.0, 1.0))


def _explicit(piece: ArrayLike, u: Floats, k: int) -> Ints:
    index = np.asarray(piece)
    if not np.issubdtype(index.dtype, np.integer):
        raise TypeError(f"piece: expected integers, got dtype {index.dtype}")
    try:
        index = np.broadcast_to(index, u.shape).astype(np.int64)
    except ValueError as error:
        raise ValueError(f"piece: expected the shape of s {u.shape}, got {index.shape}") from error
    wrong = (index < 0) | (index >= k) | (u < index) | (u > index + 1)
    if wrong.any():
        where = np.flatnonzero(wrong)[0]
        raise ValueError(
            f"piece: expected the piece that holds s, got {index.flat[where]} for s k = {u.flat[where]} of {k} pieces"
        )
    return index
