"""Compiled functions over arrays of poses: evaluation, Newton's method, adjoints.

Their C text has one statement for each value, over vectors of poses. It holds no number of
the machine: constants are an array that a call brings along. So machines that differ in
their dimensions alone share it, as those of a campaign do.
"""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import platformdirs

from oed import child_process
from oed.base import Array, Mask
from oed.mechanism.graph import OPERATIONS, Graph, Node
from oed.mechanism.tape import REMAINING_ERROR, SHORT_STEP, AdjointRows, SolvedSystems
from oed.safe_files import make_private, whole_file

# The C compiler of this computer, and the files that it made, kept from run to run.
#
# A text is compiled once a computer. The file's name is a digest of text, flags, compiler
# and processor, and one of its content: so a changed compiler compiles anew, and a damaged
# file is not loaded. Whatever fails, there is no function, and the array code serves.

#: names of compilers that know the vectors of lanes.h
COMPILERS = ("cc", "gcc", "clang")
#: `-fno-math-errno` and `-fno-trapping-math` change no result; a product and a sum may
#: become one operation, rounded once
FLAGS = (
    *("-std=gnu11", "-O2", "-fno-math-errno", "-fno-trapping-math"),
    *("-ffp-contract=fast", "-fno-strict-aliasing", "-w", "-shared", "-fPIC"),
)
#: all that this processor can do, or what every one can, where the compiler cannot tell
PROCESSORS = (("-march=native",), ())
#: longest time of a compilation, s
COMPILATION_TIMEOUT = 120.0
#: files of the folder beyond which the oldest are removed
MAX_FILES = 512
#: characters of a digest in a file's name
DIGEST_LENGTH = 32
#: name of the folder with the compiled files
FOLDER_NAME = "compiled"


@dataclasses.dataclass(frozen=True)
class Compiler:
    """A compiler of this computer.

    path      its program
    identity  what changes with the compiler and the processor
    """

    path: str
    identity: str


def load(text: str) -> ctypes.CDLL | None:
    """The functions of a C text; None where they cannot be compiled or loaded."""
    compiler = find_compiler(os.environ.get("PATH", ""))
    return None if compiler is None else _load(text, compiler, cache_folder())


def cache_folder() -> Path:
    """The folder of the compiled files, of this user and computer."""
    return platformdirs.user_cache_path("pkm-oed", appauthor=False) / FOLDER_NAME


@functools.cache
def find_compiler(search_path: str) -> Compiler | None:
    """The first compiler on the search path; None on Windows, or where there is none.

    Relative folders of the path are passed over: they would be anybody's. GCC on Windows
    does not align vectors on the stack.
    """
    if os.name != "posix":
        return None
    folders = os.pathsep.join(filter(os.path.isabs, search_path.split(os.pathsep)))
    for name in COMPILERS:
        program = shutil.which(name, path=folders)
        if program is not None and not _asks_to_install(program):
            file = Path(program).resolve()
            with contextlib.suppress(OSError):
                status = file.stat()
                marks = (file, status.st_size, status.st_mtime_ns, _processor())
                return Compiler(program, "\n".join(map(str, marks)))
    return None


def _asks_to_install(program: str) -> bool:
    """Whether a program opens a window in place of compiling: on a Mac without tools."""
    if sys.platform != "darwin" or not program.startswith("/usr/bin/"):
        return False
    asked = child_process.run(
        ["/usr/bin/xcode-select", "-p"], Path("/"), COMPILATION_TIMEOUT
    )
    return asked.returncode != 0


