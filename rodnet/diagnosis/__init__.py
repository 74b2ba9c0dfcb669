"""The diagnosis: what a model leaves out, where, and the proof on trials it has not seen."""
