"""Residual accuracy over the workspace, before and after compensation, against a stated
reference.

With parameter errors dp = dp_hat + delta, where delta ~ N(0, Sigma) is what
identification leaves, the pose error of the compensated machine is, to first order,

    e = R dp_hat + A delta        (R: `remaining`, A: `raw` of the error model),

so compensatable components keep only A delta, and the others keep R dp_hat as well,
which is known and can be given to a further axis (an X-Y table): then A delta is left
there too. Before measuring, dp_hat is itself unknown, with covariance Lambda - Sigma
(Lambda: tolerances).

Errors are told against a reference: "absolute" in the base frame; "home", zeroed at the
home pose (place and orientation, as a user zeroes the machine); "best_fit", after the
best rigid alignment of all workspace poses.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from oed.arrays import Array
from oed.compensate import NO_TOOL, ErrorModel, error_model
from oed.kinematics import Kinematics

Reference = Literal["home", "absolute", "best_fit"]
#: virtual machines drawn to tell the 95th percentile and the largest error
VIRTUAL_MACHINES = 400


@dataclasses.dataclass(frozen=True)
class ErrorMaps:
    """Components of the referenced pose error as slopes over the machine's parameters.

    command    (n, n_dof);  names (k,) of the components
    raw        (n, k, np) without compensation;  remaining (n, k, np) with the
               compensatable components nulled
    """

    command: Array
    names: tuple[str, ...]
    raw: Array
    remaining: Array


@dataclasses.dataclass(frozen=True, slots=True)
class Spread:
    """Error of one component, SI: rms and 95th percentile over workspace and machines;
    the largest error over the workspace, which 95 % of the machines keep.
    """

    rms: float
    p95: float
    largest: float


@dataclasses.dataclass(frozen=True)
class Prediction:
    """Residual accuracy.

    before, after, known   {component: Spread}; `known` is what is left once a further
                           axis corrects it too
    sd_before, sd_after    (n, k) root mean square error at each workspace pose, SI
    budget                 {component: {source: share of the variance of `known`}}
    """

    reference: Reference
    command: Array
    names: tuple[str, ...]
    before: dict[str, Spread]
    after: dict[str, Spread]
    fully_corrected: dict[str, Spread]
    sd_before: Array
    sd_after: Array
    budget: dict[str, dict[str, float]]


def error_maps(
    kinematics: Kinematics,
    command: Array,
    reference: Reference = "home",
    tool: Array = NO_TOOL,
) -> ErrorMaps:
    """Referenced error maps at workspace commands (n, n_dof)."""
    model = error_model(kinematics, command, tool)
    home = error_model(kinematics, kinematics.machine.home_command[None], tool)
    slope = kinematics.error_components_jacobian(command)
    return ErrorMaps(
        command=command,
        names=tuple(c.name for c in kinematics.machine.components),
        raw=slope
        @ _referenced(
            model.raw, home.raw, model, home, reference, kinematics.machine.lever
        ),
        remaining=slope
        @ _referenced(
            model.remaining,
            home.remaining,
            model,
            home,
            reference,
            kinematics.machine.lever,
        ),
    )


def relative_to_reference(
    twist: Array,
    home_twist: Array,
    model: ErrorModel,
    home: ErrorModel,
    reference: Reference,
    lever: float,
) -> Array:
    """Twist errors (n, 6) of one machine told against the reference; home_twist (1, 6).

    Unlike the linear maps, zeroing at home composes finite rotations: a lost spin of
    milliradians times an orientation error would otherwise show as an error of its own.
    """
    if reference == "home":
        own = Rotation.from_rotvec(
            np.einsum("nji,nj->ni", model.rotation, twist[:, 3:])
        )
        zero = Rotation.from_rotvec(home.rotation[0].T @ home_twist[0, 3:])
        left = (own * zero.inv()).as_rotvec()
        return np.hstack(
            [
                twist[:, :3] - home_twist[:, :3],
                np.einsum("nij,nj->ni", model.rotation, left),
            ]
        )
    told = _referenced(
        twist[:, :, None], home_twist[:, :, None], model, home, reference, lever
    )
    return np.asarray(told[:, :, 0])


def _referenced(
    twist: Array,
    at_home: Array,
    model: ErrorModel,
    home: ErrorModel,
    reference: Reference,
    lever: float,
) -> Array:
    if reference == "absolute":
        return twist
    if reference == "home":
        # zeroing on the body: place in the base frame, orientation in the platform's
        # own axes
        carry = np.zeros((len(twist), 6, 6))
        carry[:, :3, :3] = np.eye(3)
        carry[:, 3:, 3:] = model.rotation @ home.rotation[0].T
        return twist - carry @ at_home
    if reference == "best_fit":
        return _without_rigid(twist, model.point, lever)
    raise ValueError(f"reference {reference!r} is none of {get_args(Reference)}")


def _without_rigid(twist: Array, point: Array, lever: float) -> Array:
    """Twists (n, 6, m) less the rigid motion that fits them best (rotations weighted by
    the lever).

    A machine that never turns has no orientation to be aligned: its points alone are
    fitted.
    """
    n = len(twist)
    rigid = np.zeros((n, 6, 6))
    rigid[:, :3, :3] = rigid[:, 3:, 3:] = np.eye(3)
    r = point - point.mean(axis=0)
    zero = np.zeros(n)
    rigid[:, :3, 3:] = np.stack(
        [zero, r[:, 2], -r[:, 1], -r[:, 2], zero, r[:, 0], r[:, 1], -r[:, 0], zero],
        axis=1,
    ).reshape(n, 3, 3)
    turns = lever if twist[:, 3:].any() else 0.0
    weight = np.array([1.0, 1.0, 1.0, turns, turns, turns])[:, None]
    design, data = (
        (rigid * weight).reshape(6 * n, 6),
        (twist * weight).reshape(6 * n, -1),
    )
    fit = rigid.reshape(6 * n, 6) @ np.linalg.lstsq(design, data, rcond=None)[0]
    return np.asarray(twist - fit.reshape(twist.shape))


def predict(
    maps: ErrorMaps,
    prior: Array,
    posterior: Array,
    rng: np.random.Generator,
    *,
    mean: Array | None = None,
    reference: Reference = "home",
    sources: Sequence[tuple[str, Array]] = (),
) -> Prediction:
    """Residual accuracy from prior and posterior covariances (np, np), SI.

    mean      (np,) identified errors p_hat - p_nominal; None before anything was
              measured (plan mode)
    sources   (name, covariance part (np, np)) that add up to `posterior`: the
              uncertainty budget
    """
    spare = np.zeros_like(prior) if mean is not None else prior - posterior
    centre = np.zeros(len(prior)) if mean is None else mean
    delta = _draws(posterior, rng)
    estimate = centre + _draws(spare, rng)
    known = _apply(maps.raw, delta)
    after = _apply(maps.remaining, estimate) + known
    before = _apply(maps.raw, estimate + delta)
    exact = {
        "before": _rms(maps.raw, prior if mean is None else posterior, centre),
        "after": np.sqrt(
            _rms(maps.remaining, spare, centre) ** 2
            + _rms(maps.raw, posterior, 0.0 * centre) ** 2
        ),
        "known": _rms(maps.raw, posterior, 0.0 * centre),
    }
    told = {
        key: {
            n: _spread(errors[:, :, k], exact[key][:, k])
            for k, n in enumerate(maps.names)
        }
        for key, errors in (("before", before), ("after", after), ("known", known))
    }
    return Prediction(
        reference=reference,
        command=maps.command,
        names=maps.names,
        before=told["before"],
        after=told["after"],
        fully_corrected=told["known"],
        sd_before=exact["before"],
        sd_after=exact["after"],
        budget=_budget(maps, sources),
    )


def error_spread(errors: Array) -> Spread:
    """Spread of realised errors (machines, n) of one component."""
    return Spread(
        float(np.sqrt(np.mean(errors**2))),
        float(np.quantile(np.abs(errors), 0.95)),
        float(np.quantile(np.abs(errors).max(axis=1), 0.95)),
    )


def _spread(errors: Array, exact: Array) -> Spread:
    # rms comes from the covariance itself; only the percentile and the largest need
    # draws
    drawn = error_spread(errors)
    return Spread(float(np.sqrt(np.mean(exact**2))), drawn.p95, drawn.largest)


def _draws(covariance: Array, rng: np.random.Generator) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(
        rng.standard_normal((VIRTUAL_MACHINES, len(values)))
        @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
    )


def _apply(maps: Array, parameters: Array) -> Array:
    """Errors (draws, n, k)."""
    return np.asarray(np.einsum("nkp,dp->dnk", maps, parameters, optimize=True))


def _rms(maps: Array, covariance: Array, mean: Array) -> Array:
    """Root mean square (n, k) of maps @ N(mean, covariance)."""
    variance = np.einsum("nkp,pq,nkq->nk", maps, covariance, maps, optimize=True)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) + (maps @ mean) ** 2))


def _budget(
    maps: ErrorMaps, sources: Sequence[tuple[str, Array]]
) -> dict[str, dict[str, float]]:
    zero = np.zeros(maps.raw.shape[2])
    parts = {
        name: np.mean(_rms(maps.raw, cov, zero) ** 2, axis=0) for name, cov in sources
    }
    total = sum(parts.values()) if parts else 0.0
    return {
        n: (
            {
                name: float(part[k] / np.asarray(total)[k])
                for name, part in parts.items()
            }
            if parts
            else {}
        )
        for k, n in enumerate(maps.names)
    }


def budget_sources(
    h: Array, tolerance: Array, names: Sequence[str], keep: int
) -> list[tuple[str, Array]]:
    """Parts of the posterior covariance by source, for the first `keep` parameters (the
    machine's), SI.

    With S = (I + H^T H)^-1 in tolerance units: S = S H^T H S + S S. The first part is
    the readings' noise, the second what the tolerances leave open, split by the
    parameters' kinds (names without limb numbers and axes).
    """
    _, s, vt = np.linalg.svd(h, full_matrices=True)
    gain = np.zeros(h.shape[1])
    gain[: s.size] = s**2
    covariance = (vt.T / (1.0 + gain)) @ vt
    noise = (vt.T * (gain / (1.0 + gain) ** 2)) @ vt
    scale = np.outer(tolerance[:keep], tolerance[:keep])
    parts = [("readings' noise", noise[:keep, :keep] * scale)]
    kinds = [parameter_kind(n) for n in names]
    for label in dict.fromkeys(kinds):
        mine = np.array([k == label for k in kinds]) & (tolerance > 0)
        if mine.any():
            part = covariance[:keep, mine] @ covariance[mine, :keep]
            parts.append((f"tolerance of {label}", part * scale))
    return parts


def parameter_kind(name: str) -> str:
    """`da1x` -> "da", `cup_220.cup_x` -> "cup": parameters of one kind share a source
    in the budget.
    """
    return re.sub(r"(_[xyz]|\d+[xyz]?)$", "", name.rpartition(".")[2])
