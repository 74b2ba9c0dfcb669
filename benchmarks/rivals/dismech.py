"""dismech-newton: implicit discrete elastic rods on NVIDIA's Newton and Warp, on the processor, in single precision."""

from __future__ import annotations

import warnings

import numpy as np

from benchmarks.rivals import first_edge
from benchmarks.scenes import DENSITY, GRAVITY, LENGTH, RADIUS, SHEAR, YOUNG

LABEL, PACKAGE = "dismech-newton", "dismech-newton"
SIZES = (50, 100)
SPAN = 0.5  # of the fall that is timed [s]
ITERATIONS = 3  # a fixed number per step, as many as rodnet's Newton takes; it has no tolerance


def check() -> None:
    """Import the package."""
    import warp as wp

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wp.config.log_level = wp.LOG_ERROR
        try:
            import dismech_newton
        except TypeError:
            # Its annotations write `Struct | None`, which Python evaluates before 3.14 and Warp's
            # structs do not know: let them.
            from warp._src.codegen import Struct

            Struct.__or__ = lambda self, other: self
            import dismech_newton  # noqa: F401


class Cantilever:
    """The falling cantilever."""

    def __init__(self, edges: int, dt: float | None = None, iterations: int = ITERATIONS) -> None:
        import newton
        from dismech_newton import DiSMechSolver, add_rod, fix_segment

        self.dt = dt or 0.01
        start, length = first_edge(edges, LENGTH)
        rod = newton.Rod.create_straight(
            start=(start, 0.0, 0.0), direction=(1.0, 0.0, 0.0), length=length, segment_count=edges,
            radius=RADIUS, youngs_modulus=YOUNG, shear_modulus=SHEAR,
        )  # fmt: skip
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -GRAVITY))
        cfg = newton.ModelBuilder.ShapeConfig(density=DENSITY)
        index = add_rod(builder, rod, cfg=cfg, proxies=False)
        fix_segment(builder, edge=index[0])
        model = builder.finalize(device="cpu")
        # "exact": Newton's method with a new factorisation in every iteration, as in rodnet
        self.solver = DiSMechSolver(model, iterations=iterations, exact=True, self_contact=False)
        self.now, self.next = model.state(), model.state()

    def advance(self, duration: float) -> int:
        """Run on for so long; return the number of steps."""
        count = max(1, round(duration / self.dt))
        for _ in range(count):
            self.solver.step(self.now, self.next, None, None, self.dt)
            self.now, self.next = self.next, self.now
        return count

    def tip(self) -> np.ndarray:
        """Position of the free end [m]."""
        return self.now.particle_q.numpy()[-1].astype(float)
