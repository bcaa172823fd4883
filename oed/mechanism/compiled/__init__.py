"""Compiled functions over arrays of poses: evaluation, Newton's method, adjoints.

Their C text has one statement for each value, over vectors of poses. It holds no number of
the machine: constants are an array that a call brings along. So machines that differ in
their dimensions alone share it, as those of a campaign do.

No product and sum become one operation, and sines are those of the C library: so each
digit is that of CasADi's interpreter (`oed.mechanism.tape`, `oed.mechanism.systems`).
"""

import collections
import contextlib
import ctypes
import dataclasses
import functools
import hashlib
import itertools
import math
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from importlib import resources
from multiprocessing import util
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import platformdirs

from oed import child_process
from oed.base import Array
from oed.mechanism.graph import OPERATIONS, Graph, Node
from oed.mechanism.systems import (
    CHORD_STEPS,
    FINAL_ERROR,
    NEWTON_STEPS,
    REMAINING_ERROR,
    SHORT_STEP,
    AdjointRows,
    SolvedSystems,
)
from oed.safe_files import make_private, whole_file

# The C compiler of this computer, and the files that it made, kept from run to run.
#
# A text is compiled once a computer. The file's name is a digest of text, flags, compiler
# and processor, and one of its content: so a changed compiler compiles anew, and a damaged
# file is not loaded. Whatever fails, there is no function, and the interpreter serves.

#: names of compilers that know the vectors of lanes.h
COMPILERS = ("cc", "gcc", "clang")
#: none changes a result: a product and a sum must not become one operation
FLAGS = (
    *("-std=gnu11", "-O2", "-fno-math-errno", "-fno-trapping-math"),
    *("-ffp-contract=off", "-fno-strict-aliasing", "-w", "-shared", "-fPIC"),
)
#: all that this processor can do, or what every one can, where the compiler cannot tell
PROCESSORS = (("-march=native",), ())
COMPILATION_TIMEOUT = 120.0  #: longest time of a compilation, s
END_TIMEOUT = 2.0  #: time that a compiler has to end with the program, s
MAX_FILES = 512  #: files of the folder beyond which the oldest are removed
DIGEST_LENGTH = 32  #: characters of a digest in a file's name
FOLDER_NAME = "compiled"  #: name of the folder with the compiled files


@dataclasses.dataclass(frozen=True)
class Compiler:
    """A compiler of this computer."""

    path: str  #: its program
    identity: str  #: what changes with the compiler and the processor


def compiled_text(text: str) -> "CompiledText | None":
    """The functions of a C text; None where there is no compiler."""
    compiler = find_compiler(os.environ.get("PATH", ""))
    return None if compiler is None else _compiled_text(text, compiler, cache_folder())


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


class CompiledText:
    """The functions of a C text, once they are there.

    functions  those of the compiled file; None before, and where there will be none
    is_done    whether the text was compiled, or that failed
    """

    def __init__(self, text: str, compiler: Compiler, folder: Path) -> None:
        self._text, self._compiler, self._folder = text, compiler, folder
        parts = "\n".join([text, *FLAGS, str(PROCESSORS), compiler.identity])
        self._digest = hashlib.sha256(parts.encode()).hexdigest()[:DIGEST_LENGTH]
        self._lock = threading.Lock()
        self.functions: ctypes.CDLL | None = None
        self.is_done = False
        try:
            self.functions = self._earlier()
        except OSError:
            self.is_done = True
        if self.functions is not None:
            self.is_done = True

    def _earlier(self) -> ctypes.CDLL | None:
        """The file of an earlier compilation. Raises OSError where none can be kept."""
        if not make_private(self._folder):
            raise NotADirectoryError(self._folder)
        for file in sorted(self._folder.glob(f"{self._digest}-*.so")):
            if _is_whole(file):
                return ctypes.CDLL(str(file))
            file.unlink(missing_ok=True)
        return None

    def make(self) -> None:
        """Compile the text; where a thread does so already, wait for it."""
        with self._lock:
            if self.is_done:
                return
            try:
                file = _compile(self._text, self._compiler, self._folder, self._digest)
                self.functions = _opened(file)
            except (OSError, subprocess.SubprocessError):
                self.functions = None
            self.is_done = True

    def make_beside(self) -> None:
        """Compile the text in a thread, after others that wait."""
        _compilations.add(self)


