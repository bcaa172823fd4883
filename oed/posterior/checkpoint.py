"""An unfinished chain in files, so that an interrupted sampler resumes where it was.

Each block of steps is a file of emcee's HDF backend, with the state of the random
numbers after it. Blocks are written whole: a kill loses the present block at most. The
resumed chain is the unbroken one, bit by bit, as it goes on from the same walkers with
the same random numbers.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from oed.base.arrays import Array
from oed.base.whole_file import whole_file

#: attribute of a block that states to which chain it belongs
FINGERPRINT = "fingerprint"
#: names of blocks: their first step
BLOCK = re.compile(r"\d{8}\.h5")
#: names of folders of single chains
CHAIN = re.compile(r"\d+")


@dataclasses.dataclass(frozen=True, slots=True)
class Checkpoint:
    """Where the blocks of one chain are, or the folders of several chains.

    folder  of the blocks; other files in it stay
    key     text about what is sampled: a chain of another key is not resumed
    """

    folder: Path
    key: str

    def clear(self) -> None:
        """Remove the blocks of all chains, once the result holds what they were for.

        A folder goes with them where nothing else is in it.
        """
        with contextlib.suppress(OSError):
            for path in self.blocks():
                path.unlink()
            for path in self.folder.iterdir():
                if path.is_dir() and CHAIN.fullmatch(path.name):
                    Checkpoint(path, self.key).clear()
            self.folder.rmdir()

    def blocks(self) -> list[Path]:
        """Files of the blocks, in their order."""
        paths = sorted(self.folder.glob("*.h5"))
        return [path for path in paths if BLOCK.fullmatch(path.name)]


@dataclasses.dataclass(frozen=True, slots=True)
class Chain:
    """A chain in memory, emcee's `backend`, with a checkpoint or without one.

    fingerprint  digest of all that determines the chain
    """

    backend: Any
    checkpoint: Checkpoint | None
    fingerprint: str

    def save(self, begin: int) -> None:
        """Write the steps from `begin` on as a block. Raises OSError."""
        if self.checkpoint is None:
            return
        folder, backend = self.checkpoint.folder, self.backend
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(folder / f"{begin:08d}.h5") as path:
            _write_block(path, backend, begin, self.fingerprint)


def open_chain(
    checkpoint: Checkpoint | None, shape: tuple[int, int], determining: Iterable[Array]
) -> Chain:
    """The chain so far of an ensemble of (walkers, dimensions); empty for a new one.

    determining  the arrays that determine the chain, together with the key

    Blocks of another chain are removed.
    """
    import emcee

    backend = emcee.backends.Backend()
    backend.reset(*shape)
    if checkpoint is None:
        return Chain(backend, None, "")
    fingerprint = _fingerprint(checkpoint.key, determining)
    for path in checkpoint.blocks():
        if _first_step(path, fingerprint) == backend.iteration:
            _append(backend, emcee.backends.HDFBackend(str(path), read_only=True))
        else:
            path.unlink()
    return Chain(backend, checkpoint, fingerprint)


def _fingerprint(key: str, arrays: Iterable[Array]) -> str:
    digest = hashlib.sha256(key.encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _write_block(path: Path, backend: Any, begin: int, fingerprint: str) -> None:
    """Write the steps of a chain in memory from `begin` on, in emcee's layout."""
    import emcee

    block = emcee.backends.HDFBackend(str(path))
    block.reset(*backend.shape)
    block.grow(backend.iteration - begin, None)
    with block.open("a") as file:
        group = file[block.name]
        group["chain"][...] = backend.get_chain(discard=begin)
        group["log_prob"][...] = backend.get_log_prob(discard=begin)
        group["accepted"][...] = backend.accepted
        for k, value in enumerate(backend.random_state):
            group.attrs[f"random_state_{k}"] = value
        group.attrs["iteration"] = backend.iteration - begin
        file.attrs[FINGERPRINT] = fingerprint


def _first_step(path: Path, fingerprint: str) -> int | None:
    """First step of a block; None where it is of another chain, or is no block."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            same = file.attrs.get(FINGERPRINT) == fingerprint
        return int(path.stem) if same else None
    except (OSError, ValueError):
        return None


def _append(backend: Any, block: Any) -> None:
    """Append a block to the chain in memory."""
    begin, steps = backend.iteration, int(block.iteration)
    backend.grow(steps, None)
    backend.chain[begin : begin + steps] = block.get_chain()
    backend.log_prob[begin : begin + steps] = block.get_log_prob()
    backend.accepted = block.accepted
    backend.random_state = block.random_state
    backend.iteration = begin + steps
