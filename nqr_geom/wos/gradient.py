"""The gradient of a harmonic function at a point, from walks that start on the largest circle about it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nqr_geom.integrator.estimate import Statistics
from nqr_geom.streams import Stream
from nqr_geom.wos.domain import Boundary
from nqr_geom.wos.walk import walk

__all__ = ["gradient"]

Floats = NDArray[np.float64]

_TILE = 2**17  # walks held at a time


def _directions(rows: NDArray[np.int64], n: int, variates: str, stream: Stream) -> Floats:
    """First directions of n walks a row in turns, (B, n): opposite pairs stand next to each other."""
    paired = variates in ("both", "antithetic")
    count = n // 2 if paired else n
    u = stream.child("first").uniform(rows[:, None], np.arange(count))
    if not paired:
        return u
    half = 0.5 * ((np.arange(count) + u) / count if variates == "both" else u)
    return np.stack([half, half + 0.5], axis=-1).reshape(len(rows), n)


def gradient(
    values: Boundary,
    framed: Floats,
    rows: NDArray[np.int64],
    n: int,
    variates: str,
    stream: Stream,
    epsilon: float,
    max_steps: int,
) -> tuple[Statistics, dict[str, int]]:
    """Mean and spread of 2 (u - c) n/R over walks, in values per length of the polygon, and walks by outcome.

    Parameters
    ----------
    values : Boundary
        A domain with its values.
    framed, rows : (B, 2) and (B,)
        Queries in its frame, off the edge, and their global rows.
    n, variates, epsilon, max_steps
        As for `nqr_geom.laplace_gradient`.
    stream : Stream
        Source of the random numbers.
    """
    domain, paired = values.domain, variates in ("both", "antithetic")
    n += n % 2 if paired else 0
    edge, t, radius = domain.search(framed)
    level = values.at(edge, t) if variates in ("both", "control") else np.zeros(len(framed))
    terms = n // 2 if paired else n
    moments = np.zeros((4, len(framed), 2))
    counts: dict[str, int] = {}
    height = max(1, _TILE // n)
    for low in range(0, len(framed), height):
        part = slice(low, min(low + height, len(framed)))
        here, r = rows[part], radius[part, None]
        turn = 2.0 * np.pi * _directions(here, n, variates, stream)
        normal = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        start = (framed[part, None] + r[..., None] * normal).reshape(-1, 2)
        # A walk of its own for every start: its row is that of the query and its number.
        own = ((here[:, None] << 24) + np.arange(n)).ravel()
        of = np.zeros(len(start), dtype=np.int64)
        ended = walk(domain.nearest, of, start, own, np.zeros(1, dtype=np.int64), stream,
                     epsilon=epsilon, max_steps=max_steps)  # fmt: skip
        for key, count in ended.counts().items():
            counts[key] = counts.get(key, 0) + count
        found = values.at(ended.edge, ended.t).reshape(-1, n) - level[part, None]
        each = (2.0 / (r * domain.unit) * found)[..., None] * normal
        if paired:  # opposite to the last bit, so that constants cancel
            each = ((found[:, 0::2] - found[:, 1::2]) / (r * domain.unit))[..., None] * normal[:, 0::2]
        found_here = Statistics.of(each)
        moments[:, part] = found_here.mean, found_here.m2, found_here.m3, found_here.m4
    counts = {"samples": n * len(framed), "queries": counts.get("steps", 0), **counts}
    mean, m2, m3, m4 = moments
    return Statistics(mean, m2, terms, "samples", m3, m4), counts
