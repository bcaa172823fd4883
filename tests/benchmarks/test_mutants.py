"""Mutations of a small text, and their verdicts in a toy room."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import mutants
from benchmarks.mutants import (
    Mutant,
    Mutation,
    applied,
    draw,
    is_valid,
    mutations,
    shares,
)

TEXT = '''"""Sums: 1 + 1 < 3."""
def total(x: Annotated[int, 4], y, step=0.5, keep=False):
    """Not 2 * 3."""
    if not keep and x < y:
        return max(x, y) - step * x
    print(f"{x + 1}")
    return sum(y[1] for _ in range(x)) + norm(x, y) + "µ".find(x[:y])
'''
EXPECTED = {
    (2, "default", "step=1.0"),
    (2, "default", "step=0.25"),
    (2, "default", "keep=True"),
    (4, "negation", "if  keep and x < y"),
    (4, "comparison", "if not keep and x <= y"),
    (5, "extremum", "min(x, y)"),
    (5, "sign", "max(x, y) + step"),
    (5, "sign", "step / x"),
    (7, "index", "y[2]"),
    (7, "index", "y[0]"),
    (7, "index", "range((x) + 1)"),
    (7, "index", "range((x) - 1)"),
    (7, "index", "x[:(y) + 1]"),
    (7, "index", "x[:(y) - 1]"),
    (7, "swap", "norm(y, x)"),
    (7, "sign", "range(x)) - norm"),
}
TOY = "def mean(x):\n    n = len(x)\n    assert n > 0\n    return sum(x) / n\n"
TESTS = """from oed.toy.mean import mean


def test_mean():
    assert mean([1.0, 2.0, 6.0]) == 3.0
"""


def test_mutations_of_a_text_are_those_listed() -> None:
    """Docstrings, annotations and formatted strings stay."""
    every = {(m.line, m.kind, m.after) for m in mutations(TEXT)}
    for line, kind, fragment in EXPECTED:
        assert [1 for n, k, a in every if (n, k) == (line, kind) and fragment in a]
    assert {line for line, _, _ in every} == {2, 4, 5, 7}


def test_a_mutation_changes_its_line_alone() -> None:
    before = TEXT.split("\n")
    for mutation in mutations(TEXT):
        after = applied(TEXT, mutation).split("\n")
        changed = [k for k, line in enumerate(before, 1) if line != after[k - 1]]
        assert changed == [mutation.line]
        assert is_valid(TEXT, mutation)


def test_what_does_not_compile_or_changes_nothing_is_not_valid() -> None:
    line = "    if not keep and x < y:"
    for after in (f"{line} # a comment", "    if not keep and x <:"):
        assert not is_valid(TEXT, Mutation("sign", 4, line, after))


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    """A tree with one room."""
    files = {
        "oed/__init__.py": "",
        "oed/toy/__init__.py": "",
        "oed/toy/mean.py": TOY,
        "tests/oed/toy/test_mean.py": TESTS,
    }
    for name, text in files.items():
        path = tmp_path / "toy" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path / "toy"


@pytest.mark.slow
def test_a_fault_is_killed_and_an_equivalent_survives(toy: Path) -> None:
    """sum(x) * n is detected; n >= 0 in place of n > 0 is not: no test has n = 0."""
    cases = {("sign", 4): mutants.KILLED, ("comparison", 3): mutants.SURVIVED}
    drawn = {(m.kind, m.line): m for m in mutations(TOY)}
    with mutants.copied(toy) as tree:
        limit = mutants.limit_of(tree, "toy")
        for case, expected in cases.items():
            mutant = Mutant("toy", "oed/toy/mean.py", drawn[case])
            assert mutants.try_mutant(tree, mutant, limit) == expected
            assert (tree / mutant.path).read_text(encoding="utf-8") == TOY
    assert (toy / "oed/toy/mean.py").read_text(encoding="utf-8") == TOY


def test_a_mutant_without_end_is_killed_by_the_time_limit(toy: Path) -> None:
    before = "    n = len(x)"
    endless = Mutation("sign", 2, before, "    while True: pass")
    with mutants.copied(toy) as tree:
        mutant = Mutant("toy", "oed/toy/mean.py", endless)
        assert mutants.try_mutant(tree, mutant, 3.0) == mutants.TIMED_OUT


@pytest.mark.slow
def test_the_command_names_survivors(
    toy: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    table = tmp_path / "mutants.csv"
    arguments = ["--seed", "1", "--count", "9", "--out", str(table)]
    assert mutants.main(arguments, toy) == 1
    printed = capsys.readouterr().out
    assert "+ assert n >" in printed
    assert len(table.read_text(encoding="utf-8").splitlines()) > 2
    with pytest.raises(SystemExit):
        mutants.main(arguments, toy)


def test_shares_follow_the_sizes() -> None:
    assert shares([10, 20, 30], 6) == [1, 2, 3]
    assert shares([1, 1, 1], 4) == [2, 1, 1]
    assert sum(shares([7, 13, 1], 60)) == 60


def test_same_seed_draws_the_same_mutants(toy: Path) -> None:
    first, second = (draw(toy, ["toy"], 2, np.random.default_rng(5)) for _ in range(2))
    assert first == second
    assert len({m.mutation.line for m in first}) == 2
