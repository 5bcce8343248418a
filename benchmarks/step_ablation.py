"""What a sampler of walks has to see (Fig. 31): directions at once, one by one, with what a step sees, and ahead.

    python benchmarks/step_ablation.py [--quick] [--keep FOLDER] [--only NAME]

Joint trainings of equal length and data on the family of Fig. 41, all beginning with the network in
training/laplace-uniform as their integrator. "Frozen" leaves the sampler as it began: what remains is the integrator's
own adaptation.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import torch
from figures import DOCS
from joint_training import curve, draw
from rich.console import Console
from rich.table import Table
from shapes import write

from nqr_geom import registry
from nqr_geom.integrator.learn.joint import JointConfig, JointRecipe, train_jointly, validate
from nqr_geom.integrator.learn.snet import SNetConfig
from nqr_geom.integrator.learn.steps import Look
from nqr_geom.recipes import JOINT, RECIPES
from nqr_geom.wos.problems import WalkState
from nqr_geom.wos.steps import LaplaceWalks

ROOT = Path(__file__).resolve().parents[1]
PAIR, BEGIN = JOINT["laplace-nqr"], "laplace-uniform"
RULE = replace(RECIPES["laplace-spread"], consistent="mc", sizes=PAIR.rule.sizes)  # weights alone, as the paper's
TRAINING = JointConfig(iterations=200, batch=16, every=50, warmup=50, average=0.98, validation=512)
FROZEN = 1e-12


class Seeing(LaplaceWalks):
    """What a step sees, but nothing of single directions: the paper's sampler."""

    base = (0.0, 0.0, 0.0)

    def look(self, state: WalkState, step: int) -> Look:
        found = super().look(state, step)
        return found._replace(ahead=torch.zeros_like(found.ahead))


class Blind(Seeing):
    """The direction before alone."""

    def look(self, state: WalkState, step: int) -> Look:
        found, seen = super().look(state, step), torch.zeros(self.problem.batch, self.size)
        if step > 0:
            away = state.position[:, 0] - self.before
            seen[:, :2] = torch.nn.functional.normalize(away, dim=1).float()
        self.before = state.position[:, 0].clone()
        return found._replace(seen=seen, turn=torch.zeros_like(found.turn))


GRID = SNetConfig(PAIR.sampler.tokens, head="grid", grid=((8,),) * 12)
VARIANTS: dict[str, tuple[SNetConfig, type[LaplaceWalks] | None, float]] = {
    "all directions at once": (GRID, None, TRAINING.sampler_rate),
    "step by step, seeing the last direction": (PAIR.sampler, Blind, TRAINING.sampler_rate),
    "step by step, seeing the place (Fig. 30)": (PAIR.sampler, Seeing, TRAINING.sampler_rate),
    "seeing the place and what lies ahead": (PAIR.sampler, LaplaceWalks, TRAINING.sampler_rate),
    "walk-spread, frozen": (PAIR.sampler, LaplaceWalks, FROZEN),
}


def trained(name: str, config: JointConfig, keep: Path) -> list[tuple[int, float]]:
    """The loss curve of a variant."""
    sampler, view, rate = VARIANTS[name]
    rule = replace(RULE, name=f"laplace-{list(VARIANTS).index(name)}")
    recipe = JointRecipe(rule, BEGIN, sampler, view)
    folder = keep / rule.name
    train_jointly(recipe, folder, replace(config, sampler_rate=rate), start_from=ROOT / "training" / BEGIN)
    return curve(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a few iterations, to see that it runs; writes nothing")
    parser.add_argument("--keep", type=Path, help="folder of the runs, which are continued")
    parser.add_argument("--only", type=int, help="train this variant alone, into --keep")
    arguments = parser.parse_args()
    config = replace(TRAINING, iterations=2, every=1, validation=64) if arguments.quick else TRAINING
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        keep = arguments.keep or Path(folder)
        if arguments.only is not None:
            trained(list(VARIANTS)[arguments.only], config, keep)
            return
        curves = {name: trained(name, config, keep) for name in VARIANTS}
    uniform = JointRecipe(RULE, BEGIN, GRID)  # untrained: independent walks
    plain = validate(uniform, uniform.snet(), registry.make("rule", "mc"), config)
    rows = [
        {"variant": name, "mse": points[-1][1], "first": points[0][1], "ratio": plain / points[-1][1]}
        for name, points in curves.items()
    ]
    table = Table("variant", f"MSE after {config.every}", f"after {config.iterations}", "x", title="walks, jointly")
    for row in rows:
        table.add_row(row["variant"], f"{row['first']:.2e}", f"{row['mse']:.2e}", f"{row['ratio']:.1f}")
    Console().print(table)
    if not arguments.quick:
        draw(curves, plain, DOCS / "step-ablation.png")
        print(write("step_ablation", rows, iterations=config.iterations, batch=config.batch, group=config.group,
                    every=config.every, monte_carlo=plain, curves=curves))  # fmt: skip


if __name__ == "__main__":
    main()
