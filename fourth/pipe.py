"""Diagnoses as the command does, and returns the result's section gap."""
from pathlib import Path
import msgspec, json
from pkm_studies import stages
from pkm_studies import study as studies
from pkm_studies.user_code import Consent
import pkm_studies.stages.gap.diagnosis as gd
def diagnose(case, visit=True):
    if not visit:
        gd.advise_second_visit = lambda *a, **k: None
        import pkm_studies.stages.gap.sentences as gs
        if hasattr(gs, "advise_second_visit"): gs.advise_second_visit = lambda *a, **k: None
    loaded = studies.load(Path(case.study), Consent.GIVEN)
    out = Path(case.readings).parent / "out"
    r = stages.diagnose_study(loaded, [Path(case.readings)], out)
    g = r.gap
    b = json.loads((out / "result.json").read_text())
    rec = {"warnings": b.get("warnings"), "headline": b.get("headline") or b.get("summary"), "pipeline": True}
    if g is None:
        rec["failure"] = "no diagnosis: " + "; ".join(b.get("warnings") or [])
        rec["withheld"] = True
        return rec
    gg = b["gap"]
    for k in ("verdict", "answers", "set95", "where", "closure", "not_testable", "confusable", "sizes", "words", "next", "selected", "unknown", "nearest", "noise", "rms_before", "rms_after", "mixture"):
        rec[k] = gg.get(k)
    rec["coeffs"] = gg.get("coefficients")
    return rec
