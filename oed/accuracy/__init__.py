"""Errors over the workspace after compensation: prediction, budget, acceptance."""

from oed.accuracy.maps import ErrorMaps, error_maps
from oed.accuracy.prediction import Prediction, predict

__all__ = ["ErrorMaps", "Prediction", "error_maps", "predict"]
