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

    Raises InputError where the folder cannot be written.
    """
    from pkm_studies.base import files

    loaded = load(path, allow_code)
    folder = out or Path("out") / f"{loaded.name}{suffix}"
    files.check_writable(folder)
    return loaded, folder
