"""Guards at the door: every public argument is checked by name before any work starts."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["array", "choice", "integer", "number", "require", "rows"]


def _describe(value: Any) -> str:
    """What came, in one short phrase: shape and dtype for arrays, the value itself otherwise."""
    if isinstance(value, np.ndarray):
        return f"array of shape {value.shape} and dtype {value.dtype}"
    text = repr(value)
    return text if len(text) <= 80 else f"{type(value).__name__} {text[:60]}..."


def array(name: str, value: ArrayLike, shape: tuple[int | str, ...], *, finite: bool = True) -> NDArray:
    """Return `value` as a float64 array of the given shape, or raise naming the argument.

    Parameters
    ----------
    name : str
        The argument's name, as the caller knows it.
    value : array_like
        Anything `numpy.asarray` takes.
    shape : tuple of int or str
        Expected shape; a string stands for any length and is used in the message.
    finite : bool
        Refuse NaN and infinity.

    Raises
    ------
    TypeError
        If `value` cannot become a float64 array.
    ValueError
        If the shape differs or a value is not finite.

    Examples
    --------
    >>> array("points", [[0, 1]], ("m", 2))
    array([[0., 1.]])
    >>> array("points", [0, 1], ("m", 2))
    Traceback (most recent call last):
    ValueError: points: expected shape (m, 2), got (2,)
    """
    try:
        result = np.asarray(value)
        if np.iscomplexobj(result):
            raise TypeError("complex")
        result = np.asarray(result, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name}: expected numbers, got {_describe(value)}") from error
    fits = result.ndim == len(shape) and all(
        isinstance(want, str) or want == have for want, have in zip(shape, result.shape, strict=True)
    )
    if not fits:
        expected = "(" + ", ".join(map(str, shape)) + ("," if len(shape) == 1 else "") + ")"
        raise ValueError(f"{name}: expected shape {expected}, got {result.shape}")
    if finite and not np.isfinite(result).all():
        bad = np.argwhere(~np.isfinite(result))[0]
        raise ValueError(f"{name}: expected finite numbers, got {result[tuple(bad)]} at index {tuple(bad.tolist())}")
    return result


def number(name: str, value: Any, *, low: float = -math.inf, high: float = math.inf, open_low: bool = False) -> float:
    """Return `value` as a finite float in [low, high] (or (low, high]), or raise naming the argument.

    Examples
    --------
    >>> number("alpha", 35, low=0.0, open_low=True)
    35.0
    >>> number("alpha", -1, low=0.0, open_low=True)
    Traceback (most recent call last):
    ValueError: alpha: expected a number > 0.0, got -1
    """
    try:
        result = float(value)
    except (TypeError, ValueError) as error:
        raise TypeError(f"{name}: expected a number, got {_describe(value)}") from error
    below = result <= low if open_low else result < low
    if not math.isfinite(result) or below or result > high:
        bounds = [f"{'>' if open_low else '>='} {low}"] if low > -math.inf else []
        bounds += [f"<= {high}"] if high < math.inf else []
        wanted = " and ".join(bounds) or "that is finite"
        raise ValueError(f"{name}: expected a number {wanted}, got {_describe(value)}")
    return result


def integer(name: str, value: Any, *, low: int | None = None, high: int | None = None) -> int:
    """Return `value` as an int in [low, high], or raise naming the argument (True and 3.5 are refused).

    Examples
    --------
    >>> integer("n", 32, low=1)
    32
    >>> integer("n", 0, low=1)
    Traceback (most recent call last):
    ValueError: n: expected an integer >= 1, got 0
    """
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name}: expected an integer, got {_describe(value)}")
    result = int(value)
    if (low is not None and result < low) or (high is not None and result > high):
        bounds = [f">= {low}"] if low is not None else []
        bounds += [f"<= {high}"] if high is not None else []
        raise ValueError(f"{name}: expected an integer {' and '.join(bounds)}, got {result}")
    return result


def choice(name: str, value: Any, options: Collection[str]) -> str:
    """Return `value` if it is one of `options`, or raise listing them.

    Examples
    --------
    >>> choice("rule", "mc", ["mc", "trapezoid"])
    'mc'
    >>> choice("rule", "magic", ["mc", "trapezoid"])
    Traceback (most recent call last):
    ValueError: rule: expected one of mc, trapezoid, got 'magic'
    """
    if not isinstance(value, str) or value not in options:
        raise ValueError(f"{name}: expected one of {', '.join(options)}, got {_describe(value)}")
    return value


def require(module: str, extra: str, purpose: str) -> Any:
    """Import an optional module, or say in one sentence which extra brings it.

    Examples
    --------
    >>> require("math", "learn", "square roots").sqrt(4)
    2.0
    >>> require("no_such_module", "learn", "sampled methods")
    Traceback (most recent call last):
    ImportError: sampled methods need no_such_module: pip install "nqr-geom[learn]"
    """
    import importlib

    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        raise ImportError(f'{purpose} need {module}: pip install "nqr-geom[{extra}]"') from error


def rows(value: ArrayLike | None, m: int) -> NDArray[np.int64]:
    """Return the rows that m queries have in a bigger array, (m,) int64, or raise; 0 .. m-1 if None.

    They key random numbers. They lie below 2^40: the bits above number the parts of a curve.

    Examples
    --------
    >>> rows(None, 3)
    array([0, 1, 2])
    >>> rows([7, 8, -1], 3)
    Traceback (most recent call last):
    ValueError: rows: expected integers from 0 to 2^40 - 1, got -1 at index 2
    """
    if value is None:
        return np.arange(m)
    given = np.asarray(value)
    if given.dtype.kind not in "iu":
        raise TypeError(f"rows: expected integers, got {_describe(given)}")
    if given.shape != (m,):
        raise ValueError(f"rows: expected shape ({m},), one a query, got {given.shape}")
    bad = np.flatnonzero((given < 0) | (given >= 1 << 40))
    if len(bad):
        raise ValueError(f"rows: expected integers from 0 to 2^40 - 1, got {given[bad[0]]} at index {bad[0]}")
    return given.astype(np.int64)
