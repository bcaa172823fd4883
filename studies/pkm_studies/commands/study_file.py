"""The study that a subcommand names."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pkm_studies.study import Study


def load(path: Path, allow_code: bool) -> Study:
    """The study of a file or of a shipped study's name."""
    from pkm_studies import study
    from pkm_studies.base.user_code import consent
    from pkm_studies.study import shipped

    return study.load(shipped.study_path(path), consent(allow_code=allow_code))


def load_for(
    path: Path, allow_code: bool, out: Path | None, suffix: str = ""
) -> tuple[Study, Path]:
    """The study, and the folder of its results: `out`, else one of the study's name.

    Raises InputError where the folder cannot be written, or has a result that the study
    rests on.
    """
    from pkm_studies.base import files

    loaded = load(path, allow_code)
    folder = out or Path("out") / f"{loaded.name}{suffix}"
    files.check_writable(folder)
    _check_apart(loaded, folder)
    return loaded, folder


def _check_apart(study: Study, folder: Path) -> None:
    """Raises InputError where the study takes its prior from the folder of its results."""
    from pkm_studies.base.errors import InputError

    named = {"earlier": [study.prior.earlier or ""], "from": study.prior.from_}
    for key, names in named.items():
        for name in filter(None, names):
            if (study.folder / name).resolve() == folder.resolve():
                raise InputError(
                    "the result would replace the one that its prior is taken from",
                    "give another --out",
                    file=str(study.path),
                    field=f"prior.{key}",
                    value=name,
                )
