"""The same study on another kernel of the BLAS library has the same result.

Its numbers agree but for rounding; figures of draws agree within the Monte Carlo error
that the result states, and what is printed is the same.
"""

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import report_fixture
import sample

STUDY = (
    sample.changed(
        sample.STUDY,
        ("html = false", "html = true"),
        ("readings = 21", "readings = 24"),
    )
    + "\n[readings]\nsimulate = true\n[posterior]\nsteps = 300\ness = 200\n"
    "[prediction]\nvirtual_machines = 20\n"
    'z_mm = 1146.0\npsi_deg = [0.0, 120.0]\ntheta_deg = [10.0, 20.0]\nreference = "home"\n'
)
KERNELS = ("Nehalem", "Haswell")  #: kernels of very different instructions
#: what rounding may change: relative, and beside it of numbers that are nothing
RELATIVE, ABSOLUTE = 1e-5, 1e-9
#: the same of statistics of ranks, which two draws that change places move
RANKED = {"ess": 1e-4, "rhat": 1e-4}
ASIDE = ("seconds", "written")  #: keys whose numbers are of no computation


def _is_dynamic() -> bool:
    config: Any = np.show_config(mode="dicts")
    blas = config["Build Dependencies"]["blas"]
    return "DYNAMIC_ARCH" in str(blas.get("openblas configuration", ""))


def run(folder: Path, kernel: str) -> tuple[dict[str, Any], str, str]:
    """Result, text of the report, and the kernel that ran."""
    environment = {**os.environ, "OPENBLAS_CORETYPE": kernel, "OPENBLAS_VERBOSE": "2"}
    environment["OPENBLAS_NUM_THREADS"] = "1"
    command = [sys.executable, "-m", "pkm_studies.commands.cli", "run", "s.study.toml"]
    done = subprocess.run(
        [*command, "--quiet", "--out", kernel],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    result = json.loads((folder / kernel / "result.json").read_text("utf-8"))
    page = (folder / kernel / "report.html").read_text("utf-8")
    body = page[page.index("<body") : page.rindex("<script")]
    words = re.sub(r"(time\s+)[\d.]+\s+s\b", r"\1", report_fixture.text_of(body))
    return result, words, done.stdout + done.stderr


def pairs(
    first: Any, second: Any, path: str = ""
) -> Iterator[tuple[str, Any, Any, float]]:
    """Path, both values and the Monte Carlo error of every leaf of two results."""
    assert type(first) is type(second), path
    if isinstance(first, dict):
        assert first.keys() == second.keys(), path
        for key in first.keys() - set(ASIDE):
            errors = first.get("monte_carlo", {})
            for leaf in pairs(first[key], second[key], f"{path}.{key}"):
                yield (*leaf[:3], max(leaf[3], *errors.get(key, [0.0])))
    elif isinstance(first, list):
        assert len(first) == len(second), path
        for k, entries in enumerate(zip(first, second, strict=True)):
            yield from pairs(*entries, f"{path}[{k}]")
    else:
        yield path, first, second, 0.0


@pytest.mark.slow
@pytest.mark.skipif(not _is_dynamic(), reason="NumPy's BLAS has one kernel alone")
def test_another_kernel_changes_nothing_but_rounding(tmp_path):
    (tmp_path / "s.study.toml").write_text(STUDY, "utf-8")
    (first, page, words), (second, other_page, other_words) = (
        run(tmp_path, kernel) for kernel in KERNELS
    )
    if not all(k in w for k, w in zip(KERNELS, (words, other_words), strict=True)):
        pytest.skip("this processor has not both kernels")
    differing = 0
    for path, a, b, error in pairs(first, second):
        if not isinstance(a, float) or a == b:
            assert a == b, path
            continue
        relative = RANKED.get(path.rpartition(".")[2], RELATIVE)
        close = math.isclose(a, b, rel_tol=relative, abs_tol=max(ABSOLUTE, error))
        assert close, (path, a, b, error)
        differing += 1
    assert differing > 100  # the kernels do round differently
    assert first["posterior"]["marginals"]
    assert first["prediction"]["components"]["psi"]["after"]["monte_carlo"]
    assert page == other_page
