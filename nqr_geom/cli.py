"""The command line: fields of a curve as pictures or arrays, and what their accuracy costs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from cyclopts import App, CycloptsError, Parameter
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

import nqr_geom as ng
from nqr_geom import check, registry

if TYPE_CHECKING:
    from nqr_geom.curves.curve import Curve
    from nqr_geom.integrator.frontier import Frontier

__all__ = ["app", "main"]

app = App(
    name="nqr-geom",
    version=ng.__version__,
    help="Winding numbers and distances of curves you bring, and what accuracy costs in time.",
    result_action="return_value",
)
out_console = Console(markup=False)
error_console = Console(stderr=True, markup=False)

Source = Annotated[
    str, Parameter(help="An SVG file, SVG path data, or a .npy file with the points of a polyline (n, 2).")
]
Text = Annotated[bool, Parameter(help="Take SOURCE as text and use its outlines.")]
Method = Annotated[str, Parameter(help="exact, auto, mc, stratified, trapezoid, structured, inet, or sampler+rule.")]
Samples = Annotated[int, Parameter(name=["--samples", "-n"], help="Samples per query of a sampled method.")]
Resolution = Annotated[int, Parameter(help="Grid lines of the picture's longer side.")]
Seed = Annotated[int, Parameter(help="Seed of a sampled method.")]
Out = Annotated[Path, Parameter(help="A picture (.png), values (.npy), or a grid for ParaView (.vti, .vtp).")]


def _read(source: str, text: bool) -> Curve:
    """The curve a user names on the command line."""
    if text:
        return ng.Curve.from_text(source)
    if source.lower().endswith(".npy"):
        if not Path(source).is_file():
            raise ValueError(f"source: expected an existing file, got {source!r}")
        points = np.load(source, allow_pickle=False)
        return ng.Curve.polyline(points, closed=bool(len(points) > 2 and (points[0] == points[-1]).all()))
    return ng.Curve.from_svg(source, flip_y=True)


def _read_outline(source: str, text: bool, out: Path) -> tuple[Curve, Any]:
    """A closed outline and the polygon in it, once `out` is known to be writable: solving first takes long.

    Vertices of an array keep their order, so that values can be given for each.
    """
    from nqr_geom.pictures import ENDINGS

    check.choice("out", out.suffix.lower(), ENDINGS)
    curve = _read(source, text)
    return curve, np.load(source, allow_pickle=False) if source.lower().endswith(".npy") and not text else curve


def _progress() -> Progress:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=error_console, transient=True)


def _field(
    curve: Curve,
    answer: Callable[[Any, int], Any],
    out: Path,
    resolution: int,
    name: str,
    signed: bool,
    seed: int = 0,
) -> None:
    """Evaluate a field on a grid around the curve, band by band under a progress bar, and save it.

    `answer` takes points and a seed; every band has its own, or the noise of sampled methods would repeat.
    """
    from nqr_geom.pictures import ENDINGS, Window, save_field

    check.choice("out", out.suffix.lower(), ENDINGS)
    window = Window.around(curve.bounds, resolution)
    bands = np.array_split(window.points, max(1, len(window.points) // 16384))
    with _progress() as progress:
        numbered = progress.track(list(enumerate(bands)), description=name)
        values = [answer(band, seed + (k << 32)) for k, band in numbered]
    path = save_field(out, curve, window, np.concatenate(values), name=name, signed=signed)
    out_console.print(f"{curve!r}: wrote {path}", highlight=False)


@app.command
def gwn(
    source: Source,
    *,
    text: Text = False,
    method: Method = "exact",
    samples: Samples = 32,
    resolution: Resolution = 256,
    seed: Seed = 0,
    out: Out = Path("gwn.png"),
) -> None:
    """Draw the generalised winding number of a curve."""
    curve = _read(source, text)

    def answer(points: Any, seed: int) -> Any:
        return ng.gwn(curve, points, method=method, n=samples, seed=seed)

    _field(curve, answer, out, resolution, "winding number", signed=True, seed=seed)


@app.command
def sd(
    source: Source,
    *,
    text: Text = False,
    alpha: Annotated[float, Parameter(help="Sharpness in units of one over the curve's size.")] = 35.0,
    method: Method = "exact",
    samples: Samples = 32,
    resolution: Resolution = 256,
    seed: Seed = 0,
    out: Out = Path("sd.png"),
) -> None:
    """Draw the smoothed distance to a curve."""
    curve = _read(source, text)
    xmin, ymin, xmax, ymax = curve.bounds
    sharpness = alpha / (0.5 * max(xmax - xmin, ymax - ymin) or 1.0)

    def answer(points: Any, seed: int) -> Any:
        return ng.sd(curve, points, alpha=sharpness, method=method, n=samples, seed=seed)

    _field(curve, answer, out, resolution, "smoothed distance", signed=False, seed=seed)


@app.command
def distance(
    source: Source,
    *,
    text: Text = False,
    signed: Annotated[bool, Parameter(help="Negative inside (non-zero winding).")] = False,
    resolution: Resolution = 256,
    out: Out = Path("distance.png"),
) -> None:
    """Draw the distance to a curve."""
    curve = _read(source, text)
    answer = ng.signed_distance if signed else ng.distance
    _field(curve, lambda points, _: answer(curve, points), out, resolution, "distance", signed=signed)


def _values(name: str, bounds: tuple[float, float, float, float]) -> Any:
    """Boundary values a user names: a file with one a vertex, or a function that is simple in the outline's box."""
    if name.lower().endswith(".npy"):
        if not Path(name).is_file():
            raise ValueError(f"values: expected an existing file, got {name!r}")
        return np.load(name, allow_pickle=False)
    middle = 0.5 * np.array([bounds[0] + bounds[2], bounds[1] + bounds[3]])
    half = 0.5 * max(bounds[2] - bounds[0], bounds[3] - bounds[1])
    functions = {
        "x": lambda x, y: x,
        "y": lambda x, y: y,
        "saddle": lambda x, y: x * y,
        "waves": lambda x, y: np.cos(3.0 * np.arctan2(y, x)),
    }
    function = functions[check.choice("values", name, functions)]
    return lambda points: function(*((points - middle) / half).T)


