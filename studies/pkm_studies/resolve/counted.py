"""Readings that a study's prior rests on, and whether new ones are among them."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from oed.dataset import is_counted, shared
from oed.result import StudyResult
from pkm_studies.base import Location
from pkm_studies.earlier_result import result_folder
from pkm_studies.results import load_result
from pkm_studies.study import Study

#: share of readings that equal those of the prior, from which a user must know
DOUBTFUL = 0.2


def prior_results(study: Study) -> Iterator[tuple[Location, str, StudyResult]]:
    """Results that [prior] takes, each with the place and the name in the study.

    Raises InputError.
    """
    prior, location = study.prior, study.location.key("prior")
    named = [(location.key("from").item(i), name) for i, name in enumerate(prior.from_)]
    if prior.earlier is not None:
        named.append((location.key("earlier"), prior.earlier))
    for field, name in named:
        yield field, name, load_result(result_folder(study, name, field))


def doubtful_sessions(study: Study, new: Collection[str]) -> list[str]:
    """Sentences on results of the prior that share some readings with new ones.

    new  digests of readings

    Raises InputError where the readings are those of a result, or have those in them.
    """
    sentences = []
    for location, name, result in prior_results(study):
        if is_counted(new, result.readings):
            raise location.error(
                "the readings are among those that this result rests on: they would"
                " count twice",
                "give the readings of another session, or take its result out of"
                " [prior]",
                name,
            )
        share = shared(new, result.readings)
        if share >= DOUBTFUL:
            sentences.append(
                f"{share:.0%} of the readings equal some that the prior of {name} rests"
                " on: take those out that were taken once; a coarse scale repeats values"
            )
    return sentences


def counted_digests(study: Study, new: Collection[str]) -> list[str]:
    """Digests of new readings and of those behind the prior, sorted."""
    digests_counted = set(new)
    for _, _, result in prior_results(study):
        digests_counted.update(result.readings)
    return sorted(digests_counted)
