"""Draws of the posterior with what is known of their quality, in memory and as a file."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oed.base import Array
from oed.result import PosteriorSection
from oed.safe_files import write_own

if TYPE_CHECKING:
    import h5netcdf
    import xarray as xr


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Draws from the posterior, and their diagnostics.

    Of emcee alone, NaN and 0 for independent draws:
    """

    names: tuple[str, ...]  #: parameters of theta
    #: (chains, draws, n) theta, SI. Independent draws are one chain; of emcee a chain
    #: is an ensemble, its walkers in turn, thinned, or a walker where there is one
    #: ensemble alone
    draws: Array
    z: Array  #: (chains, draws, r) identifiable coordinates
    #: (chains, draws, d) coordinates of the noise law, standard normal a priori
    #: (`oed.noise_law.prior`)
    noise_law: Array
    noise_names: tuple[str, ...]  #: of these coordinates
    #: (n,) effective sample size; NaN for held parameters. Of independent draws: less
    #: than their number where some are repeated; of emcee: of all steps (ArviZ, bulk)
    ess: Array
    rhat: Array  #: (n,) split R-hat of the ensembles (ArviZ); NaN for held parameters
    acceptance: float = np.nan  #: mean share of accepted steps
    #: longest integrated autocorrelation time, in steps (emcee)
    autocorrelation: float = np.nan
    walkers: int = 0  #: of all ensembles
    steps: int = 0  #: steps run by each
    sampler: str = PosteriorSection.EMCEE  #: IMPORTANCE or PosteriorSection.EMCEE
    #: shape of the tail of the importance weights, also where emcee ran because it is
    #: too large; NaN where no weights were computed
    pareto_k: float = np.nan
    proposals: int = 0  #: points that were weighted

    @property
    def pooled(self) -> Array:
        """The draws of all chains (chains * draws, n), SI."""
        return self.draws.reshape(-1, self.draws.shape[2])

    @property
    def theta(self) -> Array:
        """Means of the draws (n,), SI."""
        return np.asarray(self.pooled.mean(axis=0))

    @property
    def covariance(self) -> Array:
        """Covariance of the draws (n, n), SI."""
        return np.cov(self.pooled, rowvar=False)

    @property
    def sd(self) -> Array:
        """Standard deviations of the draws (n,), SI."""
        return np.sqrt(np.diag(self.covariance))


def to_arviz(posterior: Posterior) -> xr.DataTree:
    """The draws, SI, as ArviZ and xarray read them: groups posterior and sample_stats.

    Attributes name the sampler, and k of the importance weights. R-hat is emcee's alone.

    >>> import numpy as np
    >>> from oed.posterior import Posterior, to_arviz
    >>> draws, none = np.arange(10.0).reshape(1, 5, 2), np.zeros((1, 5, 0))
    >>> ess, rhat = np.full(2, 5.0), np.full(2, np.nan)
    >>> posterior = Posterior(("d1", "d2"), draws, draws, none, (), ess, rhat)
    >>> to_arviz(posterior)["posterior"]["theta"].dims
    ('chain', 'draw', 'parameter')
    """
    import xarray  # takes a second to import

    content = io.BytesIO(netcdf(posterior, {}))
    with xarray.open_datatree(content, engine="h5netcdf") as tree:
        return tree.load()


def save(posterior: Posterior, path: Path, attributes: Mapping[str, str]) -> Path:
    """Write the draws, SI, as NetCDF for xarray and ArviZ, whole or not at all.

    Returns the path: one with a number where the user changed the file. Raises OSError.
    """
    # by way of the memory: where the disk refuses, HDF5 loses the process
    return write_own(path, netcdf(posterior, attributes))


def netcdf(posterior: Posterior, attributes: Mapping[str, str]) -> bytes:
    """The NetCDF file of the draws; the same draws give the same bytes."""
    import h5netcdf

    content = io.BytesIO()
    with h5netcdf.File(content, "w") as file:
        file.attrs["sampler"] = posterior.sampler
        if np.isfinite(posterior.pareto_k):
            file.attrs["pareto_k"] = posterior.pareto_k
        file.attrs.update(attributes)
        draws = file.create_group("posterior")
        names = {
            "parameter": np.array(posterior.names, dtype=object),
            "noise_coordinate": np.array(posterior.noise_names, dtype=object),
        }
        _add(draws, names, "theta", "parameter", posterior.draws)
        _add(draws, names, "noise_law", "noise_coordinate", posterior.noise_law)
        statistics = file.create_group("sample_stats")
        _add(statistics, names, "ess", "parameter", posterior.ess[None, None])
        if posterior.sampler == PosteriorSection.EMCEE:
            _add(statistics, names, "rhat", "parameter", posterior.rhat[None, None])
    return content.getvalue()


def _add(
    group: h5netcdf.Group,
    names: Mapping[str, Any],
    variable: str,
    axis: str,
    values: Array,
) -> None:
    """A variable (chains, draws, k) of a group, with coordinates that lack `names`."""
    import h5py

    dimensions = ("chain", "draw", axis)
    sizes = zip(dimensions, values.shape, strict=True)
    for dimension, size in sizes:
        if dimension in group.dimensions:
            continue
        group.dimensions[dimension] = size
        entries = names.get(dimension, np.arange(size))
        kind = h5py.string_dtype() if dimension in names else np.int64
        group.create_variable(dimension, (dimension,), kind, data=entries)
    group.create_variable(variable, dimensions, float, data=values, fillvalue=np.nan)
