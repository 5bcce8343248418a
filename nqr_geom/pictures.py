"""Pictures of fields around a curve, drawn with PyVista off screen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.curves.curve import BlackBoxCurve, Curve

__all__ = ["ENDINGS", "Window", "draw_field", "draw_row", "save_field"]

Floats = NDArray[np.float64]

ENDINGS = (".png", ".npy", ".vti", ".vtp")  # what `save_field` writes

_BAR = 110  # pixels below the field for its colour bar
_BAR_STYLE = {
    "color": "black",
    "n_labels": 5,
    "fmt": "%.2g",
    "title_font_size": 22,
    "label_font_size": 18,
    "position_x": 0.2,
    "position_y": 0.01,
    "width": 0.6,
    "height": 0.09,
}


@dataclass(frozen=True)
class Window:
    """A grid of query points around a curve.

    Parameters
    ----------
    x, y : ndarray, (nx,) and (ny,)
        Coordinates of the grid lines.
    """

    x: Floats
    y: Floats

    @classmethod
    def around(cls, bounds: tuple[float, float, float, float], resolution: int = 256, margin: float = 0.15) -> Window:
        """A window over `bounds` (xmin, ymin, xmax, ymax), `margin` of its longer side wider on each side.

        `resolution` counts the grid lines of the longer side; the cells are square.

        Examples
        --------
        >>> Window.around((0.0, 0.0, 2.0, 1.0), resolution=8).points.shape
        (40, 2)
        """
        resolution = check.integer("resolution", resolution, low=2)
        xmin, ymin, xmax, ymax = bounds
        side = max(xmax - xmin, ymax - ymin) or 1.0
        pad = margin * side
        step = (side + 2.0 * pad) / resolution
        nx, ny = (max(2, int(np.ceil((high - low + 2.0 * pad) / step))) for low, high in ((xmin, xmax), (ymin, ymax)))
        x = 0.5 * (xmin + xmax) + step * (np.arange(nx) - 0.5 * (nx - 1))
        y = 0.5 * (ymin + ymax) + step * (np.arange(ny) - 0.5 * (ny - 1))
        return cls(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))

    @property
    def points(self) -> Floats:
        """All grid points (ny * nx, 2), x running fastest."""
        return np.stack(np.meshgrid(self.x, self.y), axis=-1).reshape(-1, 2)


def _image(window: Window, values: Floats, name: str, cells: bool = False) -> Any:
    """The values on a grid: at its points, or as constant cells around them, which keeps jumps sharp."""
    pv = check.require("pyvista", "plot", "pictures")
    step = window.x[1] - window.x[0]
    image = pv.ImageData(
        dimensions=(len(window.x) + cells, len(window.y) + cells, 1),
        spacing=(step, step, step),
        origin=(window.x[0] - 0.5 * cells * step, window.y[0] - 0.5 * cells * step, 0.0),
    )
    (image.cell_data if cells else image.point_data)[name] = values
    return image


@contextmanager
def _plotter(pixels: tuple[int, int], columns: int = 1) -> Iterator[Any]:
    """An off-screen plotter; VTK's complaint that there is no display, which it does not need, is not shown."""
    pv = check.require("pyvista", "plot", "pictures")
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    plotter = pv.Plotter(off_screen=True, window_size=pixels, shape=(1, columns), border=False)
    try:
        yield plotter
    finally:
        plotter.close()
        vtkLogger.SetStderrVerbosity(before)


def _outline(curve: Curve, tolerance: float) -> Any:
    """The curve as lines, cut finely enough that no corner shows."""
    pv = check.require("pyvista", "plot", "pictures")
    if isinstance(curve, BlackBoxCurve):
        ends = curve.sample(np.linspace(0.0, 1.0, 2001, endpoint=False))
        segments = np.stack([ends[:-1], ends[1:]], axis=1)
    else:
        segments = curve.to_polyline(tolerance).control[:, :2]
    points = np.zeros((2 * len(segments), 3))
    points[:, :2] = segments.reshape(-1, 2)
    lines = np.column_stack([np.full(len(segments), 2), np.arange(2 * len(segments)).reshape(-1, 2)])
    return pv.PolyData(points, lines=lines.ravel())


