"""Hard cases of every application, in one catalogue that tests and reports run alike.

Inputs that break naive code, each with a truth from a closed form or from a law that holds whatever the method, and a
bound on the error. `nqr-geom report` runs them on a user's machine; `tests/hard_cases` holds every one of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from importlib import import_module
from importlib.util import find_spec

from nqr_geom import check
from nqr_geom.hard_cases.case import Case, Result

__all__ = ["Case", "Result", "cases", "groups", "measure", "missing"]

_LEARN = (("torch", "learn"), ("safetensors", "learn"))
_RENDER = (("torch", "render"), ("warp", "render"))

# Group -> the modules that its cases need beside the core, each with the extra that brings it.
_NEEDS: dict[str, tuple[tuple[str, str], ...]] = {
    "winding": (),
    "distance": (),
    "smoothed": (),
    "laplace": (),
    "p_laplace": (),
    "rules": _LEARN,
    "walks": _LEARN,
    "learned": _LEARN,
    "transmittance": _RENDER,
    "direct": _RENDER,
}


def groups() -> tuple[str, ...]:
    """Names of all groups, one an application.

    Examples
    --------
    >>> groups()[0]
    'winding'
    """
    return tuple(_NEEDS)


def missing(group: str) -> str | None:
    """The extra that a group needs and this installation has not, or None.

    Examples
    --------
    >>> missing("winding") is None
    True
    """
    needs = _NEEDS[check.choice("group", group, groups())]
    return next((extra for module, extra in needs if find_spec(module) is None), None)


def cases(group: str) -> list[Case]:
    """The cases of one group; its module and what that needs are imported now.

    Parameters
    ----------
    group : str
        One of `groups()`.

    Raises
    ------
    ValueError, ImportError
        If there is no such group, or an extra that it needs is not installed.

    Examples
    --------
    >>> cases("winding")[0].measure().holds
    True
    """
    if (extra := missing(group)) is not None:
        raise ImportError(f'hard cases of {group!r} need more than is installed: pip install "nqr-geom[{extra}]"')
    made: list[Case] = import_module(f"nqr_geom.hard_cases.{group}").cases()
    return made


def measure(
    progress: Callable[[int, int, str], None] | None = None, groups: Iterable[str] | None = None
) -> list[Result]:
    """Run the catalogue on this machine.

    Parameters
    ----------
    progress : callable, optional
        Called as ``progress(done, total, label)`` after every case.
    groups : iterable of str, optional
        Names of groups; by default all that run here, without those whose extra is not installed (`missing`).

    Returns
    -------
    list of Result
        One a case, in the catalogue's order. A case that raises is a result with an infinite error and its words.

    Examples
    --------
    >>> all(result.holds for result in measure(groups=["winding"]))
    True
    """
    wanted = [group for group in _NEEDS if missing(group) is None] if groups is None else list(groups)
    todo = [case for group in wanted for case in cases(group)]
    results = []
    for done, case in enumerate(todo, 1):
        results.append(case.measure())
        if progress is not None:
            progress(done, len(todo), f"{case.group}: {case.name}")
    return results
