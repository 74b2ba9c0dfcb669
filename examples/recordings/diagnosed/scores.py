"""Score the plain and the repaired models on files not seen, as docs/howto/diagnosed.md shows them.

RODNET_RECORDINGS=... python examples/recordings/diagnosed/scores.py
"""

import json
import os
from pathlib import Path

import rodnet as rn

HERE = Path(__file__).parent
RECORDINGS = Path(os.environ.get("RODNET_RECORDINGS", HERE.parents[3] / "shared" / "recordings"))
# case, files, models, and where the scores are kept
FILES = [
    ("trunk.py", "trunk_decay/*[258].npz", "trunk", "trunk/scores.json"),
    ("bdlo.py", "bdlo1_mid_clamp/*.npz", "bdlo1", "bdlo1/mid_clamp.json"),
]
KEPT = "recordings", "metric", "mean_mm_5s", "mean_mm_1s", "baselines"

for case, files, model, name in FILES:
    found = {}
    for which, folder in (("plain", HERE.parent / "plain"), ("repaired", HERE)):
        told = rn.evaluate(
            HERE.parent / case, sorted(map(str, RECORDINGS.glob(files))), folder / model
        ).to_dict()
        found[which] = {k: told[k] for k in KEPT}
        found[which]["kinds"] = {kind: {k: of[k] for k in KEPT} for kind, of in told["kinds"].items()}
    (HERE / name).write_text(json.dumps(found, indent=1) + "\n")
