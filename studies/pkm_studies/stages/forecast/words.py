"""The section `forecast` in sentences, for the terminal."""

from __future__ import annotations

from collections.abc import Iterator

from oed.result import ForecastComponent, ForecastSection


def forecast_sentences(section: ForecastSection | None) -> Iterator[str]:
    """What to measure, and what the table leaves where it is measured."""
    if section is None:
        return
    if not section.readings:
        yield (
            f"Measure the errors at {len(section.nodes)} nodes with set-up"
            f" {section.setup}: {section.minutes:.0f} min."
        )
    yield from figures(section)
    for name, c in section.components.items():
        if c.checked is not None and c.checked_max is not None:
            yield (
                f"{name}, at nodes that were not fitted: rms {c.checked:.3g} {c.unit}"
                f" (predicted {c.checked_predicted:.3g}), largest"
                f" {c.checked_max:.3g} {c.unit} (without the table"
                f" {c.checked_max_before:.3g})."
            )
    for sentence in section.sentences:
        yield f"{sentence[0].upper()}{sentence[1:]}."


def figures(section: ForecastSection | None) -> Iterator[str]:
    """What is left of each component, as predicted."""
    if section is None:
        return
    for name, c in section.components.items():
        yield _planned(name, c) if c.predicted is None else _residual(name, c)


def _planned(name: str, c: ForecastComponent) -> str:
    return (
        f"{name}: of {c.expected:.3g} {c.unit} rms, interpolation between the nodes is"
        f" predicted to leave {c.planned:.3g} {c.unit}."
    )


def _residual(name: str, c: ForecastComponent) -> str:
    if c.measured is None:
        return f"{name}: not measured; {c.predicted:.3g} {c.unit} rms are predicted."
    return (
        f"{name}: of {c.measured:.3g} {c.unit} rms at the nodes, the table is predicted"
        f" to leave {c.predicted:.3g} {c.unit} (95 %: {c.low:.3g} to {c.high:.3g})."
        f" Nodes left out: {c.left_out:.3g} {c.unit}, predicted"
        f" {c.left_out_predicted:.3g}."
    )
