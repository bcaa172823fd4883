"""Axes that stand otherwise: columns of readings exchanged or turned, poses in another
frame or by another meaning of their angles, as read and as given to the controller.

With y = (p, R), p the tool point and R the rotation of the platform's frame, a mistake is

    p' = G p, R' = G R G^T       axes that stand otherwise, a left-handed frame for det G < 0
    p' = G p, R' = G R           a frame that is turned, while the target is as it should be
    p' = p, R' = R G             a target that is turned
    R' = R^T                     passive rotations; with p' = -R^T p the inverse pose
    R' = product of the same rotations in another order

with G one of the 48 matrices that exchange axes and turn them round.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

import numpy as np
import scipy  # its parts load when first used

from oed.base import Array, Mask, Orientation
from oed.checks.mistakes.moved import Change, commanded, moved_trials, permuted
from oed.checks.mistakes.pose import RANGE_SLACK
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import MistakeTrial, mistakes_of_scopes, value_trial

#: places (n, 3) and rotations (n, 3, 3) without a mistake, of those with it
Unframed = Callable[[Array, Array], tuple[Array, Array]]
AXES = "xyz"


@dataclasses.dataclass(frozen=True)
class FrameMistake:
    """A mistake of a frame, in words, and poses without it."""

    text: str
    undo: Unframed
    #: rotations (n, 3, 3) of angles by name, where it is not that of their columns
    matrices: Callable[[Mapping[str, Array]], Array] | None = None


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Columns of one unit in any order and with any signs, and poses in another frame."""
    by_unit: dict[str, list[str]] = {}
    for channel in dict.fromkeys(data.channel[data.shown]):
        by_unit.setdefault(data.session.unit(channel), []).append(str(channel))
    for names in (few for some in by_unit.values() for few in _groups(some)):
        for order in itertools.permutations(names):
            for signs in itertools.product((1.0, -1.0), repeat=len(names)):
                if order == tuple(names) and sum(signs) > len(names) - 4.0:
                    continue  # the sign of one alone: see `values`
                on = partial(_exchanged, names, order, signs)
                yield from mistakes_of_scopes(data.scopes, on)
    yield from _read(data)
    yield from _driven(data)


# -- columns ---------------------------------------------------------------------------
def _groups(names: list[str]) -> list[list[str]]:
    """Channels that are permuted together: pairs alone where there are many."""
    if len(names) <= 3:
        return [names]
    return [list(pair) for pair in itertools.combinations(names, 2)]


def _exchanged(
    names: list[str], order: tuple[str, ...], signs: tuple[float, ...], scope: Scope
) -> MistakeTrial | None:
    """The session with each channel of `names` taken from that of `order`."""
    session = scope.session
    sources = [names.index(name) for name in order]
    y = _mapped(scope, names, scope.shown, permuted(sources, signs))
    if y is None or np.array_equal(y, session.y):
        return None
    column = {name: session.column(name).name for name in names}
    if min(signs) > 0.0:
        moved = zip(names, order, strict=True)
        exchanged = [column[a] for a, b in moved if a != b]
        text = f"{', '.join(exchanged[:-1])} and {exchanged[-1]}"
        sentence = f"the columns {text} are exchanged{scope.within}"
    else:
        triples = zip(names, order, signs, strict=True)
        axes = [
            f"{column[a]} is {'-' if s < 0 else ''}{column[b]}" for a, b, s in triples
        ]
        sentence = f"the axes stand otherwise{scope.within}: {', '.join(axes)}"
    return value_trial(scope, "columns", sentence, y)


def _mapped(
    scope: Scope, names: Sequence[str], inside: Mask, change: Change
) -> Array | None:
    """Values (N,) with those of some channels (n, k) changed together; None where not
    each of them has as many.
    """
    masks = [inside & (scope.data.channel == name) for name in names]
    if len({int(mask.sum()) for mask in masks}) > 1 or not masks[0].any():
        return None
    y = scope.session.y.copy()
    changed = change(np.column_stack([y[mask] for mask in masks]))
    for mask, values in zip(masks, changed.T, strict=True):
        y[mask] = values
    return y


