"""Observability indices of a plan in the words of the papers that use them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

#: what each index is, and where it is used; H is the scaled identification matrix
MEANING: Final[Mapping[str, str]] = {
    "kappa": (
        "the condition number κ(H) of the identification matrix (Tian et al. 2016, Fig."
        " 6; O2 of Sun and Hollerbach 2008 is its reciprocal); smaller is better"
    ),
    "O1": (
        "the observability index O1 of Borm and Menq (1991), the geometric mean of the"
        " singular values over the root of the number of readings; larger is better"
    ),
    "O2": (
        "the observability index O2 of Driels and Pathre (1990), the reciprocal"
        " condition number; larger is better"
    ),
    "O3": (
        "the observability index O3 of Nahvi, Hollerbach and Hayward (1994), the"
        " smallest singular value; larger is better"
    ),
    "O4": (
        "the noise amplification index O4 of Nahvi and Hollerbach (1996), the smallest"
        " singular value squared over the largest; larger is better"
    ),
    "O5": (
        "the observability index O5 of Sun and Hollerbach (2008), the reciprocal of the"
        " sum of the reciprocal singular values; larger is better"
    ),
    "noise_amplification": (
        "the noise amplification index of Eq. (17) of Chang, Li and Li (2011), the"
        " geometric mean of the singular values over the root of the number of poses;"
        " larger is better"
    ),
}
#: how an index is written
SYMBOLS: Final = {"kappa": "κ", "noise_amplification": "O"}


def symbol(name: str) -> str:
    """How an index is written in a table."""
    return SYMBOLS.get(name, name)


def sentences(indices: Mapping[str, float]) -> list[str]:
    """Each index of a plan with its value, in a sentence."""
    return [
        f"{symbol(name)} = {value:.4g}: {MEANING.get(name, name)}."
        for name, value in indices.items()
    ]
