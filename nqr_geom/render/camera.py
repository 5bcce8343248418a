"""A pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nqr_geom import check
from nqr_geom.streams import Stream

__all__ = ["Camera"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera with square pixels.

    Parameters
    ----------
    position, look_at : (3,) array_like
        Where it stands and what stays in the middle of the picture.
    fov : float
        Angle that the picture's height spans, in degrees, in (0, 170].
    width, height : int
        Pixels.
    up : (3,) array_like
        Direction that is up in the picture; not along the line of sight.

    Examples
    --------
    >>> camera = Camera([0, -4, 1], [0, 0, 1], width=3, height=1)
    >>> camera.rays()[1].round(3)
    array([0., 1., 0.])
    """

    position: Any
    look_at: Any
    fov: float = 45.0
    width: int = 128
    height: int = 128
    up: Any = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        for name in ("position", "look_at", "up"):
            object.__setattr__(self, name, check.array(name, getattr(self, name), (3,)))
        object.__setattr__(self, "fov", check.number("fov", self.fov, low=0.0, high=170.0, open_low=True))
        for name in ("width", "height"):
            object.__setattr__(self, name, check.integer(name, getattr(self, name), low=1, high=2**14))
        ahead = np.subtract(self.look_at, self.position)
        size = np.linalg.norm(ahead) * np.linalg.norm(self.up)
        if not np.linalg.norm(np.cross(ahead, self.up)) > 1e-9 * size:
            raise ValueError(f"up: expected a direction that is not along the line of sight, got {self.up}")

    def rays(self, jitter: Stream | None = None) -> Floats:
        """Unit directions through the pixels, row by row from the top left, (height * width, 3).

        Parameters
        ----------
        jitter : Stream, optional
            Directions go through a random point of each pixel instead of its middle.
        """
        ahead = np.subtract(self.look_at, self.position)
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, self.up)
        right = right / np.linalg.norm(right)
        above = np.cross(right, ahead)
        at = np.full((self.height * self.width, 2), 0.5)
        if jitter is not None:
            at = jitter.uniform(np.arange(len(at))[:, None], np.arange(2))
        row, column = np.divmod(np.arange(len(at)), self.width)
        half = np.tan(np.radians(0.5 * self.fov))
        x = (2.0 * (column + at[:, 0]) - self.width) / self.height * half
        y = (self.height - 2.0 * (row + at[:, 1])) / self.height * half
        directions = ahead + x[:, None] * right + y[:, None] * above
        unit: Floats = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        return unit
