"""Random streams: each use has numbers of its own."""

import itertools
import re
from pathlib import Path

import numpy as np

import pkm_studies
from pkm_studies.base import Stream


def test_no_two_streams_have_the_same_numbers():
    """Every name is a member: one that repeats a number would be an alias of another."""
    assert [*Stream.__members__] == [stream.name for stream in Stream]
    first = {name: Stream[name].rng(1).random() for name in Stream.__members__}
    assert len(set(first.values())) == len(first)


def test_streams_of_stages_and_sizes_are_no_streams_of_the_study():
    """NumPy pads keys with zeros, and a size of readings is as small as a stream."""
    keys = [tuple(stream.key(5)) for stream in Stream]
    keys += [(*Stream.PLAN.key(5), 1 + stage) for stage in range(4)]
    keys += [(*Stream.HOW_MANY.key(5), size) for size in range(1, 40)]
    states = [tuple(np.random.SeedSequence(k).generate_state(4)) for k in keys]
    for (one, a), (other, b) in itertools.combinations(
        zip(keys, states, strict=True), 2
    ):
        assert a != b, (one, other)


def test_the_study_s_seed_is_used_through_a_stream_alone():
    folder = Path(pkm_studies.__file__).parents[1]
    plain = re.compile(r"default_rng\([\w.]*(study|result)\.seed\)|int\(Stream\.")
    for path in sorted(folder.rglob("*.py")):
        assert not plain.search(path.read_text(encoding="utf-8")), path
