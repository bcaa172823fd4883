"""The wide model: columns that hold any gap, while a noise law is fitted with them."""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array
from oed.gap.forms.discrepancy import IN_A_RUN
from oed.gap.forms.library import Library

#: least root mean square of each effect and process in the wide model, in units of the
#: noise
WIDE = 0.7


def wide_model(library: Library, processes: Library) -> Array:
    """Columns (N, k) of the middle form of every effect and of the broad processes."""
    columns = [_middle_form(library, effect) for effect in library.effects]
    broad = [effect for effect in processes.effects if effect != IN_A_RUN]
    columns += [_middle_form(processes, effect) for effect in broad]
    return np.hstack(columns)


def _middle_form(library: Library, effect: str) -> Array:
    """The middle of an effect's widest forms, of the least root mean square."""
    forms = [library.atoms[k].columns for k in library.atoms_of(effect)]
    widest = max(len(form) for form in forms)
    full = [form for form in forms if len(form) == widest]
    columns = library.columns[:, full[len(full) // 2]]
    rms = np.sqrt((columns**2).sum() / len(columns))
    return np.asarray(columns * (WIDE / rms))
