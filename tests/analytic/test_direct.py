"""Direct light against closed forms: spheres of light over planes, furnaces, reciprocity, densities."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from mpmath import mp
from scipy import integrate

from nqr_geom._warp import array, launch, wp
from nqr_geom.integrator.estimate import run
from nqr_geom.integrator.rules import BalanceHeuristic
from nqr_geom.integrator.samplers import Pmj, Random
from nqr_geom.render.camera import Camera
from nqr_geom.render.direct_problem import DirectProblem
from nqr_geom.render.direct_rules import UnhiddenLight
from nqr_geom.render.kernels_bsdf import Surface, reflect_any, sample_any
from nqr_geom.render.lights import SphereLight, light_tree, sphere_irradiance
from nqr_geom.render.materials import METALS, Conductor, Diffuse, Plastic, coat_table
from nqr_geom.render.scene import Scene
from nqr_geom.render.world import _material_rows, assemble, rows_of
from nqr_geom.streams import Stream
from tests.scenes import EVERYTHING, floor, open_floor, two_spheres

# --- the irradiance of a sphere -----------------------------------------------------------------------


def by_quadrature(s: float, cosine: float) -> float:
    """Irradiance from a cone of directions around a sphere seen at `cosine`, by brute force."""
    sine = np.sqrt(1.0 - cosine**2)

    def integrand(phi: float, c: float) -> float:
        return max(0.0, c * cosine + np.sqrt(1.0 - c * c) * np.cos(phi) * sine)

    return 2.0 * integrate.dblquad(integrand, np.sqrt(1.0 - s * s), 1.0, 0.0, np.pi, epsabs=1e-11)[0]


@pytest.mark.parametrize("s", [0.05, 0.5, 0.95])
@pytest.mark.parametrize("cosine", [1.0, 0.96, 0.6, 0.3, 0.0, -0.03, -0.3, -0.94])
def test_irradiance_above_across_and_below_the_horizon(s, cosine):
    assert sphere_irradiance(s, 1.0, cosine) == pytest.approx(by_quadrature(s, cosine), rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("s", [1e-1, 1e-3, 1e-4, 1e-6])
def test_irradiance_of_small_spheres_keeps_its_digits(s):
    with mp.workdps(60):
        exact = mp.asin(mp.mpf(s)) - mp.mpf(s) * mp.sqrt(1 - mp.mpf(s) ** 2)
    assert sphere_irradiance(s, 1.0, 0.0) == pytest.approx(float(exact), rel=1e-9 + 1e-15 / s**2)
    assert sphere_irradiance(s, 1.0, 0.8) == pytest.approx(np.pi * s * s * 0.8, rel=1e-14)


def test_irradiance_inside_a_sphere_and_at_its_surface():
    assert sphere_irradiance(1.0, 0.3, -0.7) == np.pi
    assert sphere_irradiance(1.0, 1.0, 0.3) == np.pi
    grazing = sphere_irradiance(1.0, 1.0 + 1e-9, [1.0, 0.0, -1.0])
    np.testing.assert_allclose(grazing, [np.pi, np.pi / 2, 0.0], atol=2e-4)


# --- planes under a light -----------------------------------------------------------------------------


def estimate(scene, sampler, rule, n, **options):
    problem = DirectProblem.of(scene, effects=EVERYTHING)
    return problem, run(problem, sampler, rule, n, **options)


@pytest.mark.parametrize(
    "light",
    [
        SphereLight([0.3, 0.2, 1.0], 0.3, [4.0, 2.0, 1.0]),
        SphereLight([0.9, 0.0, 0.02], 0.3, [4.0, 2.0, 1.0]),  # half of it below the floor
        SphereLight([0.9, 0.0, -0.1], 0.3, 5.0),
        SphereLight([0.0, 0.0, 50.0], 0.005, 1e9),
        SphereLight([0.0, 0.0, 0.0], 9.0, 1.0),  # around everything
    ],
    ids=["above", "cut", "sunk", "tiny", "around"],
)
def test_a_diffuse_floor_gets_the_closed_form(light):
    # The floor itself hides what is below it, as the horizon does.
    scene = open_floor([light], Diffuse([0.5, 0.25, 0.75]))
    problem, exact = estimate(scene, Pmj(), UnhiddenLight(), 16)
    seen = problem.surfaces["kind"] >= 0  # a light may stand before the floor
    assert seen.sum() >= 8
    p = problem.surfaces["position"] * scene.frame.scale + scene.frame.centre
    away = light.center - p
    distance = np.linalg.norm(away, axis=1)
    expected = sphere_irradiance(light.radius, distance, away[:, 2] / distance) / np.pi
    truth = np.where(seen, expected, 0.0)[:, None] * light.emission * [0.5, 0.25, 0.75]
    np.testing.assert_allclose(exact.value, truth, rtol=1e-9, atol=1e-12 * truth.max())
    sampled = run(problem, Random(), BalanceHeuristic(), 4096)
    assert (np.abs(sampled.value - truth) <= 4.5 * sampled.stderr + 1e-9 * truth).all()
    assert (sampled.stderr <= 0.2 * truth.max()).all()


def test_light_is_linear_in_the_lights():
    lights = [SphereLight([0.5, 0.3, 1.0], 0.1, [3, 2, 1]), SphereLight([-0.6, 0, 0.7], 0.2, [1, 1, 2])]
    # With 256 passes both lights are sure to be chosen everywhere, and their light is exact.
    alone = [estimate(open_floor([light]), Pmj(), UnhiddenLight(), 256)[1].value for light in lights]
    together = estimate(open_floor(lights), Pmj(), UnhiddenLight(), 256)[1].value
    np.testing.assert_allclose(together, alone[0] + alone[1], rtol=1e-9)
    brighter = [SphereLight(light.center, light.radius, 3.0 * light.emission) for light in lights]
    np.testing.assert_allclose(
        estimate(open_floor(brighter), Pmj(), BalanceHeuristic(), 16)[1].value,
        3.0 * estimate(open_floor(lights), Pmj(), BalanceHeuristic(), 16)[1].value,
        rtol=1e-12,
    )


def test_both_techniques_alone_and_together_have_the_same_mean():
    problem = DirectProblem.of(two_spheres(), effects=EVERYTHING)
    samples = Random().draw(problem, 4096, Stream(3))
    terms = samples.value.numpy()  # (B, N, 2, 3)
    both = BalanceHeuristic().combine(samples).per_sample(samples).numpy()
    by_material, by_light = (terms[:, :, t].sum(axis=2) for t in (0, 1))
    often = (by_material > 0.0).sum(axis=1) > 50  # elsewhere a lobe meets a light too rarely to speak of a spread
    assert often.sum() > 30
    for a, b in ((by_material, both.sum(axis=2)), (by_light, both.sum(axis=2)), (by_material, by_light)):
        gap, spread = (a - b).mean(axis=1)[often], (a - b).std(axis=1)[often] / np.sqrt(4096)
        assert np.abs(gap / spread).max() < 4.5  # of 40 pixels
        assert abs(gap.mean()) < 4.0 * np.sqrt((spread**2).sum()) / len(gap)


# --- furnaces -----------------------------------------------------------------------------------------


def furnace(material, cosine):
    """What a surface reflects of light 1 from everywhere, seen at an angle."""
    sine = np.sqrt(1.0 - cosine**2)
    camera = Camera([0, -2 * sine, 2 * cosine], [0, 0, 0], fov=1.0, width=1, height=1, up=[1, 0, 0])
    scene = Scene(camera, [floor(material)], [SphereLight([0, 0, 0], 50.0, 1.0)])
    return estimate(scene, Pmj(), BalanceHeuristic(), 2048, replicates=8)[1]


@pytest.mark.parametrize("cosine", [1.0, 0.5, 0.1])
def test_furnace(cosine):
    np.testing.assert_allclose(furnace(Diffuse([0.2, 0.5, 1.0]), cosine).value, [[0.2, 0.5, 1.0]], rtol=1e-4)
    for roughness in (0.03, 0.3, 1.0):
        white = furnace(Plastic(1.0, roughness), cosine)
        np.testing.assert_allclose(white.value, 1.0, atol=5e-3)
        assert (furnace(Plastic(0.0, roughness), cosine).value < 0.7).all()
        perfect = furnace(Conductor(eta=[1e-3] * 3, k=[1e3] * 3, roughness=roughness), cosine)
        assert (perfect.value <= 1.0 + 4.0 * perfect.stderr + 1e-4).all()
        assert (perfect.value > (0.95 if roughness < 0.1 else 0.3)).all()


def test_the_table_of_a_coat_is_what_the_furnace_says():
    for roughness in (0.05, 0.5):
        albedo, transmitted = coat_table(roughness, 1.5)
        black = furnace(Plastic(0.0, roughness), 0.5)
        assert black.value[0, 0] == pytest.approx(np.interp(0.5, np.linspace(0, 1, len(albedo)), albedo), rel=5e-3)
        assert 0.85 < transmitted < 1.0


def test_metals_have_the_colours_of_metals():
    """Reflectance at normal incidence: silver and aluminium bright, gold and copper reddish, chromium dull."""
    at = {m: [((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2) for n, k in zip(*METALS[m], strict=True)] for m in METALS}
    assert min(at["silver"]) > 0.96
    assert min(at["aluminium"]) > 0.90
    assert at["gold"] == pytest.approx([0.96, 0.80, 0.40], abs=0.05)
    assert at["copper"] == pytest.approx([0.93, 0.62, 0.54], abs=0.05)
    assert at["chromium"] == pytest.approx([0.55, 0.56, 0.55], abs=0.05)


# Wavelength in micrometres, refractive index and extinction as published, around 650, 550 and 450 nm: Johnson and
# Christy, Phys. Rev. B 6, 4370 (1972) and 9, 5056 (1974); for aluminium Rakic et al., Appl. Opt. 37, 5271 (1998).
PUBLISHED = {
    "silver": [(0.4305, 0.04, 2.462), (0.4509, 0.04, 2.657), (0.5486, 0.06, 3.586), (0.5821, 0.05, 3.858),
               (0.6168, 0.06, 4.152), (0.6595, 0.05, 4.483)],
    "gold": [(0.4305, 1.45, 1.948), (0.4509, 1.38, 1.914), (0.5486, 0.43, 2.455), (0.5821, 0.29, 2.863),
             (0.6168, 0.21, 3.272), (0.6595, 0.14, 3.697)],
    "copper": [(0.4305, 1.25, 2.305), (0.4509, 1.24, 2.397), (0.5486, 1.02, 2.577), (0.5821, 0.70, 2.704),
               (0.6168, 0.30, 3.205), (0.6595, 0.22, 3.747)],
    "chromium": [(0.431, 2.19, 3.04), (0.451, 2.33, 3.14), (0.549, 3.18, 3.33), (0.582, 3.22, 3.30),
                 (0.617, 3.17, 3.30), (0.659, 3.09, 3.34)],
    "aluminium": [(0.43962, 0.58336, 5.1830), (0.45833, 0.64439, 5.3994), (0.54147, 0.93525, 6.3099),
                  (0.56452, 1.0162, 6.5519), (0.63971, 1.2952, 7.3576), (0.66693, 1.4286, 7.6672)],
}  # fmt: skip


def test_metals_are_as_published():
    assert set(PUBLISHED) == set(METALS)
    for metal, rows in PUBLISHED.items():
        wavelength, *constants = np.array(rows).T
        for of, published in zip(METALS[metal], constants, strict=True):
            assert of == pytest.approx(np.interp([0.65, 0.55, 0.45], wavelength, published), rel=1e-4), metal


# --- lobes --------------------------------------------------------------------------------------------


@wp.kernel(enable_backward=False)
def _lobes(
    first: wp.int32,
    surfaces: wp.array(dtype=Surface),
    coat: wp.array2d(dtype=wp.float64),
    out: wp.array(dtype=wp.vec3d),
    w: wp.array(dtype=wp.vec3d),
    u: wp.array(dtype=wp.vec3d),
    f: wp.array(dtype=wp.vec3d),
    pdf: wp.array(dtype=wp.float64),
    sampled: wp.array(dtype=wp.vec3d),
):
    row = first + wp.tid()
    lobes = reflect_any(surfaces[row], coat, out[row], w[row])
    f[row] = lobes.whole
    pdf[row] = lobes.pdf
    sampled[row] = sample_any(surfaces[row], coat, out[row], u[row][0], u[row][1], u[row][2])


def lobes(material, out, w, u=None):
    """f (m, 3), density (m,) and sampled directions (m, 3) of a material."""
    out, w = np.broadcast_arrays(np.asarray(out, dtype=float), np.asarray(w, dtype=float))
    u = np.zeros_like(out) if u is None else u
    world = assemble([open_floor(material=material)])
    rows = np.repeat(_material_rows([material], world.coats), len(out))
    f, pdf, sampled = np.zeros((len(out), 3)), np.zeros(len(out)), np.zeros((len(out), 3))
    given = [array(np.ascontiguousarray(a), wp.vec3d) for a in (out, w, u)]
    results = [array(f, wp.vec3d), array(pdf, wp.float64), array(sampled, wp.vec3d)]
    launch(_lobes, len(out), [rows_of(Surface, rows), world.struct.coat, *given, *results])
    return f, pdf, sampled


def directions(cosine, phi):
    sine = np.sqrt(1.0 - np.square(cosine))
    return np.stack(np.broadcast_arrays(sine * np.cos(phi), sine * np.sin(phi), cosine), axis=-1)


MATERIALS = [
    Diffuse([0.2, 0.5, 0.8]),
    Conductor("gold", 0.4),
    Conductor("silver", 0.08),
    Plastic([0.2, 0.5, 0.8], 0.3),
    Plastic(0.9, 0.08, ior=1.3),
]
IDS = ["diffuse", "gold", "silver", "plastic", "thin plastic"]


@pytest.mark.parametrize("material", MATERIALS, ids=IDS)
def test_reciprocity(material):
    rng = np.random.default_rng(0)
    a, b = (directions(rng.uniform(0.02, 1.0, 500), rng.uniform(0, 2 * np.pi, 500)) for _ in range(2))
    np.testing.assert_allclose(lobes(material, a, b)[0], lobes(material, b, a)[0], rtol=1e-9)


@pytest.mark.parametrize("material", MATERIALS, ids=IDS)
@pytest.mark.parametrize("cosine", [1.0, 0.6, 0.2])
def test_densities_are_those_of_the_samples(material, cosine):
    """The density over the upper hemisphere integrates to the chance that a sample lies there, and so do moments."""
    node, weight = np.polynomial.legendre.leggauss(400)
    z, phi = np.meshgrid(0.5 * (node + 1.0), 2 * np.pi * (np.arange(400) + 0.5) / 400, indexing="ij")
    cell = np.broadcast_to(0.5 * weight[:, None] * 2 * np.pi / 400, z.shape).ravel()
    w = directions(z.ravel(), phi.ravel())
    out = directions(np.full(1, cosine), 0.3)
    pdf = lobes(material, out, w)[1] * cell
    u = torch.quasirandom.SobolEngine(3, scramble=True, seed=1).draw(2**15).double().numpy()
    sampled = lobes(material, np.repeat(out, len(u), axis=0), out, u)[2]
    up = sampled[:, 2] > 0.0
    assert pdf.sum() == pytest.approx(up.mean(), abs=4e-3)
    for moment in (lambda d: d[:, 0], lambda d: d[:, 2], lambda d: d[:, 0] * d[:, 1], lambda d: d[:, 2] ** 2):
        assert (moment(w) * pdf).sum() == pytest.approx((moment(sampled) * up).mean(), abs=4e-3)


# --- choosing lights ----------------------------------------------------------------------------------


def test_lights_are_chosen_as_often_as_is_said():
    rng = np.random.default_rng(1)
    lights = [
        SphereLight([*rng.uniform(-1, 1, 2), rng.uniform(0.3, 1)], rng.uniform(0.02, 0.1), rng.uniform(0, 9, 3))
        for _ in range(7)
    ]
    problem = DirectProblem.of(open_floor(lights, width=3, height=3), effects=EVERYTHING)
    x = torch.rand(9, 4096, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    x[..., 3] = (torch.arange(4096) + 0.5) / 4096
    seen = problem.evaluate(x).features
    light, chance, ratio = (seen[name][:, :, 1] for name in ("light", "chance", "nee_ratio"))
    for row in range(9):
        total = 0.0
        for j in range(7):
            of = light[row, :, 0] == j
            said = chance[row][of].unique()
            assert len(said) == 1  # the same from above and from below the tree
            assert of.double().mean().item() == pytest.approx(float(said[0]), abs=2.0 / 4096)
            total += float(said[0])
        assert total == pytest.approx(1.0, abs=1e-12)
        mean = sum(ratio[row][light[row, :, 0] == j][0] * chance[row][light[row, :, 0] == j][0] for j in range(7))
        np.testing.assert_allclose(mean, 1.0, rtol=1e-12)  # the chances of each colour sum to 1, too


def test_trees_hold_all_lights():
    rng = np.random.default_rng(2)
    centre, radius, emission = rng.normal(size=(20, 3)), rng.uniform(0.1, 0.5, 20), rng.random((20, 3))
    tree = light_tree(centre, radius, emission)
    assert sorted(tree.light[tree.light >= 0]) == list(range(20))
    for node in range(len(tree.child)):
        at = tree.parent[node]
        if at >= 0:
            inside = np.linalg.norm(tree.centre[at] - tree.centre[node])
            leaf = tree.light[node]
            if leaf >= 0:
                assert inside + radius[leaf] <= tree.radius[at] + 1e-12
    np.testing.assert_allclose(tree.power[0, :3], (emission * radius[:, None] ** 2).sum(axis=0))
