"""Which family, base rule and network make each model."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from nqr_geom import check, registry
from nqr_geom.curves.gaps import CurveGaps, SdGaps
from nqr_geom.curves.placing import CURVE_SAMPLE
from nqr_geom.curves.stencil import CURVE_STENCIL, STENCIL_TOKENS
from nqr_geom.curves.tokens import CURVE_TOKENS
from nqr_geom.curves.tokens_sd import SD_TOKENS
from nqr_geom.curves.training import gwn_batch
from nqr_geom.curves.training_sd import sd_batch
from nqr_geom.integrator.learn.inet import INetConfig
from nqr_geom.integrator.learn.joint import JointRecipe
from nqr_geom.integrator.learn.recipe import Recipe
from nqr_geom.integrator.learn.snet import LearnedSampler, SNetConfig, View
from nqr_geom.integrator.learn.tokens import TokenConfig
from nqr_geom.integrator.learn.zoo import Model, load, load_sampler
from nqr_geom.integrator.problem import Feature
from nqr_geom.p_training import P_RANGE_TOKENS, P_TOKENS, p_laplace_batch, p_range_batch
from nqr_geom.render.direct_slabs import SIGHT_TOKENS, LampSlabs, lamp_credit
from nqr_geom.render.direct_tokens import LAMP_TOKENS
from nqr_geom.render.direct_training import direct_batch, doubtful_batch
from nqr_geom.render.gaps import VolumeGaps
from nqr_geom.render.tokens import VOLUME_TOKENS
from nqr_geom.render.training import transmittance_batch
from nqr_geom.toy.gaps import ToyGaps
from nqr_geom.toy.law_terms import LAW_TERMS, missed_by_mean
from nqr_geom.toy.law_tokens import LAW_TOKENS, missed
from nqr_geom.toy.tokens import toy_batch
from nqr_geom.toy.told_tokens import TOLD_TOKENS, missed_by_weights
from nqr_geom.wos.steps import LaplaceWalks
from nqr_geom.wos.tokens import WALK_TOKENS
from nqr_geom.wos.training import laplace_batch

__all__ = ["JOINT", "RECIPES", "folder", "model", "named", "rule_of", "sampler"]

_TOY = TokenConfig(features=(Feature("piece", "index", levels=5),), extra=LAW_TERMS.size, centred=True)
_LAWS = replace(_TOY, frequencies=2, extra=LAW_TOKENS.size, unit=1.0)  # a jump is of the same size in all rows
_CURVE = TokenConfig(
    features=(Feature("piece", "index", levels=6), Feature("normal", "direction", 2)),
    extra=CURVE_TOKENS.size,
    unit=1.0,  # a winding number is a number of turns, whatever the row
)

# The value's unit is the mean of the row's: with the nearest distance taken out, F is not far from it.
_SD = replace(_CURVE, extra=SD_TOKENS.size, unit=None)
_VOLUME = TokenConfig(extra=VOLUME_TOKENS.size, unit=1.0)  # an optical depth of 1 is what counts
_DIRECT = TokenConfig(dim=6, channels=3, frequencies=0, extra=LAMP_TOKENS.size, blind=True)
_WALK = TokenConfig(dim=12, frequencies=0, extra=WALK_TOKENS.size, blind=True)

_CURVE_SEES = ("relative", "normal", "piece", "pieces", "distance2", "inverse_distance2", "speed")
_DIRECT_SEES = (
    *("direction", "nee_pdf", "nee_ratio", "bsdf_pdf", "bsdf", "light_direction", "light_distance", "light_radius"),
    *(
        "chance",
        "lambert",
        "irradiance",
        "diffuse_share",
        "light",
        "radiance",
        "visible",
        "unhidden",
        "pss",
        "incident",
        "known",
        "known_all",
        "expected",
    ),
)
_WALK_SEES = ("steps", "length", "finished", "end", "loops")
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
            config=INetConfig(_TOY, weights="kept", offset=True, spread=True, direct=True, reach=1),
            sees=("derivative", "piece"),
            extra=LAW_TERMS,
            sizes=_SIZES,
            designs=("random", "random", "stratified"),
            alike=True,
            missed=missed_by_mean,
        ),
        Recipe(
            name="toy-told",
            problem="toy",
            family=toy_batch,
            base="uniform",
            consistent="trapezoid",
            # Without unit mass: what is right for the parts of samples does not leave the mean weight at one.
            config=INetConfig(
                replace(_LAWS, extra=TOLD_TOKENS.size, unit=None),
                layers=0,
                width=256,
                weights="additive",
                direct=True,
            ),
            sees=("derivative", "piece"),
            extra=TOLD_TOKENS,
            sizes=((32, 0.8), (16, 0.1), (64, 0.1)),
            designs=("random", "random", "stratified"),
            huber=10.0,
            unit=1e-2,
            missed=missed_by_weights,
        ),
        Recipe(
            name="toy-structured",
            problem="toy",
            family=toy_batch,
            base="toy-hermite",
            consistent="toy-hermite",
            # Tokens tell what attention would have to find out. Only gaps that the rule leaves open are shifted.
            config=INetConfig(_LAWS, layers=0, width=256, weights="kept", offset=True, in_doubt=True),
            sees=("derivative", "piece"),
            extra=LAW_TOKENS,
            sizes=((32, 0.8), (16, 0.1), (64, 0.1)),
            designs=("random", "random", "stratified", "toy-split"),
            huber=10.0,
            missed=missed,
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
            # A third block and larger hidden layers cost time alone (loss curves in training/gwn-uniform).
            config=INetConfig(_CURVE, layers=2, expansion=2, direct=True, reach=1),
            sees=_CURVE_SEES,
            extra=CURVE_TOKENS,
            sizes=_SIZES,
            alike=True,
        ),
        Recipe(
            name="gwn-student",
            problem="gwn",
            family=gwn_batch,
            base="gwn-hermite",
            consistent="gwn-hermite",
            config=INetConfig(STENCIL_TOKENS, layers=0, width=48, offset=True, doubtful_only=True),
            sees=_CURVE_SEES,
            extra=CURVE_STENCIL,
            sizes=((32, 0.7), (16, 0.2), (8, 0.1)),
            designs=("random", "random", "random", "stratified"),
            surplus=10,
        ),
        Recipe(
            name="gwn-student-uniform",
            problem="gwn",
            family=gwn_batch,
            base="uniform",
            consistent="trapezoid",
            # Its compiled pass takes nearly 30 times the time of plain Monte Carlo.
            config=INetConfig(STENCIL_TOKENS, layers=0, width=48),
            sees=_CURVE_SEES,
            extra=CURVE_STENCIL,
            sizes=_SIZES,
        ),
        Recipe(
            name="sd-uniform",
            problem="sd",
            family=sd_batch,
            base="uniform",
            consistent="trapezoid",
            # The curve may come much closer between two samples than at either.
            config=INetConfig(_SD, offset=True, growth=30.0, positive=True),
            sees=(*_CURVE_SEES, "alpha"),
            extra=SD_TOKENS,
            sizes=_SIZES,
            huber=8.0,
        ),
        Recipe(
            name="transmittance-uniform",
            problem="transmittance",
            family=transmittance_batch,
            base="uniform",
            consistent="trapezoid",
            config=INetConfig(_VOLUME, offset=True, positive=True),  # where nothing absorbs, nothing is guessed
            sees=("t", "u_geo", "u_fbm", "slope", "bend", "length", "optical_length", "noise"),
            extra=VOLUME_TOKENS,
            sizes=((24, 0.75), (48, 0.1), (16, 0.1), (8, 0.05)),
            designs=(*("uniform-jitter",) * 5, "stratified", "random"),  # the last has most of the error, and no use
            largest=256,  # beyond, plain marching has nothing left to learn from
        ),
        Recipe(
            name="direct-mis",
            problem="direct",
            family=direct_batch,
            base="balance-heuristic",
            consistent="direct-known",
            # Tokens tell what attention would have to find out. Weights alone: a black pixel stays black.
            config=INetConfig(_DIRECT, layers=0, width=32, positive=True),
            sees=_DIRECT_SEES,
            extra=LAMP_TOKENS,
            sizes=((16, 0.8), (8, 0.1), (32, 0.1)),
            designs=("lamp-spread", "pmj", "random"),
            huber=0.25,
        ),
        Recipe(
            name="laplace-uniform",
            problem="laplace",
            family=laplace_batch,
            base="uniform",
            consistent="mc",
            # Harmonic functions are linear in their boundary values: blind to them, and exact on constants.
            config=INetConfig(
                _WALK, layers=2, heads=4, expansion=2, weights="additive", unit_mass=True, beside=_WALK.dim
            ),
            sees=_WALK_SEES,
            extra=WALK_TOKENS,
            designs=("random", "latin-hypercube"),
            largest=128,
        ),
        Recipe(
            name="laplace-spread",
            problem="laplace",
            family=laplace_batch,
            base="uniform",
            consistent="walk-fit",  # plain means of walks that avoid each other are biased
            config=INetConfig(
                _WALK, layers=2, heads=4, expansion=2, weights="additive", unit_mass=True, beside=_WALK.dim
            ),
            sees=_WALK_SEES,
            extra=WALK_TOKENS,
            designs=("walk-spread",),
            largest=128,
            trusts=(0.0, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2),
        ),
        Recipe(
            name="p-laplace",
            problem="p-laplace",
            family=p_laplace_batch,
            base="inet-laplace-uniform",  # the answer for p = 2
            consistent="inet-laplace-spread",
            config=INetConfig(
                replace(_WALK, extra=P_TOKENS.size),
                layers=2,
                heads=4,
                expansion=2,
                weights="additive",
                unit_mass=True,
                beside=_WALK.dim,
            ),
            sees=_WALK_SEES,
            extra=P_TOKENS,
            designs=("walk-spread-full",),
            largest=128,
        ),
    )
}
_THREE = RECIPES["p-laplace"]
RECIPES["p-laplace-range"] = replace(
    _THREE,
    name="p-laplace-range",
    family=p_range_batch,
    config=replace(_THREE.config, tokens=replace(_WALK, extra=P_RANGE_TOKENS.size)),
    sees=(*_WALK_SEES, "p"),
    extra=P_RANGE_TOKENS,
    designs=("walk-spread",),
)


# What a sampling network reads of a sample by itself.
_TOY_SAMPLE = TokenConfig((Feature("derivative", "scalar"), Feature("piece", "index", levels=5)), unit=1.0)
_VOLUME_SAMPLE = TokenConfig((Feature("u_geo", "scalar"), Feature("u_fbm", "scalar")), unit=1.0)
_CENTRE = (0.001,) * 4 + (0.496,) * 2 + (0.001,) * 4
_MIDDLE = (0.04,) * 3 + (0.19,) * 4 + (0.04,) * 3


def _pair(name: str, begin: str, sampler: SNetConfig, view: View, *sizes: tuple[int, float]) -> JointRecipe:
    return JointRecipe(replace(RECIPES[begin], name=name, sizes=sizes), begin, sampler, view)


JOINT: dict[str, JointRecipe] = {
    recipe.name: recipe
    for recipe in (
        JointRecipe(
            # What toy-hermite leaves open are the breaks: the integrator moves their expected places.
            replace(
                RECIPES["toy-structured"],
                name="toy-nqr",
                sizes=((32, 0.8), (24, 0.1), (48, 0.1)),
            ),
            "toy-structured",
            SNetConfig(_TOY_SAMPLE, sharpness=4.0, profile=_CENTRE, floor=0.002),
            ToyGaps,
        ),
        _pair(  # the paper's form: both networks begin with uniform density and weights
            "toy-nqr-uniform",
            "toy-uniform",
            SNetConfig(_TOY_SAMPLE),
            ToyGaps,
            *((32, 0.8), (16, 0.1), (64, 0.1)),
        ),
        JointRecipe(
            # Beside a sampler's time a larger integrator's counts little.
            replace(
                RECIPES["gwn-uniform"],
                name="gwn-nqr",
                config=INetConfig(_CURVE, direct=True, reach=1),
                sizes=((32, 0.8), (16, 0.1), (64, 0.1)),
            ),
            "gwn-uniform",
            SNetConfig(CURVE_SAMPLE, sharpness=4.0, profile=_MIDDLE),
            CurveGaps,
        ),
        JointRecipe(
            # The sampler begins as walk-spread-full, and the answer as walk-fit: its errors and a network's have little
            # in common, so that the network learns what helps beside it.
            replace(
                RECIPES["laplace-spread"],
                name="laplace-nqr",
                base="walk-fit",
                config=replace(RECIPES["laplace-spread"].config, gated=True),
                sizes=((32, 1.0),),
                unit=1e-2,
            ),
            "laplace-spread",
            SNetConfig(_WALK, head="step", bins=24, floor=0.05),
            LaplaceWalks,
        ),
        _pair(
            "sd-nqr",
            "sd-uniform",
            SNetConfig(CURVE_SAMPLE, sharpness=2.0, profile=_MIDDLE),
            SdGaps,
            *((32, 0.8), (16, 0.1), (64, 0.1)),
        ),
        JointRecipe(
            # Samples that are placed where the density is in doubt say little by their plain mean.
            replace(
                RECIPES["transmittance-uniform"],
                name="transmittance-nqr",
                base="clamped-noise",
                consistent="clamped-noise",
                sizes=((24, 0.8), (16, 0.1), (48, 0.1)),
            ),
            "transmittance-uniform",
            SNetConfig(_VOLUME_SAMPLE, sharpness=8.0, profile=_CENTRE),
            VolumeGaps,
            heads=False,
        ),
        JointRecipe(
            # Pixels whose lamps are partly hidden are learned from most: elsewhere there is little to place.
            replace(
                RECIPES["direct-mis"],
                name="direct-nqr",
                family=doubtful_batch,
                sizes=((16, 0.6), (8, 0.1), (32, 0.3)),
            ),
            "direct-mis",
            SNetConfig(
                TokenConfig(dim=6, channels=3, frequencies=0, extra=SIGHT_TOKENS.size, blind=True),
                layers=1,
                width=32,
                head="grid",
                grid=((8, 8, 8), (8, 8, 8)),
                techniques=2,
                together=8,
                floor=0.4,
            ),
            LampSlabs,
            reads=SIGHT_TOKENS,
            credit=lamp_credit,
        ),
    )
}


def folder(problem: str) -> Path:
    """Where the models of a problem lie."""
    rooms = {
        "toy": "toy",
        "gwn": "curves",
        "sd": "curves",
        "laplace": "wos",
        "p-laplace": "wos",
        "transmittance": "render",
        "direct": "render",
    }
    room = rooms[check.choice("problem", problem, list(rooms))]
    return Path(__file__).parent / room / "models"


@lru_cache(maxsize=8)
def model(name: str) -> Model:
    """The shipped model of a recipe, as a rule.

    Parameters
    ----------
    name : str
        Key of `RECIPES` or `JOINT`.

    Raises
    ------
    ValueError
        If there is no such recipe or model, or its card and weights do not belong together.
    """
    recipe = rule_of(name)
    return load(folder(recipe.problem), recipe)


@lru_cache(maxsize=8)
def sampler(name: str) -> LearnedSampler:
    """The shipped sampling network of a pair.

    Parameters
    ----------
    name : str
        Key of `JOINT`.

    Raises
    ------
    ValueError
        As for `model`.
    """
    recipe = JOINT[check.choice("name", name, sorted(JOINT))]
    return load_sampler(folder(recipe.rule.problem), name, recipe.snet())


def named(name: str) -> Recipe | JointRecipe:
    """The recipe of a single network or of a pair; a problem's name stands for the network of its method "inet"."""
    name = registry.ALIASES.get(f"{name}:inet", name).rpartition("+inet-")[2]
    check.choice("name", name, sorted([*RECIPES, *JOINT]))
    return RECIPES[name] if name in RECIPES else JOINT[name]


def rule_of(name: str) -> Recipe:
    """The recipe of an integrator, alone or of a pair."""
    recipe = named(name)
    return recipe.rule if isinstance(recipe, JointRecipe) else recipe
