"""What writing a report loads: nothing that models or solves."""

import json

import report_fixture
import result_sample
from fresh_process import printed_by


def test_a_report_loads_neither_models_nor_solvers(tmp_path):
    result = report_fixture.bare() | {"gap": result_sample.gap()}
    (tmp_path / "result.json").write_text(json.dumps(result), encoding="utf-8")
    heavy = ["casadi", "oed.mechanism", "oed.measurement", "oed.estimation", "oed.gap"]
    code = (
        "import sys; from pkm_studies.commands import cli;"
        " print(cli.main(['report', '.']));"
        f" print(sorted(set({heavy}) & set(sys.modules)))"
    )
    printed = printed_by(code, tmp_path)
    assert "report.html" in "\n".join(printed)
    assert printed[-2:] == ["0", "[]"]


def test_the_lines_of_a_terminal_load_no_figures(tmp_path):
    """A run without a report draws nothing: neither Matplotlib nor templates are loaded."""
    path = tmp_path / "result.json"
    path.write_text(json.dumps(report_fixture.sample()), encoding="utf-8")
    code = (
        "import sys; from pathlib import Path; from pkm_reports import first_lines;"
        " from pkm_studies.results import load_result;"
        " lines = first_lines(load_result(Path('.')));"
        " print(len(lines.sentences) > 0, lines.table is not None,"
        " sorted({'matplotlib', 'jinja2', 'typst'} & set(sys.modules)))"
    )
    assert printed_by(code, tmp_path) == ["True True []"]
