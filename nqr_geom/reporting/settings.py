"""How much is measured: a quick report takes about two minutes on two idle cores, a full one takes long."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["MODES", "Sizes"]


@dataclass(frozen=True)
class Sizes:
    """Numbers of one mode.

    Attributes
    ----------
    budgets : tuple of int
        Samples per integral.
    runs : int
        Independent runs a cell; the first one warms up and is not timed.
    cell_seconds : float
        A budget that would take longer than this for all its runs, judged by the one before, is left out and said so.
    always : int
        Up to this budget nothing is left out, so that all methods can be compared there.
    everything : bool
        All fixed designs and rules of the registry, not only those with a short name.
    most_learned : int
        Largest budget of networks, which are trained on 32 samples.
    toy, shapes, grid, polygons, points, volumes, rays, scenes, pixels : int
        Integrands; curves and grid lines; polygons and queries in each; volumes and rays along a side; scenes and
        pixels along a side.
    triangles, p_triangles : tuple of int
        Finite elements; the last one of `p_triangles` is the truth.
    residuals : tuple of float
        Tolerances of the boundary integral, as parts of the spread of the boundary values.
    truth : float
        The tolerance behind true answers.
    edges : int
        Of a flattened outline at most.
    bar_sizes, bar_runs, bar_integrals : tuple of int, int, int
        Samples, runs and integrals that coverage is counted on.
    effect_pixels, effect_repeats : int
        Picture size and repetitions of the table of effects.
    hard_seconds : float
        After so long no further hard case of a group is begun.
    """

    budgets: tuple[int, ...]
    runs: int
    cell_seconds: float
    always: int
    everything: bool
    most_learned: int
    toy: int
    shapes: int
    grid: int
    polygons: int
    points: int
    volumes: int
    rays: int
    scenes: int
    pixels: int
    triangles: tuple[int, ...]
    p_triangles: tuple[int, ...]
    residuals: tuple[float, ...]
    truth: float
    edges: int
    bar_sizes: tuple[int, ...]
    bar_runs: int
    bar_integrals: int
    effect_pixels: int
    effect_repeats: int
    hard_seconds: float


MODES = {
    "quick": Sizes(
        budgets=(4, 8, 16, 32, 64, 128, 256, 512),
        runs=3,
        cell_seconds=1.5,
        always=32,
        everything=False,
        most_learned=32,
        toy=256,
        shapes=8,
        grid=8,
        polygons=4,
        points=96,
        volumes=6,
        rays=12,
        scenes=4,
        pixels=12,
        triangles=(100, 1000),
        p_triangles=(20, 60, 250),
        residuals=(1e-4,),
        truth=1e-6,
        edges=120,
        bar_sizes=(32, 128),
        bar_runs=40,
        bar_integrals=128,
        effect_pixels=64,
        effect_repeats=9,
        hard_seconds=4.0,
    ),
    "full": Sizes(
        budgets=(4, 8, 16, 32, 64, 128, 256, 512, 1024, 2048),
        runs=8,
        cell_seconds=40.0,
        always=32,
        everything=True,
        most_learned=64,
        toy=2048,
        shapes=24,
        grid=20,
        polygons=12,
        points=128,
        volumes=16,
        rays=20,
        scenes=8,
        pixels=24,
        triangles=(100, 1000, 4000),
        p_triangles=(20, 60, 250, 1000),
        residuals=(1e-4, 1e-6),
        truth=1e-8,
        edges=300,
        bar_sizes=(32, 64, 128, 256, 512),
        bar_runs=400,
        bar_integrals=256,
        effect_pixels=128,
        effect_repeats=9,
        hard_seconds=3600.0,
    ),
}
