"""A sampler that is killed and resumed: the draws of the unbroken one, bit by bit."""

import functools
from collections.abc import Callable

import emcee
import numpy as np
import pytest

from kernel.delta_probe import problem
from oed import posterior
from oed.posterior import Checkpoint, chains

#: steps of the test's chain and of a block: three blocks and a short one
STEPS, BLOCK = 64, 20


@pytest.fixture(autouse=True)
def _short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chains, "CHECK_STEPS", BLOCK)


class KilledError(Exception):
    """Stands for a kill at a step of the sampler."""


#: one problem for all chains
problem_once = functools.cache(functools.partial(problem, distances=False))


def sampled(folder, seed=5, key="a study", max_steps=STEPS, resumed=None):
    m, series, y, estimate = problem_once()
    checkpoint = None if folder is None else Checkpoint(folder, key)
    rng, kept = (
        np.random.default_rng(seed),
        {"checkpoint": checkpoint, "resumed": resumed},
    )
    long = {"sampler": "emcee", "ess": 1e9, "max_steps": max_steps}
    return posterior.sample(m, series, y, estimate, rng, **long, **kept)


def kill_at(step: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let emcee fail at a step of its own count, in this process."""
    save: Callable[..., None] = emcee.backends.Backend.save_step
    saved = 0

    def killing(*arguments: object) -> None:
        nonlocal saved
        saved += 1
        if saved == step:
            raise KilledError
        save(*arguments)

    monkeypatch.setattr(emcee.backends.Backend, "save_step", killing)


def test_killed_ten_times_at_random(tmp_path, monkeypatch):
    unbroken = sampled(None)
    folder = tmp_path / "chain"
    for step in np.random.default_rng(7).integers(1, 28 * chains.N_ENSEMBLES, size=10):
        with monkeypatch.context() as patch:
            kill_at(int(step), patch)
            try:
                resumed = sampled(folder)
            except KilledError:
                assert not list(tmp_path.rglob("*.part"))
                continue
            break
    else:
        resumed = sampled(folder)
    assert resumed.draws.tobytes() == unbroken.draws.tobytes()
    assert resumed.acceptance == unbroken.acceptance
    assert resumed.steps == STEPS


def test_only_a_chain_of_the_same_key_and_seed_is_resumed(tmp_path, monkeypatch):
    folder = tmp_path / "chain"
    with monkeypatch.context() as patch:
        kill_at(chains.N_ENSEMBLES * BLOCK + 8, patch)
        with pytest.raises(KilledError):
            sampled(folder)
    (saved,) = folder.iterdir()
    resumed_after: list[int] = []
    for key, seed in (("another study", 5), ("a study", 6), ("a study", 5)):
        copy = saved.read_bytes()
        sampled(folder, seed, key, BLOCK + 4, resumed_after.append)
        Checkpoint(folder, key).clear()
        assert not folder.exists()
        folder.mkdir()
        saved.write_bytes(copy)
    assert resumed_after == [BLOCK]


def test_a_chain_that_is_cut_is_no_chain(tmp_path):
    """The next run begins anew, and what the user put beside it stays."""
    checkpoint = Checkpoint(tmp_path, "a study")
    sampled(tmp_path)
    content = checkpoint.file.read_bytes()
    (tmp_path / "mine").write_text("a note")
    for cut in (0, 100, len(content) - 30):
        checkpoint.file.write_bytes(content[:cut])
        assert checkpoint.load() == {}
    checkpoint.clear()
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
