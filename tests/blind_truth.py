"""A truth of the blind benchmark, a term that names it, and the errors of a diagnosis."""

TRUTH = {
    "kind": "effect", "effects": ["jam-onset"], "right": [["jam-onset"]], "concealed": "plain",
    "truth": {"jam-onset": {"gain": 0.8, "onset": 2.0}},
}  # fmt: skip
TERM = {
    "id": "jam-onset", "status": "named", "class": ["jam-onset"], "regime": "time",
    "parameters": {
        "drag.onset": {"value": 2.1, "low": 1.95, "high": 2.3},
        "drag.gain": {"value": 0.5, "low": 0.4, "high": 0.6},
    },
}  # fmt: skip
ERRORS = {"error_before": 5.0, "error_after": 1.1, "error_floor": 1.0, "placebo_after": 3.0}
