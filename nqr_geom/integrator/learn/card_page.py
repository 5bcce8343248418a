"""A model card for people: the page NAME.md beside NAME.json, written from the same card."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nqr_geom.integrator.learn.zoo import Card

__all__ = ["page"]


def page(card: Card) -> str:
    """The card as Markdown.

    Parameters
    ----------
    card : Card
        Of a model.

    Returns
    -------
    str
        What it is, how it was made, how far it may be trusted, and what was measured.

    Examples
    --------
    >>> from nqr_geom.integrator.learn.inet import INetConfig
    >>> from nqr_geom.integrator.learn.zoo import Card
    >>> card = Card("m", "toy", "mc", "trapezoid", INetConfig(), 0, 0, 0, 0.0, {}, (), (), (32, 128), (1.0, 0.5))
    >>> print(page(card).splitlines()[0])
    # m
    """
    parts = [f"# {card.name}", _what(card), _table(("", ""), _facts(card))]
    if card.table:
        parts += [
            "## Measured",
            f"Squared errors on test integrals, at {_usual(card)} samples. Ratios are of means, with 95% bootstrap "
            "intervals.",
            _measured(card.table),
        ]
    parts += [
        "## As samples grow",
        f"The network counts this much, `{card.consistent}` the rest." + _trust(card),
        _shares(card),
    ]
    if card.command:
        parts += ["## Made by", f"    {card.command}"]
    return "\n\n".join(parts) + "\n"


def _what(card: Card) -> str:
    base = "plain weights, W = 1 (the paper's form)" if card.base == "uniform" else f"the rule `{card.base}`"
    where = ", only where that is in doubt" if card.config.doubtful_only else ""
    how = " by an offset that is spread over them" if card.config.spread else ""
    return f"A network that corrects {base}{where}{how}, for integrals of the problem `{card.problem}`."


def _usual(card: Card) -> str:
    """Number of samples that most of the training was with, for which tables are measured."""
    shares: dict[str, float] = card.family.get("samples", {"32": 1.0})
    return max(shares, key=lambda n: shares[n])


def _facts(card: Card) -> list[tuple[str, str]]:
    from nqr_geom.integrator.learn.inet import INet

    config = card.config
    size = sum(weights.numel() for weights in INet(config).parameters())
    facts = [
        ("architecture", f"{config.layers} layers of {config.width}, {config.heads} heads, {size:,} parameters"),
        ("training", f"{card.iterations:,} iterations of {card.batch} integrals, {card.hours:g} h, seed {card.seed}"),
        *((name, _plain(value)) for name, value in card.family.items()),
        ("trusted range", ", ".join(f"{a:.4g} to {b:.4g}" for a, b in zip(card.low, card.high, strict=True))),
        ("weights", f"`{card.name}.safetensors`, sha256 `{card.sha256}`"),
    ]
    return [(name, text) for name, text in facts if text]


def _plain(value: Any) -> str:
    """A value of the family: mappings as "key: value", sequences with commas, names as code."""
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_plain(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_plain, value))
    return f"`{value}`" if isinstance(value, str) else f"{value:g}"


def _number(value: float) -> str:
    """Three digits; a ratio that only counts roundings is a bound."""
    return "> 1e9" if value > 1e9 else f"{value:.3g}"


def _measured(table: dict[str, Any]) -> str:
    head = ("samples", "mean", "std. error", "median", "99%", "x Monte Carlo", "95%", "x its base", "95%", "flagged")
    lines = []
    for design, row in table.items():
        numbers = [_number(row[key]) if key in row else "" for key in ("mse", "mse_error", "median", "p99", "ratio")]
        gain = [_number(row["gain"]), _interval(row.get("gain_interval"))] if "gain" in row else ["", ""]
        flagged = f"{row['fallback']:.1%}" if "fallback" in row else ""
        lines.append((design, *numbers, _interval(row.get("ratio_interval")), *gain, flagged))
    return _table(head, lines)


def _interval(interval: Sequence[float] | None) -> str:
    return "" if interval is None else " .. ".join(map(_number, interval))


def _trust(card: Card) -> str:
    if not card.trust:
        return ""
    return (
        f" Where that rule says how much of its answer is a guess, d, this is multiplied by d / (d + {card.trust:g})."
    )


def _shares(card: Card) -> str:
    return _table(("samples", *map(str, card.sizes)), [("share of the network", *map(_number, card.shares))])


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