# -- what may be wrong with poses ------------------------------------------------------
def _mistakes(orientation: Orientation) -> Iterator[FrameMistake]:
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            turn = np.zeros((3, 3))
            turn[range(3), order] = signs
            if not np.array_equal(turn, np.eye(3)):
                yield from _axes_mistakes(turn)
    yield FrameMistake(
        "have angles of the inverse rotation (passive for active)",
        lambda p, r: (p, np.swapaxes(r, 1, 2)),
    )
    yield FrameMistake(
        "are of the inverse poses: of the base in the platform's frame",
        lambda p, r: (-np.einsum("nij,nj->ni", r, p), np.swapaxes(r, 1, 2)),
    )
    for other in _conventions(orientation):
        text = f"have angles in another order: {other.formula}"
        yield FrameMistake(text, lambda p, r: (p, r), other.matrices)
    yield FrameMistake(
        f"have {', '.join(orientation.names)} of one rotation vector",
        lambda p, r: (p, r),
        partial(_vector_rotations, orientation.names),
    )


def _conventions(orientation: Orientation) -> list[Orientation]:
    """What the same angles make otherwise: the same rotations in another order, and
    rotations about three axes in any order.
    """
    x, y, z = orientation.names
    orders = itertools.permutations([("x", x), ("y", y), ("z", z)])
    others = [Orientation.rotation(*factors) for factors in orders]
    for factors in itertools.permutations(orientation.factors):
        others.append(dataclasses.replace(orientation, factors=factors))
    return [o for o in dict.fromkeys(others) if o != orientation]


def _vector_rotations(names: Sequence[str], angles: Mapping[str, Array]) -> Array:
    """Rotations (n, 3, 3) by the vectors that some angles are."""
    vectors = np.column_stack([angles[name] for name in names])
    return np.asarray(scipy.spatial.transform.Rotation.from_rotvec(vectors).as_matrix())


def _axes_mistakes(turn: Array) -> Iterator[FrameMistake]:
    """Axes of both frames as in G (3, 3), and of one of them where it is a rotation."""
    axes = ", ".join(
        f"{AXES[k]} is {'-' if row.sum() < 0.0 else ''}{AXES[int(np.argmax(np.abs(row)))]}"
        for k, row in enumerate(turn)
    )
    is_left = np.linalg.det(turn) < 0.0
    way = "a left-handed frame" if is_left else "a frame whose axes stand otherwise"
    yield FrameMistake(
        f"are in {way}: {axes}", lambda p, r: (p @ turn, turn.T @ r @ turn)
    )
    if is_left:
        return
    yield FrameMistake(
        f"are in a frame that is turned: {axes}", lambda p, r: (p @ turn, turn.T @ r)
    )
    yield FrameMistake(
        f"are of a target that is turned: {axes}", lambda p, r: (p, r @ turn.T)
    )


def _unframed(orientation: Orientation, mistake: FrameMistake, poses: Array) -> Array:
    """Poses (n, 6), places and angles, without a mistake."""
    matrices = mistake.matrices or orientation.matrices
    angles = dict(zip(orientation.names, poses[:, 3:].T, strict=True))
    p, r = mistake.undo(poses[:, :3], matrices(angles))
    values = orientation.angles(r)
    return np.column_stack([p, *(values[name] for name in orientation.names)])


# -- poses that are read ---------------------------------------------------------------
def _read(data: Suspect) -> Iterator[MistakeTrial]:
    setups = data.session.measurement.setups
    of = {s.setup: setups[s.setup].instrument.orientation for s in data.session.series}
    for orientation in dict.fromkeys(of.values()):
        if orientation is None or orientation.axis_only or len(orientation.names) != 3:
            continue
        for mistake in _mistakes(orientation):
            on = partial(_read_otherwise, orientation, mistake)
            yield from mistakes_of_scopes(data.scopes, on)


def _read_otherwise(
    orientation: Orientation, mistake: FrameMistake, scope: Scope
) -> MistakeTrial | None:
    names = [*(f"read_{axis}" for axis in AXES), *orientation.names]
    change = partial(_unframed, orientation, mistake)
    y = _mapped(scope, names, scope.values, change)
    if y is None:
        return None
    sentence = f"the poses that were read{scope.within} {mistake.text}"
    return value_trial(scope, "frame", sentence, y)


# -- poses that are commanded ----------------------------------------------------------
def _driven(data: Suspect) -> Iterator[MistakeTrial]:
    """Commands of all six coordinates; those out of the workspace were never given."""
    machine = data.session.measurement.machine
    orientation = machine.command_orientation
    names = [c.name for c in machine.command]
    if orientation is None or names != [*AXES, *orientation.names]:
        return
    for mistake in _mistakes(orientation):
        change = partial(_unframed, orientation, mistake)
        moved = commanded(data.session.measurement, change, slack=RANGE_SLACK)
        sentence = f"the commanded poses{{within}} {mistake.text}"
        yield from moved_trials(data, "frame", sentence, moved)
