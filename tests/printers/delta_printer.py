"""Delta printers in tests: files in, the study that is imported, and its export."""

import re
import tomllib
from pathlib import Path

import oed
from oed import units
from pkm_studies.commands import main
from pkm_studies.importers import ImportedSession, import_files

#: no samples, no report, and no effects: the printers of these tests have none
PLAIN = "\n[posterior]\nenabled = false\n[report]\nhtml = false\npdf = false\n"
GEOMETRY_ALONE = '[identify]\neffects = "none"\n'


def take(
    kind: str, files: dict[str, str], folder: Path
) -> tuple[Path, ImportedSession]:
    """The study of an import, without samples and report."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    paths = [folder / name for name in files]
    study, imported = import_files(kind, paths, folder / "study", name="p")
    study.write_text(study.read_text() + PLAIN + GEOMETRY_ALONE)
    return study, imported


def said(imported: ImportedSession) -> str:
    """All that an import says."""
    return "\n".join(imported.statements)


def nominal(study: Path) -> dict[str, float]:
    """The geometry that the firmware had, mm and deg."""
    return dict(oed.load_study(study).machine.nominal)


def endstops(study: Path) -> list[float]:
    """Its heights of the endstops, mm."""
    values = nominal(study)
    return [values[f"endstop{i}_mm"] for i in (1, 2, 3)]


def with_known_noise(study: Path, height_um: float) -> None:
    """State noise that an import assumes as known, of lengths in proportion.

    A fit estimates the law of assumed noise, which takes most of its time.
    """
    text = study.read_text()
    if "assumed = true" not in text:
        return
    stated = tomllib.loads(text)["noise"]
    for name in {"height_um", "length_um"} & stated.keys():
        known = stated[name] * height_um / stated["height_um"]
        text = re.sub(rf"(?m)^{name} = .*$", f"{name} = {known:.9g}", text)
    study.write_text(re.sub(r"(?m)^assumed = true.*$", "estimate = false", text))


def fitted(study: Path) -> dict[str, float]:
    """Fitted numbers in mm and deg."""
    section = oed.identify(oed.read_readings(oed.load_study(study))).section
    return {
        name: float(units.to_si(e.value, e.unit))
        / (units.DEG if name.startswith("angle") else 1e-3)
        for name, e in section.parameters.items()
    }


def compensate(study: Path, kind: str, *options: str) -> str:
    """The text that a study's result gives for a firmware."""
    folder = study.parent
    assert main(["run", str(study), "--out", str(folder / "r"), "--quiet"]) == 0
    out = folder / f"export{len(list(folder.glob('export*')))}"
    call = ["compensate", str(folder / "r"), "--to", kind, "--out", str(out), *options]
    assert main(call) == 0
    return out.read_text()
