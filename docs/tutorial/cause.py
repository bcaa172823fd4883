"""What the diagnosis found; then, as this machine is virtual, whether it is so."""

import json
from pathlib import Path

gap = json.loads(Path("cause/result.json").read_text(encoding="utf-8"))["gap"]
truth = json.loads(Path("circles.truth.json").read_text(encoding="utf-8"))["effects"][0]

print(f"{', '.join(gap['selected'])}, in {gap['where'][0]['block']}")
print(
    f"rms {gap['rms_before']['length']:.2f} um before, {gap['rms_after']['length']:.2f}"
    " um after"
)
found = {c["name"]: c for c in gap["coefficients"]}
for name, true in truth["coefficients"].items():
    value, sd = found[name]["value"], found[name]["sd"]
    print(
        f"{name}: {1e3 * value:.4f} mrad, sd {1e3 * sd:.4f}; in truth"
        f" {1e3 * true['value']:.4f}"
    )
    assert abs(value - true["value"]) < 4.0 * sd
assert gap["selected"] == [truth["effect"]] == ["gear_runout"]
