"""Networks behind an exponential: what learning adds on clouds, a donut and letters, 24 queries a ray (Table 12).

    python benchmarks/learned_transmittance.py [--quick]

The same samples for every rule of a design: plain weights (the networks' base), the trapezoid (what they fade to), the
structured rule, the networks. Clouds are of the split "test"; donut and letters are unlike anything in the training.
Rays go through all of the box, or ("pieces") only through what balls and their noise can reach. Ratios are of means to
plain Monte Carlo on random samples of the same rays, with 95% bootstrap intervals over clouds, or over runs where there
is one volume. What is measured goes into the cards of the networks.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from comparison import SEED, Pair, rows_of, show, trained_sampler
from learned import write_cards
from numpy.typing import NDArray
from shapes import write
from transmittance import N, problem_of, truth

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.render.problems import TransmittanceProblem
from nqr_geom.render.volume import Volume

DESIGNS = ("random", "uniform-jitter", "stratified")
RULES = ("mc", "uniform", "trapezoid", "clamped-noise", "inet-transmittance-uniform")


@dataclass(frozen=True)
class Answered(TransmittanceProblem):
    """Rays with answers that were computed once.

    Parameters
    ----------
    answers : Tensor, (B, 1)
        Transmittances.
    """

    answers: torch.Tensor = field(default_factory=lambda: torch.zeros(0, 1))

    def reference(self) -> NDArray[np.float64]:
        return self.answers.numpy()

    def take(self, index: slice | torch.Tensor) -> Answered:
        return replace(self, rays=self.rays.take(index), rows=self.rows[index], answers=self.answers[index])


def answered(volumes: list[Volume], resolution: int) -> dict[str, Answered]:
    """A grid of rays through all volumes, over the box and over the stretches that count."""
    answers = torch.from_numpy(truth(volumes, resolution)[0])[:, None]
    problems = {support: problem_of(volumes, resolution, support) for support in ("bounds", "pieces")}
    return {support: Answered(**vars(problem), answers=answers) for support, problem in problems.items()}


def pairs() -> list[Pair]:
    """Every rule on fixed designs, the structured method, and the trained sampler under the rules that can count."""
    found = [(design, rule) for design in DESIGNS for rule in RULES]
    found.append(registry.method("structured", "transmittance"))
    joint = trained_sampler("transmittance")
    if joint is not None:
        found += [(joint[0], rule) for rule in dict.fromkeys(("uniform", "trapezoid", "clamped-noise", joint[1]))]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer clouds, rays and runs; writes nothing")
    quick = parser.parse_args().quick
    torch.set_num_threads(1)
    clouds, resolution, runs, alone = (4, 16, 1, 2) if quick else (16, 32, 2, 12)
    sets: dict[str, Callable[[], list[Volume]]] = {
        "clouds": lambda: ng.datasets.volumes(clouds, seed=SEED),
        "donut": lambda: [ng.datasets.donut()],
        "letters": lambda: [ng.datasets.letters()],
    }
    rows: list[dict[str, Any]] = []
    for name, volumes in sets.items():
        for support, problem in answered(volumes(), resolution).items():
            part = rows_of("transmittance", problem, pairs(), runs if name == "clouds" else alone, N)
            show(f"{name}, {support}", part)
            if (name, support) == ("clouds", "bounds") and not quick:
                write_cards(part)
            rows += [{**row, "set": name, "support": support} for row in part]
    if not quick:
        write("learned_transmittance", rows, n=N, seed=SEED, clouds=clouds, resolution=resolution, runs=runs,
              runs_alone=alone)  # fmt: skip


if __name__ == "__main__":
    main()