def draw_field(
    path: str | Path,
    curve: Curve,
    window: Window,
    values: Floats,
    *,
    name: str,
    signed: bool = False,
    contours: int = 0,
) -> Path:
    """Draw a field in a window with the curve on top, and write a PNG.

    Parameters
    ----------
    path : str or Path
        Where to write.
    curve : Curve
        Drawn as a line.
    window : Window
        The grid.
    values : (ny * nx,) ndarray
        The field on the window's points; NaN stays blank.
    name : str
        Title of the colour bar.
    signed : bool
        Centre the colours on zero.
    contours : int
        How many level lines to draw.

    Returns
    -------
    Path
        The file written.
    """
    wide, high = np.ptp(window.x), np.ptp(window.y)
    extent = max(wide, high)
    pixels = (int(900 * wide / extent), int(900 * high / extent) + _BAR)
    finite = values[np.isfinite(values)]
    low, top = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    if signed:
        top = max(abs(low), abs(top), 1e-12)
        low = -top
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    aside = target.with_name(f".{target.stem}.part.png")
    with _plotter(pixels) as plotter:
        plotter.set_background("white")
        plotter.add_mesh(
            _image(window, values, name, cells=True),
            cmap="RdBu_r" if signed else "viridis",
            clim=(low, top),
            lighting=False,
            nan_opacity=0.0,
            scalar_bar_args={"title": name, **_BAR_STYLE},
        )
        plotter.scalar_bar.SetVerticalTitleSeparation(8)  # pixels between title and labels
        if contours and top > low:
            levels = _image(window, values, name).contour(np.linspace(low, top, contours + 2)[1:-1], scalars=name)
            if levels.n_points:
                plotter.add_mesh(levels.translate((0, 0, 1e-4 * extent)), color="white", line_width=1, opacity=0.6)
        outline = _outline(curve, 1e-4 * extent).translate((0.0, 0.0, 2e-4 * extent))
        plotter.add_mesh(outline, color="black", line_width=3, lighting=False)
        _look_down(plotter, window, _BAR / pixels[1])
        plotter.screenshot(aside)
    aside.replace(target)
    return target


def draw_row(
    path: str | Path, curve: Curve, window: Window, fields: Mapping[str, Floats], *, contours: int = 0
) -> Path:
    """Draw several fields in the same window side by side, with one range of colours, and write a PNG.

    Parameters
    ----------
    path : str or Path
        Where to write.
    curve : Curve
        Drawn as a line over each field.
    window : Window
        The grid.
    fields : mapping of str to (ny * nx,) ndarray
        Title and values of each field; NaN stays blank.
    contours : int
        How many level lines to draw.

    Returns
    -------
    Path
        The file written.
    """
    wide, high = np.ptp(window.x), np.ptp(window.y)
    extent = max(wide, high)
    finite = np.concatenate([values[np.isfinite(values)] for values in fields.values()])
    low, top = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    aside = target.with_name(f".{target.stem}.part.png")
    pixels = (int(450 * wide / extent) * len(fields), int(450 * high / extent) + _BAR)
    outline = _outline(curve, 1e-4 * extent).translate((0.0, 0.0, 2e-4 * extent))
    with _plotter(pixels, len(fields)) as plotter:
        for column, (name, values) in enumerate(fields.items()):
            plotter.subplot(0, column)
            plotter.set_background("white")
            image = _image(window, values, name, cells=True)
            plotter.add_mesh(
                image, cmap="viridis", clim=(low, top), lighting=False, nan_opacity=0.0, show_scalar_bar=False
            )
            if contours and top > low:
                levels = _image(window, values, name).contour(np.linspace(low, top, contours + 2)[1:-1], scalars=name)
                if levels.n_points:
                    plotter.add_mesh(levels.translate((0, 0, 1e-4 * extent)), color="white", line_width=2)
            plotter.add_mesh(outline, color="black", line_width=3, lighting=False)
            plotter.add_text(name, position=(0.4, 0.06), viewport=True, font_size=14, color="black")
            _look_down(plotter, window, _BAR / pixels[1])
        plotter.screenshot(aside)
    aside.replace(target)
    return target


def _look_down(plotter: Any, window: Window, bar: float) -> None:
    """Fill the picture with the window, except for the lowest part `bar` of it."""
    extent = max(np.ptp(window.x), np.ptp(window.y))
    span = np.ptp(window.y) / (1.0 - bar)
    x = 0.5 * (window.x[0] + window.x[-1])
    y = 0.5 * (window.y[0] + window.y[-1]) - 0.5 * bar * span
    plotter.camera_position = [(x, y, 10.0 * extent), (x, y, 0.0), (0.0, 1.0, 0.0)]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = 0.5 * span
    plotter.camera.clipping_range = (extent, 20.0 * extent)


def save_field(
    path: str | Path, curve: Curve, window: Window, values: Floats, *, name: str, signed: bool = False
) -> Path:
    """Write a field by the ending of `path`: .png a picture, .npy the values (ny, nx), .vti or .vtp for ParaView.

    A .vtp holds the curve as lines and a .vti the grid with the values.

    Raises
    ------
    ValueError
        If the ending is none of these.
    """
    target = Path(path)
    ending = check.choice("out", target.suffix.lower(), ENDINGS)
    if ending == ".png":
        return draw_field(target, curve, window, values, name=name, signed=signed, contours=0 if signed else 14)
    target.parent.mkdir(parents=True, exist_ok=True)
    aside = target.with_name(f".{target.stem}.part{ending}")
    if ending == ".npy":
        np.save(aside, values.reshape(len(window.y), len(window.x)))
    elif ending == ".vti":
        _image(window, values, name).save(aside)
    else:
        image = _image(window, values, name)
        image.extract_surface(algorithm=None).save(aside)
    aside.replace(target)
    return target
