"""The loop over methods and budgets of one application, cell by cell, each kept as soon as it is there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from nqr_geom.integrator.bootstrap import Bootstrap
from nqr_geom.integrator.coverage import coverage
from nqr_geom.integrator.measure import Measured, measure, measure_peer, point_of
from nqr_geom.reporting.applications import Application
from nqr_geom.reporting.contenders import Contender, Solver
from nqr_geom.reporting.settings import Sizes
from nqr_geom.reporting.store import Store

__all__ = ["Run"]

Floats = NDArray[np.float64]
Cell = dict[str, Any]


@dataclass(frozen=True)
class Run:
    """One application under measurement.

    Parameters
    ----------
    application : Application
    sizes : Sizes
    seed : int
        Of the first run; run r has seed + r.
    store : Store
        Where cells are kept and found.
    tell : callable
        Called with a label after every cell.
    """

    application: Application
    sizes: Sizes
    seed: int
    store: Store
    tell: Callable[[str], None]

    @property
    def runs(self) -> int:
        """Independent runs a cell: more where they are all there is to resample."""
        return self.sizes.runs if len(np.unique(self.application.problem.groups)) > 1 else max(self.sizes.runs, 6)

    @cached_property
    def truth(self) -> Floats:
        """True answers, once for all cells."""
        truth = self.application.truth()
        if not np.isfinite(truth).all():
            raise ValueError(f"input: expected finite true answers of {self.application.name!r}, some are not")
        return truth

    @cached_property
    def resample(self) -> Bootstrap:
        """The same resamplings for all cells."""
        return Bootstrap.of(self.application.problem.groups, self.runs, self.seed)

    @cached_property
    def _base(self) -> dict[int, Measured]:
        """Errors of the baseline by number of samples; the same again when a report goes on."""
        return {}

    def budgets(self, contender: Contender) -> list[int]:
        """Samples at which a contender is measured."""
        most = self.sizes.most_learned if contender.kind in ("learned", "student") else max(self.sizes.budgets)
        return [self.application.scale * n for n in self.sizes.budgets if n <= most]

    @property
    def cells(self) -> int:
        """How many there will be."""
        application = self.application
        sampled = sum(len(self.budgets(contender)) for contender in application.contenders)
        return sampled + len(application.solvers) + application.bars

    def measure(self) -> dict[str, Any]:
        """All cells of the application, and what they were measured on, as JSON can hold it."""
        application = self.application
        order = sorted(application.contenders, key=lambda contender: contender.name != application.baseline)
        found = {contender.name: self._sampled(contender) for contender in order}
        cells = [cell for contender in application.contenders for cell in found[contender.name]]
        solved = [self._solved(solver) for solver in application.solvers]
        problem = application.problem
        return {
            "name": application.name,
            "title": application.title,
            "inputs": application.inputs,
            "truth_from": application.truth_from,
            "batch": problem.batch,
            "groups": len(np.unique(problem.groups)),
            "runs": self.runs,
            "seed": self.seed,
            "intervals_over": self.resample.over,
            "baseline": application.baseline,
            "scale": application.scale,
            "effects": sorted(problem.effects),
            "cells": cells + solved,
            "coverage": self._coverage() if application.bars else [],
        }

    def _kept(self, key: str, make: Callable[[], Any]) -> Any:
        """The cell of this key, measured if it is not there yet."""
        whole = f"{self.application.name}: {key}"
        cell = self.store.get(whole)
        if cell is None:
            cell = make()
            self.store.put(whole, cell)
        self.tell(f"{self.application.title}: {key}")
        return cell

    def _sampled(self, contender: Contender) -> list[Cell]:
        """Cells of one method, fewest samples first."""
        cells: list[Cell] = []
        for n in self.budgets(contender):

            def make(n: int = n) -> Cell:
                cell = _cell(contender.name, contender.kind, n, "", "+".join(filter(None, contender.pair)))
                before = next((c["point"] for c in reversed(cells) if c["point"]), None)
                return cell | self._measured(contender, n, before)

            cells.append(self._kept(f"{contender.name}, n = {n}", make))
        return cells

    def _measured(self, contender: Contender, n: int, before: Cell | None) -> Cell:
        """The point of a cell, or why there is none."""
        if before is not None and n > self.sizes.always * self.application.scale:
            expected = before["seconds"] * self.application.problem.batch * self.runs * n / before["n"]
            if expected > self.sizes.cell_seconds:
                limit = f"more than the {self.sizes.cell_seconds:g} s a cell may take in this mode"
                return {"refused": f"would take about {expected:.2g} s, {limit}"}
        reason = contender.refused(n)
        if reason is not None:
            return {"refused": reason}
        try:
            got = self._errors(contender, n)
            base = self._baseline(contender, n)
        except (ValueError, FloatingPointError) as error:
            return {"refused": str(error)}
        return {"point": asdict(point_of(contender.name, contender.pair, n, got, base, self.resample))}

    def _errors(self, contender: Contender, n: int) -> Measured:
        seeds = range(self.seed, self.seed + self.runs)
        got = measure(contender.name, lambda seed: contender.answer(n, seed), self.truth, seeds)
        if contender.name == self.application.baseline:
            self._base[n] = got
        return got

    def _baseline(self, contender: Contender, n: int) -> Measured | None:
        """What the baseline did with as many samples, where it was measured; measured again when a report goes on."""
        application = self.application
        base = next((one for one in application.contenders if one.name == application.baseline), None)
        kept = self.store.get(f"{application.name}: {application.baseline}, n = {n}")
        if base is None or (contender is not base and (kept is None or kept["point"] is None)):
            return None
        return self._base[n] if n in self._base else self._errors(base, n)

    def _solved(self, solver: Solver) -> Cell:
        """The cell of a method without samples."""

        def make() -> Cell:
            cell = _cell(solver.name, "exact", None, solver.setting, "")
            try:
                return cell | {"point": asdict(measure_peer(solver.name, solver.solve, self.truth, self.resample))}
            except (ValueError, RuntimeError) as error:
                return cell | {"refused": str(error)}

        return self._kept(", ".join(filter(None, (solver.name, solver.setting))), make)

    def _coverage(self) -> list[Cell]:
        """How often the baseline's error bars hold, on some of the integrals."""
        application, sizes = self.application, self.sizes
        base = next((one for one in application.contenders if one.name == application.baseline), None)

        def make() -> list[Cell]:
            if base is None:
                return []
            batch = application.problem.batch
            some = np.unique(np.linspace(0, batch - 1, min(batch, sizes.bar_integrals)).astype(np.int64))
            rows = coverage(
                application.problem.take(torch.from_numpy(some)),
                sampler=base.pair[0],
                rule=base.pair[1],
                sizes=sizes.bar_sizes,
                runs=sizes.bar_runs,
                seed=self.seed,
                truth=self.truth[some],
            )
            return [asdict(row) | {"high": None if row.high == np.inf else row.high} for row in rows]

        rows: list[Cell] = self._kept("error bars", make)
        return rows


def _cell(method: str, kind: str, n: int | None, setting: str, pair: str) -> Cell:
    return {"method": method, "kind": kind, "n": n, "setting": setting, "pair": pair, "refused": None, "point": None}
