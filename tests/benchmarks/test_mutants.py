"""Mutations of a small text, and their verdicts in a toy room."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import mutants
from benchmarks.mutants import Mutant, Mutation, draw, marked, mutations

TEXT = '''"""Sums: 1 + 1 < 3."""
def total(x: Annotated[int, 4], y, step=0.5, keep=False):
    """Not 2 * 3."""
    if not keep and x < y:
        return max(x, y) - step * x
    print(f"{x + 1}")
    return sum(y[1] for _ in range(x)) + norm(x, y) + "µ".find(x[:y])
'''
EXPECTED = {
    (2, "default", "step=(1.0)"),
    (2, "default", "step=(0.25)"),
    (2, "default", "keep=(True)"),
    (4, "negation", "if (keep) and x < y"),
    (4, "comparison", "if not keep and (x <= y)"),
    (5, "extremum", "(min)(x, y)"),
    (5, "sign", "(max(x, y) + step * x)"),
    (5, "sign", "(step / x)"),
    (7, "index", "y[(1 + 1)]"),
    (7, "index", "y[(1 - 1)]"),
    (7, "index", "range((x + 1))"),
    (7, "index", "range((x - 1))"),
    (7, "index", "x[:(y + 1)]"),
    (7, "index", "x[:(y - 1)]"),
    (7, "swap", "(norm(y, x))"),
    (7, "sign", "range(x))) - norm"),
}
TOY = "def mean(x):\n    n = len(x)\n    assert n > 0\n    return sum(x) / n\n"
TOY += "def after(x):\n    return x + 1\n"
TESTS = """from oed.toy.mean import mean


def test_mean():
    assert mean([1.0, 2.0, 6.0]) == 3.0
"""


def test_mutations_of_a_text_are_those_listed():
    """Docstrings, annotations and formatted strings stay."""
    every = [(m.line, m.kind, m.applied(TEXT)) for m in mutations(TEXT)]
    for line, kind, fragment in EXPECTED:
        assert [1 for n, k, a in every if (n, k) == (line, kind) and fragment in a]
    assert {line for line, _, _ in every} == {2, 4, 5, 7}


def test_a_mutation_changes_its_line_alone_and_what_it_computes():
    before, tree = TEXT.split("\n"), ast.dump(ast.parse(TEXT))
    for mutation in mutations(TEXT):
        text = mutation.applied(TEXT)
        after = text.split("\n")
        changed = [k for k, line in enumerate(before, 1) if line != after[k - 1]]
        assert changed == [mutation.line]
        assert ast.dump(ast.parse(text)) != tree


def test_an_expression_of_several_lines_changes_as_a_whole():
    text = "x = (\n    ä\n    - b * (c + 1)\n)\n"
    (found,) = (m for m in mutations(text) if m.kind == "sign" and m.line == 2)
    assert found.before(text) == "ä\n    - b * (c + 1)"
    assert found.applied(text) == "x = (\n    (ä + b * (c + 1))\n)\n"


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


def mutant(kind: str, line: int) -> Mutant:
    drawn = {(m.kind, m.line): m for m in mutations(TOY)}
    return Mutant("oed/toy", "oed/toy/mean.py", drawn[kind, line])


def test_a_mark_stands_before_the_statement_of_its_line():
    """In TEXT: line 5 stands in a branch, and line 2 has the default of a function."""
    after = marked(TEXT, {2: 0, 5: 1}).replace("\n\n", "\n").split("\n")
    for number, statement in enumerate(("def total", "return max")):
        (k,) = (k for k, line in enumerate(after) if f".mark({number})" in line)
        assert after[k + 1].strip().startswith(statement)


def test_modules_belong_to_the_folder_of_tests_that_mirrors_them(toy):
    for name in ("oed/plain.py", "studies/pkm_page/show.py", "oed/toy/more/sums.py"):
        (toy / name).parent.mkdir(parents=True, exist_ok=True)
        (toy / name).touch()
    (toy / "tests/page").mkdir()
    names = {r: [p.stem for p in paths] for r, paths in mutants.rooms_of(toy).items()}
    mirrored = ["__init__", "mean", "sums"]
    expected = {"oed": ["__init__", "plain"], "oed/toy": mirrored, "page": ["show"]}
    assert names == expected


@pytest.mark.slow
def test_a_fault_is_killed_and_an_equivalent_survives(toy):
    """sum(x) * n is detected; n >= 0 in place of n > 0 is not: no test has n = 0.

    The function with a default of its own is not called.
    """
    cases = {("sign", 4): mutants.KILLED, ("comparison", 3): mutants.SURVIVED}
    drawn = [mutant(*case) for case in (*cases, ("sign", 6))]
    with mutants.copied(toy) as tree:
        passes, limit, reaching = mutants.baseline(tree, drawn)
        test = "tests/oed/toy/test_mean.py::test_mean"
        assert passes
        assert reaching == {0: [test], 1: [test]}
        for k, expected in enumerate(cases.values()):
            assert mutants.try_mutant(tree, drawn[k], reaching[k], limit) == expected
            assert (tree / drawn[k].path).read_text(encoding="utf-8") == TOY
    assert (toy / "oed/toy/mean.py").read_text(encoding="utf-8") == TOY


def test_a_mutant_without_end_is_killed_by_the_time_limit(toy):
    start = TOY.index("n = len(x)")
    endless = Mutation("sign", 2, start, start + 10, "while True: pass")
    with mutants.copied(toy) as tree:
        trial = Mutant("oed/toy", "oed/toy/mean.py", endless)
        assert mutants.try_mutant(tree, trial, [], 3.0) == mutants.TIMED_OUT


@pytest.mark.slow
def test_the_command_names_survivors_and_what_no_test_reaches(toy, capsys):
    assert mutants.main(["--seed", "1", "--count", "9"], toy) == 1
    printed = capsys.readouterr().out
    assert "+ (n >= 0)" in printed
    assert re.search(r"not reached +[a-z]+ +oed/toy/mean.py:6", printed)
    assert re.search(r"^all +[2-4] +1 +1 +0$", printed, re.MULTILINE)


def test_same_seed_draws_the_same_mutants(toy):
    first, second = (
        draw(toy, ["oed/toy"], 2, np.random.default_rng(5)) for _ in range(2)
    )
    assert first == second
    ((share, candidates),) = first
    assert share == 2
    assert len({m.mutation.line for m in candidates}) == len(candidates) >= 2
