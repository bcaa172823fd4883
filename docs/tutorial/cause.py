"""The effect that the diagnosis names, compared with the virtual machine's truth."""

import json
from pathlib import Path

gap = json.loads(Path("cause/result.json").read_text(encoding="utf-8"))["gap"]
truth = json.loads(Path("circles.truth.json").read_text(encoding="utf-8"))["effects"][0]

print(f"{', '.join(gap['selected'])}, in {gap['where'][0]['block']}")
before, after = gap["rms_before"]["length"], gap["rms_after"]["length"]
print(f"rms {before:.2f} um before, {after:.2f} um after")
estimates = {c["name"]: c for c in gap["coefficients"]}
for name, true in truth["coefficients"].items():
    value, sd = 1e3 * estimates[name]["value"], 1e3 * estimates[name]["sd"]
    true_value = 1e3 * true["value"]
    print(f"{name}: {value:.4f} mrad, sd {sd:.4f}; in truth {true_value:.4f}")
    assert abs(value - true_value) < 4.0 * sd
assert gap["selected"] == [truth["effect"]] == ["gear_runout"]