@app.command
def laplace(
    source: Source,
    *,
    values: Annotated[
        str, Parameter(help="Boundary values: x, y, saddle, waves, or a .npy file with one a vertex of a .npy outline.")
    ] = "waves",
    method: Annotated[str, Parameter(help="auto, wos, wos-lhs, wos-rqmc, structured, inet, boundary or fem.")] = "auto",
    tol: Annotated[
        float, Parameter(help="Absolute error to aim for; the boundary solver goes to 1e-6 of the spread.")
    ] = 1e-3,
    samples: Annotated[
        int | None, Parameter(name=["--samples", "-n"], help="Walks per query instead of tol (all but boundary, fem).")
    ] = None,
    text: Text = False,
    resolution: Resolution = 256,
    seed: Seed = 0,
    out: Out = Path("laplace.png"),
) -> None:
    """Draw the harmonic function inside a closed outline."""
    from nqr_geom.wos.domain import Domain

    curve, polygon = _read_outline(source, text, out)
    domain, boundary = Domain.of(polygon), _values(values, curve.bounds)
    if method in ("auto", "boundary"):  # solved once for all bands of the picture
        from nqr_geom.wos.boundary import solve

        solution = solve(domain, domain.boundary(boundary), 1e-6)

        def answer(points: Any, seed: int) -> Any:
            return np.where(domain.inside(points), solution(points), np.nan)
    else:

        def answer(points: Any, seed: int) -> Any:
            return ng.solve_laplace(
                polygon, boundary, points, method=method, tol=tol, n=samples, seed=seed, outside="nan"
            )

    _field(curve, answer, out, resolution, "harmonic function", signed=False, seed=seed)


