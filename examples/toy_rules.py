"""What rules make of the same samples: the weights of Fig. 11 on one integrand of the toy family."""

from __future__ import annotations

from pathlib import Path

import pyvista as pv
import torch

import nqr_geom as ng
from nqr_geom import registry
from nqr_geom.integrator.problem import Samples
from nqr_geom.streams import Stream

RULES = ("mc", "regression-3", "trapezoid", "toy-hermite")
SAMPLERS = ("random", "stratified")


def weights(problem: ng.problems.ToyProblem, rule: str, samples: Samples) -> tuple[torch.Tensor, float]:
    """Weights (N,) of a rule, and its error on the integral."""
    combination = registry.make("rule", rule).combine(samples)
    error = combination.estimate(samples) - torch.as_tensor(problem.reference())
    return combination.weights.expand_as(samples.value)[0, :, 0, 0], float(error)


def main(out: Path = Path("out"), n: int = 16, row: int = 4) -> dict[tuple[str, str], float]:
    """Draw f, the samples and their weights for every sampler and rule; return the errors."""
    problem = ng.problems.toy(row + 1).take(slice(row, row + 1))
    line = torch.linspace(0.0, 1.0, 1001, dtype=torch.float64)[None, :, None]
    f = problem.evaluate(line).value.flatten()
    errors = {}
    plotter = pv.Plotter(shape=(len(SAMPLERS), len(RULES)), off_screen=True, window_size=(1800, 900), border=False)
    for i, sampler in enumerate(SAMPLERS):
        samples = registry.make("sampler", sampler).draw(problem, n, Stream(1))
        for j, rule in enumerate(RULES):
            w, errors[sampler, rule] = weights(problem, rule, samples)
            plotter.subplot(i, j)
            chart = pv.Chart2D()
            chart.line(line.flatten().numpy(), f.numpy(), color="black", width=1.5, label="f")
            x, value = samples.x.flatten(), samples.value.flatten()
            chart.scatter(x.numpy(), (w * value).numpy(), color="darkorange", size=9, label="W f")
            chart.scatter(x.numpy(), w.numpy(), color="royalblue", size=7, label="W")
            chart.title = f"{sampler} + {rule}: error {errors[sampler, rule]:+.1e}"
            chart.x_label, chart.y_label = "x", ""
            plotter.add_chart(chart)
    out.mkdir(parents=True, exist_ok=True)
    plotter.screenshot(out / "toy_rules.png")
    plotter.close()
    return errors


if __name__ == "__main__":
    for (sampler, rule), error in main().items():
        print(f"{sampler:12s} {rule:14s} {error:+.2e}")
