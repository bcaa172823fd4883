"""A sampler that is killed and resumed: the draws of the unbroken one, bit by bit."""

import functools
from collections.abc import Callable
from pathlib import Path

import emcee
import numpy as np
import pytest

from kernel.delta_probe import problem
from oed import posterior
from oed.posterior import Checkpoint, Posterior, chains
from oed.safe_files import whole_file

#: steps of the test's chain and of a block: three blocks and a short one
STEPS, BLOCK = 64, 20


@pytest.fixture(autouse=True)
def _short_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chains, "CHECK_STEPS", BLOCK)


class KilledError(Exception):
    """Stands for a kill at a step of the sampler."""


#: one problem for all chains
problem_once = functools.cache(functools.partial(problem, distances=False))


def sampled(
    folder: Path | None,
    seed: int = 5,
    key: str = "a study",
    max_steps: int = STEPS,
    resumed: Callable[[int], None] | None = None,
) -> Posterior:
    m, series, y, estimate = problem_once()
    checkpoint = None if folder is None else Checkpoint(folder, key)
    return posterior.sample(
        m,
        series,
        y,
        estimate,
        np.random.default_rng(seed),
        sampler="emcee",
        ess=1e9,
        max_steps=max_steps,
        checkpoint=checkpoint,
        resumed=resumed,
    )


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


def test_killed_ten_times_at_random(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_only_a_chain_of_the_same_key_and_seed_is_resumed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_chain_that_is_cut_is_no_chain(tmp_path: Path) -> None:
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


def fail_half_way(path: Path, error: BaseException) -> None:
    with whole_file(path) as part:
        part.write_text("half")
        raise error


def test_a_file_is_written_whole_or_stays(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("before")
    with pytest.raises(OSError, match="No space") as error:
        fail_half_way(path, OSError(28, "No space left on device"))
    assert error.value.filename == str(path)
    with pytest.raises(KeyboardInterrupt):
        fail_half_way(path, KeyboardInterrupt())
    assert path.read_text() == "before"
    with whole_file(path) as part:
        part.write_text("after")
    assert path.read_text() == "after"
    assert list(tmp_path.iterdir()) == [path]
