"""The verdict on identifiability, from a result."""

import json
import sys
from pathlib import Path

seen = json.loads(Path(sys.argv[1], "result.json").read_text(encoding="utf-8"))[
    "identifiability"
]
print(f"{seen['rank']} of {seen['n']}")
for finding in seen["words"]:
    print(f"- {finding['text']}")
    for remedy in finding["remedies"]:
        print(f"    remedy: {remedy}")
