"""Whether what several terms make of a spring's stiffness leaves anything of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rodnet.errors import TermError

if TYPE_CHECKING:
    from rodnet.solve.model import Model


def check_stiffness(model: Model, K: np.ndarray) -> None:
    """Refuse springs of which several terms take off more than there is: each by itself leaves something.

    Parameters
    ----------
    model : Model
        The model whose bound terms have told their parts.
    K : ndarray, shape (spring_count, 3, 3)
        Sum of these [N m].

    Raises
    ------
    TermError
        That names the terms and the node.
    """
    parts = [(b.term.name, own) for b in model.bound if (own := b.spring_stiffness(model)) is not None]
    takes = [np.diagonal(own, axis1=1, axis2=2).min(axis=1, initial=0.0) < 0.0 for _, own in parts]
    several = np.flatnonzero(np.sum(takes, axis=0) > 1) if takes else np.zeros(0, dtype=int)
    least = np.linalg.eigvalsh(K[several])[:, 0] if len(several) else np.zeros(0)
    wrong = several[least < -1e-9 * np.abs(K[several]).max(axis=(1, 2), initial=0.0)]
    if not len(wrong):
        return
    spring = int(wrong[0])
    terms = ", ".join(f"'{name}'" for (name, _), some in zip(parts, takes, strict=True) if some[spring])
    one, other = model.edges[model.edge1[spring]], model.edges[model.edge2[spring]]
    node = model.graph.node_name(int([*np.intersect1d(one, other), *one][0]))
    raise TermError(
        f"{terms} together take off more than all of the stiffness at node '{node}': each is a share of what the "
        "rod has; let one term say what both do"
    )