@app.command
def p_laplace(
    source: Source,
    *,
    p: Annotated[float, Parameter(help="The exponent, greater than 1.")] = 3.0,
    values: Annotated[
        str, Parameter(help="Boundary values: x, y, saddle, waves, or a .npy file with one a vertex of a .npy outline.")
    ] = "waves",
    method: Annotated[str, Parameter(help="fem, or inet: a network on walks, for p = 3.")] = "fem",
    tol: Annotated[float | None, Parameter(help="Refine until the estimated error is at most this (fem).")] = None,
    samples: Annotated[int, Parameter(name=["--samples", "-n"], help="Walks per query (inet).")] = 32,
    text: Text = False,
    resolution: Resolution = 256,
    seed: Seed = 0,
    out: Out = Path("p-laplace.png"),
) -> None:
    """Draw the p-harmonic function inside a closed outline."""
    from nqr_geom.p_harmonic import METHODS, p_harmonic

    check.choice("method", method, METHODS)
    curve, polygon = _read_outline(source, text, out)
    boundary = _values(values, curve.bounds)
    if method == "fem":  # solved once for all bands of the picture
        solution = p_harmonic(polygon, boundary, p, tol=tol)

        def answer(points: Any, seed: int) -> Any:
            return solution(points, outside="nan")
    else:

        def answer(points: Any, seed: int) -> Any:
            return ng.solve_p_laplace(
                polygon, boundary, points, p, method=method, n=samples, tol=tol, outside="nan", seed=seed
            )

    _field(curve, answer, out, resolution, f"p-harmonic, p = {p:g}", signed=False, seed=seed)


def _on_grid(problem: str, curve: Curve, resolution: int) -> tuple[Any, list[int]]:
    """A problem on a grid around a curve, and budgets from two samples a piece on."""
    from nqr_geom.pictures import Window

    points = Window.around(curve.bounds, resolution).points
    return getattr(ng.problems, problem)(curve, points), [2 * curve.n_pieces * k for k in (1, 2, 4)]


def _measure(problem: Any, methods: Sequence[str] | None, budgets: Sequence[int], runs: int) -> Frontier:
    with _progress() as progress:
        task = progress.add_task("measuring")

        def tick(done: int, total: int, label: str) -> None:
            progress.update(task, completed=done, total=total, description=label)

        return ng.frontier(problem, methods, budgets, runs=runs, tick=tick)


def _show(measured: Frontier, title: str) -> None:
    """Error against time as a table, one line a method and budget."""
    table = Table(title=title, box=box.SIMPLE_HEAD)
    table.add_column("method")
    for column in ("n", "us / query", "MSE", "95% interval", "x plain MC"):
        table.add_column(column, justify="right", no_wrap=True)
    for point in measured.points:
        low, high = point.mse_interval
        ratio = "" if point.ratio is None else f"{point.ratio:.3g}" if point.ratio < 1e9 else "> 1e9"
        table.add_row(
            point.method,
            str(point.n or ""),
            f"{1e6 * point.seconds:.3g}",
            f"{point.mse:.1e}",
            f"{low:.1e} .. {high:.1e}",
            ratio,
        )
    out_console.print(table)


def _report(title: str, estimate: Any) -> None:
    """What a scene or volume called for and what ran."""
    kernels = estimate.plan["kernels"]
    table = Table(title=title, box=box.SIMPLE_HEAD, show_header=False)
    table.add_row("effects", ", ".join(sorted(estimate.effects)) or "none")
    table.add_row("kernels", (kernels if isinstance(kernels, str) else ", ".join(kernels)) or "none")
    for kind, count in estimate.counts.items():
        table.add_row(kind, f"{count:,}")
    for stage, seconds in estimate.stages.items():
        table.add_row(f"seconds: {stage}", f"{seconds:.3f}")
    out_console.print(table)


@app.command
def render(
    scene: Annotated[
        str,
        Parameter(
            help="two-spheres, teaser, white-room, living-room, staircase, plates, a .json scene, or a mesh file "
            "to stand on a floor."
        ),
    ] = "two-spheres",
    *,
    method: Annotated[
        str, Parameter(help="random, mis, regression, structured, reference, or sampler+rule.")
    ] = "structured",
    spp: Annotated[int, Parameter(name=["--spp", "-n"], help="Passes a pixel.")] = 64,
    width: Annotated[int, Parameter(help="Pixels; a .json scene has its own.")] = 320,
    height: Annotated[int, Parameter(help="Pixels; a .json scene has its own.")] = 240,
    seed: Seed = 0,
    report: Annotated[bool, Parameter(help="Say what the scene calls for and what ran.")] = False,
    out: Annotated[Path, Parameter(help="A picture (.png), or linear radiance (.npy).")] = Path("render.png"),
) -> None:
    """Draw a scene under spherical lights by direct illumination."""
    from nqr_geom.render.scene_file import scene_named

    check.choice("out", out.suffix.lower(), (".png", ".npy"))
    made = scene_named(scene, width, height)
    from nqr_geom.render.direct_light import direct
    from nqr_geom.render.film import save_picture
    from nqr_geom.render.world import lights_seen

    estimate: Any = direct(made, spp=spp, method=method, seed=seed, full_output=True)
    image = estimate.value.reshape(made.camera.height, made.camera.width, 3)
    if out.suffix.lower() == ".png":
        image = image + lights_seen(made)
    path = save_picture(out, image)
    if report:
        _report(f"{scene}: {method}, {spp} passes", estimate)
    out_console.print(f"wrote {path}", highlight=False)


