"""The diagnosis: what a model leaves out, where, and the proof."""
