"""What readings determine: rank, combinations, information, remedies."""

from oed.identifiability.identifiability import Identifiability, analyse

__all__ = ["Identifiability", "analyse"]
