"""The compiled forces of a consistent mass, one edge after the other."""

from rodnet.compiled import kernel


@kernel
def spread_inertia(excess, dofs, slots, acc, ca, F, data, with_jac):
    """Add the forces excess (a0 - a1) and the opposite on both ends of edges; returns the largest.

    ``dofs`` (m, 2) and ``slots`` (m, 2, 2) are those of one coordinate of both ends, ``excess`` (m,) in [kg].
    """
    largest = 0.0
    for n in range(excess.shape[0]):
        i, j, m = dofs[n, 0], dofs[n, 1], excess[n]
        force = m * (acc[i] - acc[j])
        F[i] += force
        F[j] -= force
        largest = max(largest, abs(force))
        if with_jac:
            data[slots[n, 0, 0]] -= ca * m
            data[slots[n, 1, 1]] -= ca * m
            data[slots[n, 0, 1]] += ca * m
            data[slots[n, 1, 0]] += ca * m
    return largest
