"""What a model leaves out: located, named, modelled, and shown on trials it has not seen."""
