"""MuJoCo's cable: rigid links with ball joints, which neither stretch nor shear; its plug-in bends them explicitly."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.rivals import first_edge
from benchmarks.scenes import DENSITY, GRAVITY, LENGTH, RADIUS, SHEAR, YOUNG

LABEL, PACKAGE = "MuJoCo cable", "mujoco"
SIZES = (50, 100)
SPAN = 0.05  # of the fall that is timed [s]: its steps all cost the same


def check() -> None:
    """Import the package and see that it still has the cable (version 4 has not)."""
    import mujoco

    if int(mujoco.__version__.split(".")[0]) >= 4:
        raise RuntimeError("version 4 has no cable any more, 3.17 has")


def stable_step(edges: int) -> float:
    """Time step somewhat below the stability limit, which torsion or bending of an edge set [s].

    Found by trial with 50 and 100 edges: at 1.2 times this step the run explodes.
    """
    link = LENGTH / edges
    torsion = link / math.sqrt(SHEAR / DENSITY)
    bending = link**2 / (RADIUS * math.sqrt(YOUNG / DENSITY))
    return 0.9 * min(torsion, bending)


class Cantilever:
    """The falling cantilever."""

    def __init__(self, edges: int, dt: float | None = None) -> None:
        import mujoco

        self._step = mujoco.mj_step
        self.dt = dt or stable_step(edges)
        start, length = first_edge(edges, LENGTH)
        self.link = length / edges
        mass = DENSITY * math.pi * RADIUS**2 * self.link
        self.model = mujoco.MjModel.from_xml_string(f"""
            <mujoco>
              <extension><plugin plugin="mujoco.elasticity.cable"/></extension>
              <option timestep="{self.dt!r}" integrator="Euler" gravity="0 0 {-GRAVITY!r}">
                <flag contact="disable" constraint="disable"/>
              </option>
              <size memory="64M"/>
              <worldbody>
                <composite type="cable" curve="s" count="{edges + 1} 1 1" size="{length!r} 0 0"
                           offset="{start!r} 0 0" initial="none">
                  <plugin plugin="mujoco.elasticity.cable">
                    <config key="bend" value="{YOUNG!r}"/><config key="twist" value="{SHEAR!r}"/>
                  </plugin>
                  <joint kind="main" damping="0" armature="0"/>
                  <geom type="capsule" size="{RADIUS!r}" mass="{mass!r}" contype="0" conaffinity="0"/>
                </composite>
              </worldbody>
            </mujoco>""")
        self.data = mujoco.MjData(self.model)

    def advance(self, duration: float) -> int:
        """Run on for so long; return the number of steps."""
        count = max(1, round(duration / self.dt))
        for _ in range(count):
            self._step(self.model, self.data)
        if self.data.time < 0.5 * count * self.dt:  # it restarts a run that explodes
            raise RuntimeError(f"MuJoCo's run became unstable at dt = {self.dt:g} s")
        return count

    def tip(self) -> np.ndarray:
        """Position of the free end [m]."""
        return self.data.xpos[-1] + self.link * self.data.xmat[-1].reshape(3, 3)[:, 0]
