"""The A3 head with its ball bar, as candidate runs under conditions, and two effects
written apart from the library.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from kernel import a3_plans
from oed.gap.before.runs import Run
from oed.measurement.measurement import Measurement
from oed.model.effect import Column, Effect, State

SCALE, BAR, GIVES = 50e-6, 5e-6, 20e-9  # 1, m, m/N


def _scale(state: State) -> Iterable[Column]:
    for i in state.limbs:
        yield Column(f"leg {i + 1}", SCALE, f"leg {i + 1}", {i: state.joints[:, i]})


def _gravity(state: State) -> Iterable[Column]:
    load = 600.0 + np.nan_to_num(state.payload)
    give = state.tool_force * state.joint_per_length * load[:, None]
    yield Column("legs", GIVES, "", {i: give[:, i] for i in state.limbs})


def _effect(name, columns, **more):
    return Effect(name=name, source="here", about="here", columns=columns, **more)


encoder_scale = _effect("encoder_scale", _scale)
gravity = _effect("gravity", _gravity)
#: one bar that all set-ups share
bar_length = _effect(
    "bar_length", lambda s: [Column("bar", BAR, reading={"length": np.ones(len(s))})]
)


def warm(state: State, tau: float) -> Iterable[Column]:
    rise = 1.0 - np.exp(-(state.time - state.session_span[0]) / tau)
    yield Column("frame", 5e-6, "", {i: rise for i in state.limbs})
    yield Column(
        "leg 1 more", 2e-6, "leg 1", {0: rise * state.joints[:, 0]}, shape=True
    )


warming = _effect("warming", warm, needs=("time",), constants={"tau": (900.0, 3600.0)})


def circles(
    m: Measurement,
    strokes: Sequence[float],
    points: int = 12,
    payloads: Sequence[float] = (0.0,),
    *,
    seconds: float = 120.0,
) -> list[Run]:
    """A circle for each set-up, stroke (m) and payload (N), one after the other in
    time.
    """
    runs: list[Run] = []
    for setup in m.setups:
        for stroke in strokes:
            command = a3_plans.bar_commands(
                m,
                np.full(points, stroke),
                2 * np.pi * np.arange(points) / points,
                setup,
            )
            for load in payloads:
                when = {"payload": load, "direction": 1.0, "time": seconds * len(runs)}
                name = f"{1e3 * stroke:.0f} mm, {load:.0f} N"
                runs.append(
                    Run(
                        name=name,
                        setup=setup,
                        command=command,
                        condition=when,
                        seconds=seconds,
                    )
                )
    return runs