@app.command
def transmittance(
    source: Annotated[
        str, Parameter(help="cloud, donut, or a .npy file of densities (nx, ny, nz), whose longest side has length 1.")
    ] = "cloud",
    *,
    text: Annotated[bool, Parameter(help="Take SOURCE as text and fill its letters with cloud.")] = False,
    density: Annotated[float, Parameter(help="Times the densities.")] = 1.0,
    axis: Annotated[str, Parameter(help="Direction of the rays: x, y or z.")] = "z",
    method: Annotated[
        str,
        Parameter(
            help="stratified, random, trapezoid, regression, jackknife, structured, ratio, track-length, "
            "unbiased-raymarching, or sampler+rule."
        ),
    ] = "stratified",
    samples: Annotated[int, Parameter(name=["--samples", "-n"], help="Density queries per ray.")] = 24,
    resolution: Annotated[int, Parameter(help="Pixels of the picture's longer side.")] = 256,
    seed: Seed = 0,
    report: Annotated[bool, Parameter(help="Say what the volume calls for and what ran.")] = False,
    out: Annotated[Path, Parameter(help="A picture (.png) or values (.npy).")] = Path("transmittance.png"),
) -> None:
    """Draw the light that gets through a volume."""
    from nqr_geom.through import named_volume, save_image, see_through

    check.choice("out", out.suffix.lower(), (".png", ".npy"))
    volume = named_volume(source, text=text, density=density, seed=seed)
    image, estimate = see_through(volume, axis=axis, resolution=resolution, method=method, n=samples, seed=seed)
    if report:
        _report(f"{source}: {method}, {samples} queries", estimate)
    out_console.print(f"wrote {save_image(out, image)}", highlight=False)


@app.command
def frontier(
    problem: Annotated[str, Parameter(help="A random family: toy, gwn, sd, laplace or transmittance.")] = "gwn",
    *,
    input: Annotated[str | None, Parameter(help="Measure on your own curve instead (SVG, path data, .npy).")] = None,
    text: Text = False,
    methods: Annotated[list[str] | None, Parameter(help="Methods to compare; all that fit by default.")] = None,
    budgets: Annotated[list[int] | None, Parameter(help="Samples per integral.")] = None,
    shapes: Annotated[int, Parameter(help="Shapes (or toy integrands) of the random family.")] = 8,
    runs: Annotated[int, Parameter(help="Independent runs a point.")] = 16,
    out: Annotated[Path | None, Parameter(help="A chart (.png) or all figures (.json).")] = None,
) -> None:
    """Measure error against samples and time for every method on this machine."""
    check.choice("problem", problem, [entry.name for entry in registry.entries("problem")])
    if out is not None:
        check.choice("out", out.suffix.lower(), [".png", ".json"])
    if input is not None:
        if problem not in ("gwn", "sd"):
            raise ValueError(f"problem: expected gwn or sd for a curve of your own, got {problem!r}")
        made, usual = _on_grid(problem, _read(input, text), 24)
    else:
        family = registry.entry("problem", problem).load()
        grid = {"gwn": 24, "sd": 24, "transmittance": 16}
        size = {"resolution": grid[problem]} if problem in grid else {}
        made = family.family(check.integer("shapes", shapes, low=1), **size)  # type: ignore[attr-defined]
        usual = [8, 16, 32, 64]
    measured = _measure(made, methods, budgets or usual, runs)
    _show(measured, f"{problem}: error against time")
    if out is not None:
        measured.plot(out) if out.suffix.lower() == ".png" else measured.to_json(out)
        out_console.print(f"wrote {out}", highlight=False)


