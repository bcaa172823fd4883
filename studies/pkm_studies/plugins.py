"""What is added from outside this package: entry points `pkm_oed.KIND` of installed packages.

The packages beside this one add in the same way as those of others. So this package
names none of them, and each is imported when it is used.
"""

from importlib import metadata
from importlib.metadata import EntryPoint

from pkm_studies.base import InputError

GROUPS = "pkm_oed."  #: how the groups of entry points begin
PROJECT = "pkm-oed"  #: name under which the packages of this project are installed


def project_plugins(kind: str) -> dict[str, EntryPoint]:
    """Entry points of this project by name. Raises InputError where it is not installed."""
    try:
        points = metadata.distribution(PROJECT).entry_points
    except metadata.PackageNotFoundError as error:
        problem = f"{PROJECT} is not installed, so that its {kind} are not known"
        raise InputError(problem, f"install it: pip install {PROJECT}") from error
    return {point.name: point for point in points.select(group=f"{GROUPS}{kind}")}


def plugins(kind: str) -> list[EntryPoint]:
    """Entry points of all installed packages, by name: first those of this project."""
    first = [*project_plugins(kind).values()]
    points = sorted(metadata.entry_points(group=f"{GROUPS}{kind}"))
    return [*first, *(point for point in points if point not in first)]