@functools.cache
def _compiled_text(text: str, compiler: Compiler, folder: Path) -> CompiledText:
    """As `compiled_text`, once a process for each text."""
    return CompiledText(text, compiler, folder)


class _CompilationThread:
    """Compiles one text after the other in a thread, while the program works.

    Where the program ends, so does the compiler.
    """

    def __init__(self) -> None:
        self._waiting: collections.deque[CompiledText] = collections.deque()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def add(self, text: CompiledText) -> None:
        with self._lock:
            self._waiting.append(text)
            if self._thread is None:
                util.Finalize(self, self._stop, exitpriority=1)
                self._thread = threading.Thread(target=self._work, daemon=True)
                self._thread.start()

    def _work(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self._thread = None
                    return
                text = self._waiting.popleft()
            text.make()

    def _stop(self) -> None:
        with self._lock:
            self._waiting.clear()
            thread = self._thread
        if thread is not None:
            child_process.end_programs()
            thread.join(END_TIMEOUT)


_compilations = _CompilationThread()


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
    # the folder stays small: processes that have a file open keep it
    compiled = sorted(folder.glob("*.so"), key=lambda file: file.stat().st_mtime_ns)
    for oldest in compiled[:-MAX_FILES]:
        oldest.unlink(missing_ok=True)
    return file


#: least number of points of a core's share: two milliseconds of work
MIN_SHARED_POINTS = 8192
MAX_LANES = 8  #: shares begin at multiples of this: of the lanes of every processor
#: instructions of the longest function that is compiled, in some ten seconds
MAX_INSTRUCTIONS = 20_000
SOLVED_STATE = 1  #: state of a solved point in newton.h
SHORT_STEP_STATE = 2  #: state of a point that ended with a short step
NUMBER_SIZE = 8  #: bytes of a number
DOUBLE = np.dtype(float)
#: first and last point, points of the inner dimension, table of the inputs, constants
SHARED_TYPES = (*(ctypes.c_int64,) * 3, ctypes.c_void_p, ctypes.c_void_p)
#: operations of one angle that share their work, by the letter of their variable
ANGLE_FUNCTIONS = {ca.OP_SIN: "s", ca.OP_COS: "c"}


class LaneJob(NamedTuple):
    """What is computed of a function."""

    template: str  #: the file of C text that does it
    varying: frozenset[int]  #: numbers of the inputs that vary while the others stay
    #: further numbers of the template, by name
    macros: tuple[tuple[str, int], ...] = ()


def lane_text(graph: Graph, job: LaneJob) -> tuple[str, Array]:
    """The C text of a job on the graph of a function, and the constants that it takes."""
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
    return "\n".join(lines), np.array(writer.constants, dtype=float)


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
        self._graph = graph
        self._varied = graph.varying(varying)
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
        self, name: str, results: dict[str, int], computed: Collection[int], fixed: str
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


class _Lanes:
    """A job on a function, compiled."""

    name: str  #: its function in C
    types: tuple[Any, ...]  #: types of its own arguments, after those of every job

    def __init__(self, functions: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        self._run = getattr(functions, self.name)
        self._run.restype = None
        self._run.argtypes = (*SHARED_TYPES, *self.types)
        self._constants = constants
        self._place_of_constants = address(constants)
        self._entries = list(graph.inputs)
        self._table = ctypes.c_int64 * (4 * len(graph.inputs))

    def _call(
        self, inputs: Sequence[Array], shape: tuple[int, ...], *arguments: Any
    ) -> None:
        """Run at inputs (..., entries) of points (n,) or (m, n), on all cores if many.

        Raises ValueError for inputs of other sizes, which C would read beyond.
        """
        numbers: list[int] = []
        arrays = []
        for array, entries in zip(inputs, self._entries, strict=False):
            if array.shape[-1] != entries:
                raise ValueError(
                    f"an input has {array.shape[-1]} entries, not {entries}"
                )
            readable = _readable(array)
            arrays.append(readable)
            numbers += address(readable), *_steps(readable, shape), entries
        table = self._table(*numbers)
        inner = max(shape[-1], 1)

        def run(first: int, end: int) -> None:
            self._run(first, end, inner, table, self._place_of_constants, *arguments)

        share_points(run, math.prod(shape))


class Evaluation(_Lanes):
    """Values of a function's outputs."""

    name = "pkm_evaluate"
    types = (ctypes.c_int64, ctypes.c_void_p)

    @staticmethod
    def job(graph: Graph) -> LaneJob:
        """The job on any function."""
        return LaneJob("evaluate.h", frozenset())

    def __init__(self, functions: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        super().__init__(functions, graph, constants)
        self._ends = np.cumsum([0, *(len(row) for row in graph.outputs)]).tolist()

    def run(self, inputs: Sequence[Array], count: int) -> list[Array]:
        """Outputs (count, entries), each column by column, at inputs (count, size)."""
        numbers = np.empty(count * self._ends[-1])
        self._call(inputs, (count,), count, address(numbers))
        return [
            numbers[count * start : count * end].reshape(count, end - start)
            for start, end in itertools.pairwise(self._ends)
        ]


class Newton(_Lanes):
    """Newton's method for value = 0, over the first input."""

    name = "pkm_newton"
    types = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)

    @staticmethod
    def job(graph: Graph) -> LaneJob:
        """The job on a function of value and slope."""
        macros = (("ROWS", len(graph.outputs[0])),)
        return LaneJob("newton.h", frozenset({0}), macros)

    def solve(
        self, inputs: Sequence[Array], step_tolerance: float, longest: float
    ) -> SolvedSystems:
        """Solutions near `inputs` (n, entries) or (m, n, entries).

        step_tolerance  longest last step (m, rad)
        longest         longest step (m, rad) of a system that this method may solve
        """
        shape = inputs[0].shape[:-1]
        solutions = np.empty(inputs[0].shape)
        states = np.empty(shape, dtype=np.uint8)
        limits = _limits(step_tolerance, longest)
        places = address(limits), address(solutions), address(states)
        self._call(inputs, shape, *places)
        return SolvedSystems(
            solutions, states == SOLVED_STATE, states == SHORT_STEP_STATE
        )


@functools.cache
def _limits(step_tolerance: float, longest: float) -> Array:
    """`limits` of newton.h."""
    errors, steps = (FINAL_ERROR, REMAINING_ERROR), (NEWTON_STEPS, CHORD_STEPS)
    return np.array([step_tolerance, longest, SHORT_STEP, *errors, *steps], dtype=float)


class Adjoint(_Lanes):
    """Rows by adjoints; see `oed.mechanism.systems`."""

    name = "pkm_adjoint"
    types = (ctypes.c_void_p, ctypes.c_int64, *(ctypes.c_void_p,) * 3)

    def __init__(self, functions: ctypes.CDLL, graph: Graph, constants: Array) -> None:
        super().__init__(functions, graph, constants)
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
        arrays = (
            np.ascontiguousarray(scale, dtype=float),
            np.ascontiguousarray(right, dtype=float),
            np.empty((n, channels, self._columns)),
            np.empty(n),
        )
        place_of_scale, *places = map(address, arrays)
        self._call(inputs, (n,), place_of_scale, channels, *places)
        return AdjointRows(arrays[2], arrays[3])


def _readable(values: Array) -> Array:
    """The same doubles, where C can read them row by row."""
    if values.dtype != DOUBLE:
        values = values.astype(float)
    if values.flags.c_contiguous:
        return values
    steps = values.strides
    if steps[-1] != NUMBER_SIZE or any(step % NUMBER_SIZE for step in steps):
        return np.ascontiguousarray(values)
    return values


def _steps(values: Array, shape: tuple[int, ...]) -> tuple[int, int]:
    """Numbers from row to row of values at points (n,), (m, n); 0 of a common row."""
    outer = inner = 0
    given = values.shape[:-1]
    if given and given[-1] != 1:
        inner = values.strides[-2] // NUMBER_SIZE
    if len(given) == 2 and given[0] != 1:
        outer = values.strides[0] // NUMBER_SIZE
    for size, points in zip(reversed(given), reversed(shape), strict=False):
        if size not in (points, 1):
            raise ValueError(f"an input {values.shape} cannot be broadcast to {shape}")
    return outer, inner


def address(array: np.ndarray) -> int:
    """Where its numbers are in memory."""
    pointer: int = array.__array_interface__["data"][0]
    return pointer


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
