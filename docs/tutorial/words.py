"""The verdict on identifiability, from a result."""

import json
import sys
from pathlib import Path

result = json.loads(Path(sys.argv[1], "result.json").read_text(encoding="utf-8"))
verdict = result["identifiability"]
print(f"{verdict['rank']} of {verdict['n']}")
for finding in verdict["words"]:
    print(f"- {finding['text']}")
    for remedy in finding["remedies"]:
        print(f"    remedy: {remedy}")
