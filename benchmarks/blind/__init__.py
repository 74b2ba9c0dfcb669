"""The blind benchmark: recordings by foreign code that hold one effect more than the model, and what comes of them."""
