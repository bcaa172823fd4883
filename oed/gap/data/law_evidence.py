"""Log evidence of readings with columns in the model, under many noise laws.

What single readings have and what is carried along whitens all readings, in linear
time. What a run shares and how large the channels' noise is change a few products
alone: laws that differ in no more have the whitening in common.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw
from oed.noise.shared import SharedProducts, taken_out


@dataclasses.dataclass(frozen=True, eq=False)
class _Products:
    """Products of residual and columns, whitened by all but what segments share.

    log_det   log determinant of that covariance
    channels  (C, m, m) of the readings of each channel
    inner     (S, K, K) of the errors that each segment shares
    cross     (S, K, m) of these with residual and columns
    """

    log_det: float
    channels: Array
    inner: Array
    cross: Array


class LawEvidence:
    """Log evidence, with columns in the model, as a function of the noise law."""

    def __init__(self, problem: GapProblem, columns: Array) -> None:
        """Prepare columns (N, k), the parameters' slopes among them."""
        self._problem, layout = problem, problem.layout
        values = np.column_stack([problem.residual, columns])
        self._values = values[layout.order]
        self._channel = problem.channel[layout.order]
        self._channels = np.unique(self._channel)
        #: whether each segment has one channel, so that its scale is a factor
        self._apart = problem.stated is None or len(self._channels) == 1

    def __call__(self, laws: Sequence[NoiseLaw]) -> Array:
        """Log evidences (L,) under laws of level 1, which is integrated over.

        Single readings of a law all have the same variance, 1 less what is carried.
        """
        if not self._apart:
            columns = self._problem_columns()
            return np.array(
                [evidence.log_evidence(self._problem, law, columns) for law in laws]
            )
        products: dict[tuple[float, float], _Products] = {}
        values = []
        for law in laws:
            key = law.ar1_sd, law.ar1_length
            if key not in products:
                products[key] = self._whitened(law)
            values.append(self._log_evidence(law, products[key]))
        return np.array(values)

    def _problem_columns(self) -> Array:
        """The columns (N, k) in the order of the readings."""
        columns = np.empty_like(self._values[:, 1:])
        columns[self._problem.layout.order] = self._values[:, 1:]
        return columns

    def _whitened(self, law: NoiseLaw) -> _Products:
        unit = dataclasses.replace(law, channel_ratio=None)
        errors = unit.errors(self._problem, self._problem.layout)
        banded = errors.banded()
        white = banded.whiten(errors.unmixed(self._values))
        common = law.shared(self._problem, errors.order)
        columns = banded.whiten(errors.unmixed(common))
        shared = SharedProducts(columns, errors.starts)
        log_det = banded.log_det
        if errors.unmix is not None:
            log_det -= 2.0 * float(np.log(errors.unmix.diagonal()).sum())
        parts = [white]
        if len(self._channels) > 1:
            parts = [white[self._channel == g] for g in self._channels]
        return _Products(
            log_det=log_det,
            channels=np.array([part.T @ part for part in parts]),
            inner=shared.inner,
            cross=shared.of_segments(white),
        )

    def _log_evidence(self, law: NoiseLaw, products: _Products) -> float:
        scale = np.ones(len(self._channel))
        if law.channel_ratio is not None:
            scale = law.channel_ratio[self._problem.layout.order]
        starts = self._problem.layout.starts
        _, first = np.unique(self._channel, return_index=True)
        sizes = law.shared_sizes(self._problem, self._problem.layout.order)
        cross = products.cross / scale[starts, None, None]
        removed, log_shared = taken_out(products.inner, cross, sizes)
        weights = 1.0 / scale[first] ** 2
        whole = np.tensordot(weights, products.channels, axes=1) - removed
        log_det = (
            products.log_det + float(log_shared) + 2.0 * float(np.log(scale).sum())
        )
        return evidence.log_evidence_of_products(whole, log_det, len(scale))
