"""What effects on a bar need to know of it."""

from oed.effect_model import State

NOMINAL_LENGTH = 0.3  # m, where a set-up does not tell


def length(state: State) -> float | None:
    """Nominal length of the set-up's bar, m; None where it does not tell."""
    length = state.settings.get("length")
    return None if length is None else float(length)


def label(state: State) -> str:
    """The bar by its length, or by its set-up: bars of one nominal length are one bar."""
    bar_length = length(state)
    return (
        f"{state.setup} bar" if bar_length is None else f"bar {1e3 * bar_length:g} mm"
    )
