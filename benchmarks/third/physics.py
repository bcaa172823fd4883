"""Physics of faults: friction, servo, play, heat, contact, supply pressure, screws.

Nothing here knows a machine or the toolkit. Arrays have time first, SI units.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.harness.noise import autoregression

STRIBECK_SPEED = 5e-3  # m/s


def stribeck(
    speed: ArrayLike, coulomb: ArrayLike, breakaway: float = 1.3
) -> NDArray[np.float64]:
    """Friction force of steady sliding, N, without its viscous part."""
    decay = np.exp(-((np.asarray(speed) / STRIBECK_SPEED) ** 2))
    return np.asarray(coulomb * (1.0 + (breakaway - 1.0) * decay))


def lugre(
    position: NDArray[np.float64],
    time: NDArray[np.float64],
    coulomb: NDArray[np.float64],
    bristle: float,
    viscous: float = 0.0,
) -> NDArray[np.float64]:
    """LuGre friction force along a motion (Canudas de Wit et al. 1995), N.

    dz/dt = v - s0 |v| z / g(v) is solved exactly over each step of constant speed, so
    that steps may be far longer than the presliding distance. The micro-damping force
    lasts milliseconds and is left out.

    position (T, ...), time (T, ...) broadcast to it; coulomb: N, of position's other
    axes; bristle: N/m; viscous: N s/m
    """
    force = np.zeros_like(position)
    deflection = np.zeros_like(position[0])
    for k in range(1, len(position)):
        speed = (position[k] - position[k - 1]) / (time[k] - time[k - 1])
        steady = stribeck(speed, coulomb) / bristle
        decay = np.exp(-np.abs(position[k] - position[k - 1]) / steady)
        limit = np.sign(speed) * steady
        deflection = limit + (deflection - limit) * decay
        force[k] = bristle * deflection + viscous * speed
    return force


def servo_error(
    force: NDArray[np.float64],
    time: NDArray[np.float64],
    mass: float = 40.0,
    bandwidth: float = 80.0,
) -> NDArray[np.float64]:
    """Position error of a PID loop under a disturbing force, m, by implicit Euler.

    m y'' + d y' + k y + i integral(y) = force, with all poles at the bandwidth, 1/s.
    """
    damping, stiffness = 3 * mass * bandwidth, 3 * mass * bandwidth**2
    integral = mass * bandwidth**3
    error = np.zeros_like(force)
    rate, total = np.zeros_like(force[0]), np.zeros_like(force[0])
    for k in range(1, len(force)):
        dt = time[k] - time[k - 1]
        push = force[k] - stiffness * error[k - 1]
        push = push - integral * (total + dt * error[k - 1])
        weight = mass / dt + damping + stiffness * dt + integral * dt**2
        rate = (mass / dt * rate + push) / weight
        error[k] = error[k - 1] + dt * rate
        total = total + dt * error[k]
    return error


def play(position: NDArray[np.float64], half: float) -> NDArray[np.float64]:
    """Lag of a nut behind its screw, m: within +-half, and +-half once taken up."""
    lag = np.zeros_like(position)
    for k in range(1, len(position)):
        lag[k] = np.clip(lag[k - 1] + position[k] - position[k - 1], -half, half)
    return -lag


def relaxation(
    drive: NDArray[np.float64], time: NDArray[np.float64], constant: ArrayLike
) -> NDArray[np.float64]:
    """y of constant * dy/dt = drive - y from rest, exact for steps of the drive."""
    value = np.zeros_like(drive)
    for k in range(1, len(drive)):
        decay = np.exp(-(time[k] - time[k - 1]) / np.asarray(constant))
        value[k] = drive[k] + (value[k - 1] - drive[k]) * decay
    return value


def network(
    capacity: NDArray[np.float64],
    conductance: NDArray[np.float64],
    to_room: NDArray[np.float64],
    power: NDArray[np.float64],
    room: NDArray[np.float64],
    dt: float,
) -> NDArray[np.float64]:
    """Temperatures (T, N) over the start of N lumped nodes, K, by implicit Euler.

    capacity (N,) J/K; conductance (N, N) symmetric and to_room (N,), W/K; power (T, N)
    W; room (T,) K; dt s
    """
    flow = np.diag(conductance.sum(1) + to_room) - conductance
    step = np.linalg.inv(np.diag(capacity / dt) + flow)
    temperature = np.zeros_like(power)
    for k in range(1, len(power)):
        heat = power[k] + to_room * room[k]
        temperature[k] = step @ (capacity / dt * temperature[k - 1] + heat)
    return temperature


def contact_force(
    x: NDArray[np.float64], clearance: float, hertz: float, seal: float
) -> NDArray[np.float64]:
    """Force of a joint whose ball is x off the middle of its clearance, N."""
    depth = np.maximum(np.abs(x) - clearance, 0.0)
    return np.asarray(seal * x + np.sign(x) * hertz * depth**1.5)


def contact(
    load: NDArray[np.float64], clearance: float, hertz: float = 3e9, seal: float = 2e5
) -> NDArray[np.float64]:
    """Where a joint with clearance is in equilibrium with its load, m, by bisection.

    hertz: N/m^1.5 of the ball in its seat; seal: N/m that centres the ball
    """
    low, high = np.full_like(load, -1e-2), np.full_like(load, 1e-2)
    for _ in range(60):
        middle = 0.5 * (low + high)
        above = contact_force(middle, clearance, hertz, seal) > load
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return 0.5 * (low + high)


def pressure(rng: np.random.Generator, count: int, dt: float) -> NDArray[np.float64]:
    """Supply pressure (count,) of a compressor that starts and stops, about its mean.

    A receiver leaks, and is charged between two switching pressures; the line to the
    drives follows with seconds' delay.
    """
    leak, charge = rng.uniform(0.004, 0.012), rng.uniform(0.02, 0.05)
    level, runs = rng.uniform(-1.0, 1.0), False
    receiver = np.zeros(count)
    for k in range(count):
        runs = level < -1.0 or (runs and level < 1.0)
        level += dt * ((charge if runs else 0.0) - leak * rng.uniform(0.7, 1.3))
        receiver[k] = level
    line = relaxation(receiver, dt * np.arange(count), 8.0)
    return np.asarray(line - line.mean())


def ornstein_uhlenbeck(
    rng: np.random.Generator, count: int, length: float
) -> NDArray[np.float64]:
    """Stationary process (count,) of unit variance, correlated over `length` steps."""
    return autoregression(rng.normal(size=count), np.exp(-1.0 / length))


def pitch_error(
    rng: np.random.Generator, travel: NDArray[np.float64], lead: float
) -> NDArray[np.float64]:
    """Accumulated error of a screw at travels: each turn's lead departs at random."""
    turns = np.arange(np.floor(travel.min() / lead) - 1, travel.max() / lead + 2)
    departures = ornstein_uhlenbeck(rng, len(turns), 12.0)
    return np.asarray(np.interp(travel / lead, turns, np.cumsum(departures)))