@app.command
def demo(
    *,
    out: Annotated[Path, Parameter(help="Folder for the pictures.")] = Path("demo-out"),
    resolution: Resolution = 400,
) -> None:
    """Winding numbers of a shipped SVG, smoothed distances of a text, and an error-against-time table."""
    from importlib.resources import as_file, files

    with as_file(files("nqr_geom") / "data" / "fish.svg") as path:
        gwn(str(path), resolution=resolution, out=out / "gwn-fish.png")
    letters = _read("nqr", text=True)
    sd("nqr", text=True, resolution=resolution, out=out / "sd-text.png")
    problem, budgets = _on_grid("gwn", letters, 16)
    measured = _measure(problem, ["mc", "stratified", "trapezoid", "structured"], budgets[:2], 8)
    _show(measured, f"winding number of the letters ({letters.n_pieces} pieces): error against time")
    chart = measured.plot(out / "error-against-time.png")
    out_console.print(f"wrote {chart}", highlight=False)


@app.command
def train(
    name: Annotated[str, Parameter(help="A recipe such as gwn-uniform, a pair such as gwn-nqr, or toy, gwn or sd.")],
    *,
    out: Annotated[Path, Parameter(help="Folder of the run; a run that is there is continued.")],
    iterations: Annotated[int, Parameter(help="Of the whole run, those already done included.")],
    decay: Annotated[int, Parameter(help="Last iterations, in which the learning rate falls to 0.")] = 0,
    batch: Annotated[int | None, Parameter(help="Integrals an iteration: 256, or 32 for a pair.")] = None,
    rate: Annotated[float | None, Parameter(help="Highest learning rate: 2e-3, or 5e-4 for a pair.")] = None,
    seed: Annotated[int, Parameter(help="Of weights and data.")] = 0,
    start_from: Annotated[
        Path | None,
        Parameter(help="Run whose trunk a new run takes over; for a pair, the run of the integrator it begins with."),
    ] = None,
    accelerator: Annotated[str, Parameter(help="cpu, gpu, or what else lightning-fabric knows.")] = "cpu",
    devices: Annotated[int, Parameter(help="Processes on this machine.")] = 1,
    num_nodes: Annotated[int, Parameter(help="Machines.")] = 1,
    publish: Annotated[Path | None, Parameter(help="Folder for the weights and their card, when done.")] = None,
) -> None:
    """Train the network of a recipe or both networks of a pair, or go on with a run that was interrupted."""
    check.require("torch", "learn", "training runs")
    from nqr_geom.integrator.learn.joint import JointConfig, JointRecipe, train_jointly
    from nqr_geom.integrator.learn.publish import publish as make_model
    from nqr_geom.integrator.learn.train import TrainConfig
    from nqr_geom.integrator.learn.train import train as train_one
    from nqr_geom.recipes import named

    recipe = named(name)
    options: dict[str, Any] = {"iterations": iterations, "decay": decay, "seed": seed}
    options |= {key: value for key, value in (("batch", batch), ("rate", rate)) if value is not None}
    where: dict[str, Any] = {"accelerator": accelerator, "devices": devices, "num_nodes": num_nodes}
    if isinstance(recipe, JointRecipe):
        train_jointly(recipe, out, JointConfig(**options), start_from=start_from, **where)
    else:
        train_one(recipe, out, TrainConfig(**options), start_from=start_from, **where)
    out_console.print(f"wrote {out}", highlight=False)
    if publish is not None:
        card = make_model(recipe, out, publish, command=f"nqr-geom train {recipe.name} --iterations {iterations}")
        out_console.print(f"wrote {publish / card.name}.safetensors", highlight=False)


@app.command(name="list")
def list_(kind: Annotated[str, Parameter(help="sampler, rule, problem or model.")] = "rule") -> None:
    """List what there is: samplers, rules, problems or models."""
    table = Table()
    table.add_column("name", no_wrap=True)
    for column in ("what it does", "exact on", "dimensions"):
        table.add_column(column)
    for entry in registry.entries(kind):
        table.add_row(entry.name, entry.summary, entry.exact if kind == "rule" else "", entry.dims)
    out_console.print(table)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; bad input gives one clear line and exit code 2."""
    try:
        app(arguments, exit_on_error=False, print_error=True)
    except CycloptsError:
        return 2
    except (ValueError, TypeError, ImportError, OSError, RuntimeError) as error:
        error_console.print(f"error: {error}", style="red", highlight=False, soft_wrap=True)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
