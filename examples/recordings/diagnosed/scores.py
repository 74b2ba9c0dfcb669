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
CABLE = "train_038*.npz", "train_04*.npz", "train_05*.npz"
BRANCHES = "train_053*.npz", "train_058*.npz", "train_064*.npz", "train_07*.npz"
FILES = [
    ("dlo.py", "dlo3", CABLE, "dlo3", "dlo3/scores.json"),
    ("dlo.py", "dlo1", CABLE, "dlo1", "dlo1/scores.json"),
    ("bdlo.py", "bdlo1", BRANCHES, "bdlo1", "bdlo1/scores.json"),
    ("trunk.py", "trunk_decay", ["*[258].npz"], "trunk", "trunk/scores.json"),
    ("bdlo.py", "bdlo1_mid_clamp", ["*.npz"], "bdlo1", "bdlo1/mid_clamp.json"),
]
MEASURES = "metric", "mean_mm_5s", "mean_mm_1s"
KEPT = "recordings", *MEASURES, "baselines"

if __name__ == "__main__":
    for case, folder, patterns, model, name in FILES:
        files = sorted(str(path) for one in patterns for path in (RECORDINGS / folder).glob(one))
        found = {}
        for which, where in (("plain", HERE.parent / "plain"), ("repaired", HERE)):
            told = rn.evaluate(HERE.parent / case, files, where / model).to_dict()
            found[which] = {k: told[k] for k in KEPT}
            found[which]["kinds"] = {kind: {k: of[k] for k in KEPT} for kind, of in told["kinds"].items()}
            found[which]["files"] = [{k: f[k] for k in ("name", "kind", *MEASURES)} for f in told["files"]]
        (HERE / name).write_text(json.dumps(found, indent=1) + "\n")
