"""Numbers as readers want them: the filters of the page's template."""

from __future__ import annotations

from typing import Any

__all__ = ["FILTERS", "kurtosis", "micro"]


def shown(value: float | None, digits: int = 3) -> str:
    """A number with few digits, grouped by thousands; nothing for None.

    Examples
    --------
    >>> shown(1234.5), shown(0.01234), shown(3.2e9), shown(None)
    ('1,230', '0.0123', '3.20e9', '')
    """
    if value is None:
        return ""
    if value != 0.0 and not 1e-4 <= abs(value) < 1e7:
        mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
        return f"{mantissa}e{int(exponent)}"
    rounded = float(f"{value:.{digits}g}")
    return f"{rounded:,.0f}" if abs(rounded) >= 10.0 ** (digits - 1) else f"{rounded:.{digits}g}"


def error(value: float | None, digits: int = 2) -> str:
    """An error, in scientific notation where it is small.

    Examples
    --------
    >>> error(0.00123), error(0.345), error(0.0)
    ('1.2e-3', '0.34', '0')
    """
    if value is None:
        return ""
    if value == 0.0:
        return "0"
    if 0.01 <= abs(value) < 1e4:
        return shown(value, digits)
    mantissa, _, exponent = f"{value:.{digits - 1}e}".partition("e")
    return f"{mantissa}e{int(exponent)}"


def errors(pair: Any) -> str:
    """An interval of errors."""
    return "" if pair is None else f"{error(pair[0])} – {error(pair[1])}"


def times(value: float | None) -> str:
    """A ratio of accuracies; beyond 1e9 the better one has only rounding errors.

    Examples
    --------
    >>> times(12.34), times(3e28)
    ('12.3', '> 1e9')
    """
    return "> 1e9" if value is not None and value > 1e9 else shown(value)


def interval(pair: Any) -> str:
    """An interval of ratios.

    Examples
    --------
    >>> interval((0.51, 12.3))
    '0.51 – 12.3'
    """
    return "" if pair is None or pair[0] > 1e9 else f"{times(pair[0])} – {times(pair[1])}"


def micro(seconds: float | None) -> str:
    """A time in the unit that suits it.

    Examples
    --------
    >>> micro(2.5e-8), micro(3.21e-5), micro(0.25)
    ('25 ns', '32.1 µs', '250 ms')
    """
    if seconds is None:
        return ""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{shown(seconds / size)} {unit}"
    return f"{shown(seconds / 1e-9)} ns"


def percent(value: float) -> str:
    """A share as a percentage.

    Examples
    --------
    >>> percent(0.9512), percent(0.0)
    ('95%', '0%')
    """
    return f"{value:.0%}"


def share(value: float) -> str:
    """A share that is mostly zero: nothing for none.

    Examples
    --------
    >>> share(0.0), share(0.004), share(0.25)
    ('', '0.4%', '25%')
    """
    return "" if value == 0.0 else f"{100.0 * value:.2g}%"


def megabytes(value: int | None) -> str:
    """Bytes in megabytes.

    Examples
    --------
    >>> megabytes(2_500_000), megabytes(1000)
    ('2.5', '< 0.1')
    """
    if value is None:
        return ""
    return f"{value / 1e6:,.1f}" if value >= 1e5 else "< 0.1"


def kurtosis(row: dict[str, Any]) -> str:
    """A bin of kurtosis."""
    return f"≥ {row['low']:g}" if row["high"] is None else f"{row['low']:g} – {row['high']:g}"


def gain(row: dict[str, Any]) -> str:
    """How many times smaller the error of the other method is at equal time."""
    other = row["other"]["mse"]
    return times(row["classical"]["mse"] / other if other > 0.0 else float("inf"))


FILTERS = {
    "shown": shown,
    "error": error,
    "errors": errors,
    "interval": interval,
    "times": times,
    "micro": micro,
    "percent": percent,
    "share": share,
    "megabytes": megabytes,
    "bin": kurtosis,
    "gain": gain,
}