def _processor() -> str:
    """What distinguishes this processor from others: its model and abilities."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            first = file.read(16384).split("\n\n", 1)[0]
    except OSError:
        return f"{platform.machine()} {platform.processor()} {platform.version()}"
    kinds = ("vendor_id", "cpu family", "model", "flags", "CPU ", "Features")
    return "\n".join(line for line in first.splitlines() if line.startswith(kinds))


@functools.cache
def _load(text: str, compiler: Compiler, folder: Path) -> ctypes.CDLL | None:
    """As `load`, once a process for each text."""
    parts = "\n".join([text, *FLAGS, str(PROCESSORS), compiler.identity])
    digest = hashlib.sha256(parts.encode()).hexdigest()[:DIGEST_LENGTH]
    try:
        if not make_private(folder):
            return None
        for file in sorted(folder.glob(f"{digest}-*.so")):
            if _is_whole(file):
                return ctypes.CDLL(str(file))
            file.unlink(missing_ok=True)
        return _opened(_compile(text, compiler, folder, digest))
    except (OSError, subprocess.SubprocessError):
        return None


def _opened(file: Path) -> ctypes.CDLL:
    """A new file's functions. Raises OSError, without the file, where it has none."""
    try:
        return ctypes.CDLL(str(file))
    except OSError:
        file.unlink(missing_ok=True)
        raise


def _is_whole(file: Path) -> bool:
    """Whether a file has the content that its name states."""
    return file.stem.partition("-")[2] == _content_digest(file.read_bytes())


def _content_digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:DIGEST_LENGTH]


def _compile(text: str, compiler: Compiler, folder: Path, digest: str) -> Path:
    """The file of a text. Raises OSError, subprocess.SubprocessError."""
    with tempfile.TemporaryDirectory(prefix="pkm-oed-") as scratch:
        source, library = Path(scratch, "lanes.c"), Path(scratch, "lanes.so")
        source.write_text(text, encoding="utf-8")
        files = ("-o", str(library), str(source), "-lm")
        for processor in PROCESSORS:
            command = [compiler.path, *FLAGS, *processor, *files]
            done = child_process.run(command, Path(scratch), COMPILATION_TIMEOUT)
            if done.returncode == 0:
                break
        content = library.read_bytes()
    file = folder / f"{digest}-{_content_digest(content)}.so"
    with whole_file(file) as part:
        part.write_bytes(content)
    _remove_oldest(folder)
    return file


def _remove_oldest(folder: Path) -> None:
    """Keep the folder small: processes that have a file open keep it."""
    files = sorted(folder.glob("*.so"), key=lambda file: file.stat().st_mtime_ns)
    for file in files[:-MAX_FILES]:
        file.unlink(missing_ok=True)


#: least number of points of a core's share: two milliseconds of work
MIN_SHARED_POINTS = 8192
#: shares begin at multiples of this: of the lanes of every processor
MAX_LANES = 8
#: most steps with new slopes: the last are quadratic, so that eight reach rounding
MAX_NEWTON_STEPS = 8
#: most steps with kept slopes, which show the error that remains
MAX_CHORD_STEPS = 4
#: error (m, rad) after which a point takes no further step
FINAL_ERROR = 1e-17
#: instructions of the longest function that is compiled, in some ten seconds
MAX_INSTRUCTIONS = 20_000
#: state of a solved point in newton.h
SOLVED = 1
#: state of a point that ended with a short step
NEAR = 2
#: bytes of a number
NUMBER_SIZE = 8
#: operations of one angle that share their work, by the letter of their variable
ANGLE_FUNCTIONS = {ca.OP_SIN: "s", ca.OP_COS: "c"}


class LaneJob(NamedTuple):
    """What is computed of a function.

    template  the file of C text that does it
    varying   numbers of the inputs that vary while the others stay
    macros    further numbers of the template, by name
    """

    template: str
    varying: frozenset[int]
    macros: tuple[tuple[str, int], ...] = ()


@dataclasses.dataclass(frozen=True)
class LaneText:
    """C text, and the constants that its functions take."""

    text: str
    constants: Array


