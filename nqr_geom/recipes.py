"""Which family, base rule and network make each model."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from nqr_geom import check
from nqr_geom.curves.tokens import CURVE_TOKENS
from nqr_geom.curves.training import gwn_batch
from nqr_geom.integrator.learn.inet import INetConfig
from nqr_geom.integrator.learn.recipe import Recipe
from nqr_geom.integrator.learn.tokens import TokenConfig
from nqr_geom.integrator.learn.zoo import Model, load
from nqr_geom.integrator.problem import Feature
from nqr_geom.toy.tokens import TOY_TOKENS, toy_batch

__all__ = ["RECIPES", "folder", "model"]

_TOY = TokenConfig(features=(Feature("piece", "index", levels=5),), extra=TOY_TOKENS.size, centred=True)
_CURVE = TokenConfig(
    features=(Feature("piece", "index", levels=6), Feature("normal", "direction", 2)),
    extra=CURVE_TOKENS.size,
    unit=1.0,  # a winding number is a number of turns, whatever the row
)

_CURVE_SEES = ("relative", "normal", "piece", "pieces", "distance2", "inverse_distance2", "speed")
_SIZES = ((32, 0.75), (64, 0.1), (16, 0.1), (8, 0.05))

RECIPES: dict[str, Recipe] = {
    recipe.name: recipe
    for recipe in (
        Recipe(
            name="toy-uniform",
            problem="toy",
            family=toy_batch,
            base="uniform",
            consistent="trapezoid",
            config=INetConfig(_TOY, unit_mass=True),
            sees=("derivative", "piece"),
            extra=TOY_TOKENS,
            sizes=_SIZES,
        ),
        Recipe(
            name="toy-structured",
            problem="toy",
            family=toy_batch,
            base="toy-hermite",
            consistent="toy-hermite",
            config=INetConfig(_TOY, unit_mass=True, offset=True),
            sees=("derivative", "piece"),
            extra=TOY_TOKENS,
            sizes=((32, 1.0),),  # fewer samples have so much larger errors that nothing else would be learned
        ),
        Recipe(
            name="gwn-structured",
            problem="gwn",
            family=gwn_batch,
            base="gwn-hermite",
            consistent="gwn-hermite",
            # The base is exact but for pieces that it has not seen and queries too close to tell.
            config=INetConfig(_CURVE, offset=True, doubtful_only=True),
            sees=_CURVE_SEES,
            extra=CURVE_TOKENS,
            sizes=((32, 0.7), (16, 0.2), (8, 0.1)),
            designs=("random", "random", "random", "stratified"),
            surplus=10,
        ),
        Recipe(
            name="gwn-uniform",
            problem="gwn",
            family=gwn_batch,
            base="uniform",
            consistent="trapezoid",
            config=INetConfig(_CURVE),
            sees=_CURVE_SEES,
            extra=CURVE_TOKENS,
            sizes=_SIZES,
        ),
    )
}


def folder(problem: str) -> Path:
    """Where the models of a problem lie."""
    room = {"toy": "toy", "gwn": "curves", "sd": "curves"}[check.choice("problem", problem, ["toy", "gwn", "sd"])]
    return Path(__file__).parent / room / "models"


@lru_cache(maxsize=8)
def model(name: str) -> Model:
    """The shipped model of a recipe, as a rule.

    Parameters
    ----------
    name : str
        Key of `RECIPES`.

    Raises
    ------
    ValueError
        If there is no such recipe or model, or its card and weights do not belong together.
    """
    recipe = RECIPES[check.choice("name", name, sorted(RECIPES))]
    return load(folder(recipe.problem), recipe)
