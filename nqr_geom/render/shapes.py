"""What stands in a scene: triangle meshes, quads and spheres, each of one material."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nqr_geom import check
from nqr_geom.render.materials import Checker, Conductor, Diffuse, Image, Material, Plastic

__all__ = ["Mesh", "Quad", "Shape", "Sphere"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_LEAST_SINE = 1e-12  # a triangle whose corner is flatter has no normal


def _material(value: Any) -> Material:
    if not isinstance(value, (Diffuse, Conductor, Plastic)):
        raise TypeError(f"material: expected Diffuse, Conductor or Plastic, got {type(value).__name__}")
    return value


def _textured(material: Material) -> bool:
    return isinstance(getattr(material, "albedo", None), (Checker, Image))


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh, seen from both sides.

    Parameters
    ----------
    vertices : (n, 3) array_like
        Finite.
    faces : (m, 3) array_like of int
        Corners of each triangle. Triangles without area are left out.
    material : Diffuse, Conductor or Plastic
    uv : (n, 2) array_like, optional
        Texture coordinates; a textured material needs them.
    normals : (n, 3) array_like, optional
        Normals at the vertices for smooth shading; any length but zero.

    Examples
    --------
    >>> Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2], [0, 1, 1]], Diffuse(0.5)).faces
    array([[0, 1, 2]])
    """

    vertices: Any
    faces: Any
    material: Material = field(default_factory=Diffuse)
    uv: Any = None
    normals: Any = None

    def __post_init__(self) -> None:
        vertices = check.array("vertices", self.vertices, ("n", 3))
        given = check.array("faces", self.faces, ("m", 3))
        faces = given.astype(np.int64)
        if (faces != given).any() or (len(faces) and (faces.min() < 0 or faces.max() >= len(vertices))):
            raise ValueError(f"faces: expected integers in [0, {len(vertices)}), got others")
        a, b = (vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2))
        size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces[np.linalg.norm(np.cross(a, b), axis=1) > _LEAST_SINE * size])
        object.__setattr__(self, "material", _material(self.material))
        if self.uv is not None:
            object.__setattr__(self, "uv", check.array("uv", self.uv, (len(vertices), 2)))
        elif _textured(self.material):
            raise ValueError("uv: expected texture coordinates for a textured material, got none")
        if self.normals is not None:
            normals = check.array("normals", self.normals, (len(vertices), 3))
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            used = np.unique(self.faces)
            if not (length[used] > 0.0).all():
                raise ValueError("normals: expected a length > 0 at every vertex that a face uses, got 0")
            object.__setattr__(self, "normals", normals / np.where(length > 0.0, length, 1.0))

    @classmethod
    def from_pyvista(cls, surface: Any, material: Material, *, smooth: bool = False) -> Mesh:
        """A PyVista surface; its texture coordinates come along.

        Parameters
        ----------
        surface : pyvista.PolyData
            Polygons are cut into triangles.
        material : Diffuse, Conductor or Plastic
        smooth : bool
            Shade with normals at the vertices, split where faces meet at more than 30 degrees.
        """
        surface = surface.triangulate()
        if smooth:
            surface = surface.compute_normals(cell_normals=False, split_vertices=True, auto_orient_normals=False)
        normals = np.asarray(surface.point_data["Normals"], dtype=np.float64) if smooth else None
        if normals is not None:
            length = np.linalg.norm(normals, axis=1)
            normals[~(length > 0.0)] = (0.0, 0.0, 1.0)  # vertices of triangles without area
        uv = surface.active_texture_coordinates
        faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
        return cls(np.asarray(surface.points, dtype=np.float64), faces, material, uv, normals)

    @classmethod
    def from_file(cls, path: str | Path, material: Material, *, smooth: bool = False) -> Mesh:
        """A mesh file that PyVista reads: .ply, .obj, .stl, .vtp, .off, .glb and more.

        Raises
        ------
        ValueError
            If there is no such file, or no surface in it.
        """
        pv = check.require("pyvista", "plot", "mesh files")
        if not Path(path).is_file():
            raise ValueError(f"path: expected an existing mesh file, got {str(path)!r}")
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # VTK's reader complains, then gives an empty mesh
                read = pv.read(path)
            surface = read.combine().extract_surface(algorithm=None) if isinstance(read, pv.MultiBlock) else read
            surface = surface if isinstance(surface, pv.PolyData) else surface.extract_surface(algorithm=None)
            if not surface.n_cells:
                raise OSError("no faces")
        except (OSError, AttributeError, KeyError) as error:
            raise ValueError(f"path: expected a mesh file that PyVista reads, got {str(path)!r} ({error})") from error
        return cls.from_pyvista(surface, material, smooth=smooth)

    def moved(self, shift: ArrayLike = (0.0, 0.0, 0.0), *, scale: float = 1.0, turn: float = 0.0) -> Mesh:
        """The mesh scaled about the origin, turned about the z axis by `turn` degrees, then shifted.

        Examples
        --------
        >>> Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]).moved([0, 0, 1], turn=90).vertices.round(9)[1] + 0.0
        array([0., 1., 1.])
        """
        angle = np.radians(check.number("turn", turn))
        c, s = np.cos(angle), np.sin(angle)
        rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        factor = check.number("scale", scale, low=0.0, open_low=True)
        vertices = factor * self.vertices @ rotation + check.array("shift", shift, (3,))
        normals = None if self.normals is None else self.normals @ rotation
        return Mesh(vertices, self.faces, self.material, self.uv, normals)


class Quad(Mesh):
    """A parallelogram with texture coordinates from 0 to 1.

    Parameters
    ----------
    corner, u, v : (3,) array_like
        One corner and its two edges.
    material : Diffuse, Conductor or Plastic

    Examples
    --------
    >>> Quad([0, 0, 0], [1, 0, 0], [0, 2, 0]).vertices[2]
    array([1., 2., 0.])
    """

    def __init__(self, corner: ArrayLike, u: ArrayLike, v: ArrayLike, material: Material | None = None) -> None:
        corner, u, v = check.array("corner", corner, (3,)), check.array("u", u, (3,)), check.array("v", v, (3,))
        if not np.linalg.norm(np.cross(u, v)) > 0.0:
            raise ValueError(f"u: expected edges that span an area, got {u.tolist()} and {v.tolist()}")
        vertices = [corner, corner + u, corner + u + v, corner + v]
        uv = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
        super().__init__(vertices, [[0, 1, 2], [0, 2, 3]], material or Diffuse(), uv)


@dataclass(frozen=True, eq=False)
class Sphere:
    """An exact sphere, seen from both sides; textures run around the z axis.

    Parameters
    ----------
    center : (3,) array_like
    radius : float
        > 0.
    material : Diffuse, Conductor or Plastic
    """

    center: Any
    radius: float
    material: Material = field(default_factory=Diffuse)

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", check.array("center", self.center, (3,)))
        object.__setattr__(self, "radius", check.number("radius", self.radius, low=0.0, open_low=True))
        object.__setattr__(self, "material", _material(self.material))


Shape = Mesh | Sphere