def lane_text(graph: Graph, job: LaneJob) -> LaneText:
    """The C text of a job on the graph of a function."""
    writer = _Writer(graph, job.varying)
    sizes = [len(row) for row in graph.outputs]
    macros = {
        "INPUTS": len(graph.inputs),
        "INPUT_ENTRIES": sum(graph.inputs),
        "OUTPUTS": len(sizes),
        "OUTPUT_ENTRIES": sum(sizes),
        "FIXED_ENTRIES": len(writer.slots),
        **dict(job.macros),
    }
    numbers = ", ".join(map(str, sizes))
    lines = [
        *(f"#define {name} {value}" for name, value in macros.items()),
        _template("lanes.h"),
        f"static const int64_t OUTPUT_SIZES[] = {{{numbers}}};",
        *writer.functions(),
    ]
    if "ROWS" in macros:
        lines.append(_template("elimination.h"))
    lines.append(_template(job.template))
    return LaneText("\n".join(lines), np.array(writer.constants, dtype=float))


@functools.cache
def _template(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


class _Writer:
    """Writes the functions of a graph.

    varying  numbers of the inputs that vary while the others stay

    Attributes:

    constants  numbers of the constants' array
    slots      for each node that varying ones take from fixed ones, its index in `fixed`
    """

    def __init__(self, graph: Graph, varying: Collection[int]) -> None:
        self._graph, self._varied = graph, graph.varying(varying)
        self._starts = np.cumsum([0, *graph.inputs]).tolist()
        nodes = graph.nodes
        self.constants = [n.constant for n in nodes if n.constant is not None]
        numbers = [k for k, n in enumerate(nodes) if n.constant is not None]
        self._constant = {number: index for index, number in enumerate(numbers)}
        self.slots = {number: k for k, number in enumerate(self._shared())}

    def _shared(self) -> list[int]:
        """Computed nodes that stay, of which varying ones take the values."""
        nodes = self._graph.nodes
        sources = {
            source for number in self._varied for source in nodes[number].sources
        }
        return [
            source
            for source in sorted(sources - self._varied)
            if nodes[source].operation is not None
        ]

    def functions(self) -> Iterator[str]:
        """The functions `prepare`, `every_output` and `first_output`."""
        outputs = self._graph.outputs
        every = list(enumerate(n for output in outputs for n in output))
        fixed = [(k, n) for k, n in every if n not in self._varied]
        varied = [(k, n) for k, n in every if n in self._varied]
        first = [(k, n) for k, n in varied if k < len(outputs[0])]
        slots = {f"fixed[{k}]": number for number, k in self.slots.items()}
        results = slots | {f"out[{k}]": number for k, number in fixed}
        yield self._function("prepare", results, (), "vec *restrict fixed")
        pairs = {"every_output": varied, "first_output": first}
        for name, chosen in pairs.items():
            results = {f"out[{k}]": number for k, number in chosen}
            yield self._function(name, results, self.slots, "const vec *fixed")

    def _function(
        self,
        name: str,
        results: dict[str, int],
        computed: Collection[int],
        fixed: str,
    ) -> str:
        """A function that writes results, by variable, from inputs and computed nodes."""
        lines = [
            f"static inline void {name}(const vec *in, const double *constants,"
            f" {fixed}, vec *restrict out)",
            "{",
        ]
        angles: set[int] = set()
        for number in sorted(self._graph.needed(results.values(), computed)):
            node = self._graph.nodes[number]
            if node.operation in ANGLE_FUNCTIONS and number not in computed:
                angle = node.sources[0]
                if angle not in angles:
                    angles.add(angle)
                    lines.append(f"vec s{angle}, c{angle};")
                    lines.append(f"sine_cosine(v{angle}, &s{angle}, &c{angle});")
            value = (
                f"fixed[{self.slots[number]}]"
                if number in computed
                else self._expression(number, node)
            )
            lines.append(f"const vec v{number} = {value};")
        lines += [f"{variable} = v{n};" for variable, n in results.items()]
        return "\n".join([*lines, "}"])

    def _expression(self, number: int, node: Node) -> str:
        """The value of a node, from its sources."""
        if node.constant is not None:
            return f"splat(constants[{self._constant[number]}])"
        if node.entry is not None:
            return f"in[{self._starts[node.entry[0]] + node.entry[1]}]"
        assert node.operation is not None
        if node.operation in ANGLE_FUNCTIONS:
            return f"{ANGLE_FUNCTIONS[node.operation]}{node.sources[0]}"
        sources = [f"v{source}" for source in node.sources]
        return OPERATIONS[node.operation].expression.format(*sources)


class _Limits(ctypes.Structure):
    """`limits` of newton.h."""

    _fields_ = (
        ("step_tolerance", ctypes.c_double),
        ("longest", ctypes.c_double),
        ("short_step", ctypes.c_double),
        ("remaining", ctypes.c_double),
        ("acceptable", ctypes.c_double),
        ("newton_steps", ctypes.c_int64),
        ("chord_steps", ctypes.c_int64),
    )


class _InputTable(NamedTuple):
    """Inputs at points, as C reads them.

    arrays  what they lie in, kept alive
    table   (inputs, 4): place, steps from row to row (outer, inner), entries
    shape   of the points: (n,), or (m, n) with the last the fastest
    """

    arrays: list[Array]
    table: Any
    shape: tuple[int, ...]

    @property
    def size(self) -> int:
        return int(np.prod(self.shape))

    @property
    def inner(self) -> int:
        return max(self.shape[-1], 1)


class _Lanes:
    """A job on a function, compiled."""

    #: its function in C
    name: str

    def __init__(self, library: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        self._run = getattr(library, self.name)
        self._run.restype = None
        self._constants = constants
        self._entries = list(graph.inputs)

    def _call(self, points: _InputTable, *arguments: Any) -> None:
        """Run at all points, on all cores where they are many.

        Raises ValueError for inputs of other sizes, which C would read beyond.
        """
        entries = [a.shape[-1] for a in points.arrays]
        if entries != self._entries[: len(entries)]:
            raise ValueError(f"inputs have {entries} entries, not {self._entries}")
        table, inner = _pointer(points.table), ctypes.c_int64(points.inner)
        constants = _pointer(self._constants)

        def run(first: int, end: int) -> None:
            ends = ctypes.c_int64(first), ctypes.c_int64(end)
            self._run(*ends, inner, table, constants, *arguments)

        share_points(run, points.size)


class Evaluation(_Lanes):
    """Values of a function's outputs."""

    name, job = "pkm_evaluate", LaneJob("evaluate.h", frozenset())

    def __init__(self, library: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        super().__init__(library, graph, constants)
        self._sizes = [len(row) for row in graph.outputs]

    def run(self, inputs: Sequence[Array], count: int) -> list[Array]:
        """Outputs (count, entries), each column by column, at inputs (count, size)."""
        outputs = [np.empty((count, size)) for size in self._sizes]
        addresses = np.array([_address(a) for a in outputs], dtype=np.int64)
        self._call(_points(inputs, (count,)), _pointer(addresses))
        return outputs


class Newton(_Lanes):
    """Newton's method for value = 0."""

    name = "pkm_newton"

    def __init__(self, library: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        super().__init__(library, graph, constants)
        self._rows = len(graph.outputs[0])

    @staticmethod
    def job(graph: Graph, unknown: int) -> LaneJob:
        """The job on a function of value and slope.

        unknown  number of leading inputs to solve for
        """
        macros = (("ROWS", len(graph.outputs[0])),)
        return LaneJob("newton.h", frozenset(range(unknown)), macros)

    def solve(
        self,
        inputs: Sequence[Array],
        unknown: int,
        step_tolerance: float,
        longest: float,
    ) -> SolvedSystems:
        """Solutions near `inputs` (n, entries) or (m, n, entries).

        unknown         number of leading inputs to solve for
        step_tolerance  longest last step (m, rad)
        longest         longest step (m, rad) of a system that this method may solve
        """
        shape = inputs[0].shape[:-1]
        points = _points(inputs, shape)
        solutions = np.empty((*shape, self._rows))
        states = np.empty(shape, dtype=np.uint8)
        limits = _Limits(
            step_tolerance,
            longest,
            SHORT_STEP,
            FINAL_ERROR,
            REMAINING_ERROR,
            MAX_NEWTON_STEPS,
            MAX_CHORD_STEPS,
        )
        limits_pointer = ctypes.byref(limits)
        self._call(points, limits_pointer, _pointer(solutions), _pointer(states))
        ends = np.cumsum([a.shape[-1] for a in inputs[:unknown]])[:-1]
        values = np.split(solutions, ends, axis=-1)
        return SolvedSystems(values, states == SOLVED, states == NEAR)


class Adjoint(_Lanes):
    """Rows by adjoints; see `oed.mechanism.tape`."""

    name = "pkm_adjoint"

    def __init__(self, library: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        super().__init__(library, graph, constants)
        self._columns = len(graph.outputs[1])

    @staticmethod
    def job(graph: Graph) -> LaneJob:
        """The job on a function of a matrix and a row, which takes the factors last."""
        last = len(graph.inputs) - 1
        macros = (("ROWS", graph.inputs[last]),)
        return LaneJob("adjoint.h", frozenset({last}), macros)

    def run(self, inputs: Sequence[Array], right: Array, scale: Array) -> AdjointRows:
        """Rows at n points, for right sides (n, channels, k) and units (k,)."""
        n, channels, _ = right.shape
        right = np.ascontiguousarray(right)
        scale = np.ascontiguousarray(scale)
        values = np.empty((n, channels, self._columns))
        condition = np.empty(n)
        self._call(
            _points(inputs, (n,)),
            _pointer(scale),
            ctypes.c_int64(channels),
            _pointer(right),
            _pointer(values),
            _pointer(condition),
        )
        accurate: Mask = np.isfinite(condition)
        return AdjointRows(values, condition, accurate)


def compiled(
    kind: Callable[[ctypes.CDLL, Graph, Array], Any], graph: Graph, job: LaneJob
) -> Any:
    """A job on a dense SX function, compiled; None where that cannot be."""
    if len(graph.nodes) > MAX_INSTRUCTIONS:
        return None
    written = lane_text(graph, job)
    library = load(written.text)
    return None if library is None else kind(library, graph, written.constants)


def _points(inputs: Sequence[Array], shape: tuple[int, ...]) -> _InputTable:
    """Inputs (..., entries) at points of a shape of one or two dimensions."""
    arrays = [_readable(a, shape) for a in inputs]
    table = np.zeros((len(arrays), 4), dtype=np.int64)
    for row, array in zip(table, arrays, strict=True):
        steps = [stride // NUMBER_SIZE for stride in array.strides[:-1]]
        outer = steps[0] if len(steps) == 2 else 0
        row[:] = _address(array), outer, steps[-1], array.shape[-1]
    return _InputTable(arrays, table, shape)


def _readable(values: Array, shape: tuple[int, ...]) -> Array:
    """Doubles at every point, without copies where one row serves several."""
    values = np.asarray(values, dtype=float)
    aligned = not any(stride % NUMBER_SIZE for stride in values.strides)
    if not (aligned and values.strides[-1] == NUMBER_SIZE):
        values = np.ascontiguousarray(values)
    if values.shape[:-1] == shape:
        return values
    return np.broadcast_to(values, (*shape, values.shape[-1]))


def _address(array: Array) -> int:
    address: int = array.__array_interface__["data"][0]
    return address


def _pointer(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(_address(array))


def share_points(run: Callable[[int, int], None], count: int) -> None:
    """Run from 0 to `count` in as many shares as there are cores for this process."""
    shares = count // MIN_SHARED_POINTS
    cores = min(_cores(), shares) if shares > 1 else 1
    if cores < 2:
        run(0, count)
        return
    size = -(-count // (cores * MAX_LANES)) * MAX_LANES
    starts = range(0, count, size)
    threads = [
        threading.Thread(target=run, args=(start, min(start + size, count)))
        for start in starts[1:]
    ]
    for thread in threads:
        thread.start()
    try:
        run(0, min(size, count))
    finally:  # an interrupt waits: the threads write into the caller's arrays
        for thread in threads:
            thread.join()


def _cores() -> int:
    """Cores of this process, or fewer where `OMP_NUM_THREADS` states so."""
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    stated = os.environ.get("OMP_NUM_THREADS", "")
    return max(min(cores, int(stated)), 1) if stated.isdecimal() else cores
