"""Probability that a reading stays within the instrument's travel.

A ball bar follows a machine no farther than its travel t. A reading

    y_i = h_i d + g_i s + e_i

of a machine with error d, in a set-up with unknowns s ~ N(0, 1), is captured where
|h_i d + g_i s| <= t, and lost otherwise. The readings of one run are captured or lost
together.
"""

import numpy as np
from scipy.special import erf

from oed.base import Array, Index, Mask
from oed.planning.knowledge import Knowledge, Prior, make_knowledge
from oed.planning.option import Option

RUN_DRAWS = 1000  #: machines drawn to estimate how often a whole run is captured
MIN_VARIANCE = 1e-300  #: smallest variance to divide by


def capture_probability(
    option: Option, prior: Prior, rng: np.random.Generator
) -> Array:
    """Capture probability (C,): closed for single readings, drawn for whole runs."""
    if not option.limits_travel:
        return np.ones(len(option.candidates))
    first, count = option.candidates.members.T
    knowledge = make_knowledge(prior)
    if (count == 1).all():
        return np.asarray(_reading_probability(option, knowledge)[first])
    drawn = knowledge.repeat(max(RUN_DRAWS // knowledge.machines, 1))
    errors = drawn.draw_errors(rng)
    setup_errors = rng.standard_normal((len(errors), option.setup_columns))
    everything = np.arange(len(option.candidates))
    captured = is_captured(option, everything, errors, setup_errors)
    return np.asarray(captured.mean(axis=0))


def capture_probability_bound(option: Option, prior: Prior) -> Array:
    """Upper bound (C,) of capture: a run's is that of its least likely reading."""
    if not option.limits_travel:
        return np.ones(len(option.candidates))
    probability = _reading_probability(option, make_knowledge(prior))
    members = option.candidates.members
    least = [probability[first : first + count].min() for first, count in members]
    return np.array(least)


def is_captured(
    option: Option, chosen: Index, errors: Array, setup_errors: Array
) -> Mask:
    """Which machines (P) give which chosen candidates (N): (P, N).

    errors        (P, n) of the machines' parameters, in tolerance units
    setup_errors  (P, s) of the set-ups' parameters, in tolerance units
    """
    deviation = np.hstack([errors, setup_errors]) @ option.first_channel_jacobian.T
    within = np.abs(deviation) <= option.travel
    first, count = option.candidates.members[chosen].T
    # `reduceat` needs a column after the last run to name as its end
    padded = np.hstack([within, np.ones((len(within), 1), dtype=bool)])
    ends = np.column_stack([first, first + count]).ravel()
    return np.logical_and.reduceat(padded, ends, axis=1)[:, ::2]


def _reading_probability(option: Option, knowledge: Knowledge) -> Array:
    """Probability (readings,) that each reading by itself is within the travel."""
    jacobian, n = option.first_channel_jacobian, option.machine_columns
    machine_jacobian = jacobian[:, :n]
    setup_variance = np.sum(jacobian[:, n:] ** 2, axis=1)
    if knowledge.errors is not None:
        scale = np.sqrt(np.maximum(2.0 * setup_variance, MIN_VARIANCE))
        deviation = knowledge.errors @ machine_jacobian.T
        below = erf((option.travel - deviation) / scale)
        above = erf((option.travel + deviation) / scale)
        return np.asarray(0.5 * (below + above).mean(axis=0))
    machine_variance = np.einsum(
        "in,pnm,im->pi",
        machine_jacobian,
        knowledge.covariances,
        machine_jacobian,
        optimize=True,
    )
    variance = np.maximum(setup_variance + machine_variance, MIN_VARIANCE)
    ratio = option.travel / np.sqrt(variance) / np.sqrt(2.0)
    return np.asarray(erf(ratio)[knowledge.covariance_of].mean(axis=0))
