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
import io
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from oed.base import Array
from oed.safe_files import whole_file

#: attribute of a block that states to which chain it belongs
FINGERPRINT = "fingerprint"
#: emcee's name of the group of a chain
GROUP = "mcmc"
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
        """Write the steps from `begin` on as a block.

        Where the disk refuses, the chain goes on: it then resumes from an earlier block.
        """
        if self.checkpoint is None:
            return
        folder = self.checkpoint.folder
        content = _block(self.backend, begin, self.fingerprint)
        with contextlib.suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            with whole_file(folder / f"{begin:08d}.h5") as path:
                path.write_bytes(content)


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
        if not _append(backend, path, fingerprint):
            path.unlink()
    return Chain(backend, checkpoint, fingerprint)


def _fingerprint(key: str, arrays: Iterable[Array]) -> str:
    digest = hashlib.sha256(key.encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _block(backend: Any, begin: int, fingerprint: str) -> bytes:
    """The steps of a chain in memory from `begin` on, as a file in emcee's layout.

    In memory: where the disk refuses, HDF5 loses the process.
    """
    import h5py

    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        group = file.create_group(GROUP)
        group["chain"] = backend.get_chain(discard=begin)
        group["log_prob"] = backend.get_log_prob(discard=begin)
        group["accepted"] = backend.accepted
        group.attrs["has_blobs"] = False
        for k, value in enumerate(backend.random_state):
            group.attrs[f"random_state_{k}"] = value
        group.attrs["iteration"] = backend.iteration - begin
        file.attrs[FINGERPRINT] = fingerprint
    return content.getvalue()


def _append(backend: Any, path: Path, fingerprint: str) -> bool:
    """Append a block to the chain in memory; whether it is this chain's next one."""
    import emcee
    import h5py

    begin = backend.iteration
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get(FINGERPRINT) != fingerprint or int(path.stem) != begin:
                return False
        block = emcee.backends.HDFBackend(str(path), read_only=True)
        chain, log_prob = block.get_chain(), block.get_log_prob()
        accepted, random_state = block.accepted, block.random_state
    except (OSError, ValueError, LookupError):
        return False
    steps = len(chain)
    backend.grow(steps, None)
    backend.chain[begin : begin + steps] = chain
    backend.log_prob[begin : begin + steps] = log_prob
    backend.accepted, backend.random_state = accepted, random_state
    backend.iteration = begin + steps
    return True
