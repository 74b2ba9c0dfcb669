"""Compiled single-layer potential of Stokes flow over flat triangles.

The traction is constant on each triangle, and its integrals are exact: with r = y - x, the kernel
1/r + r r / r^3 is integrated over a triangle by way of the divergence theorem, which leaves a logarithm
for each edge and the triangle's solid angle (docs, theory: drag).
"""

import math

import numpy as np

from rodnet.compiled import kernel


@kernel
def single_layer(corners, normals, x, A):
    """Fill A (3 m, 3 n): integral of (1/r + r r / r^3) over each of n triangles, seen from m points.

    Parameters
    ----------
    corners : ndarray, shape (n, 3, 3)
        Corners of the triangles, one after another about the normal [m].
    normals : ndarray, shape (n, 3)
        Unit normals.
    x : ndarray, shape (m, 3)
        Points; they may lie inside of a triangle but not on its border [m].
    A : ndarray, shape (3 m, 3 n)
        The integrals [m].
    """
    t, m = np.empty(3), np.empty(3)
    r = np.empty((3, 3))
    distance = np.empty(3)
    along, across = np.empty(3), np.empty((3, 3))
    for j in range(corners.shape[0]):
        n = normals[j]
        for i in range(x.shape[0]):
            for k in range(3):
                for c in range(3):
                    r[k, c] = corners[j, k, c] - x[i, c]
                distance[k] = math.sqrt(r[k, 0] ** 2 + r[k, 1] ** 2 + r[k, 2] ** 2)
            height = n[0] * r[0, 0] + n[1] * r[0, 1] + n[2] * r[0, 2]
            # van Oosterom & Strackee 1983; positive where the plane is seen against its normal
            triple = (
                r[0, 0] * (r[1, 1] * r[2, 2] - r[1, 2] * r[2, 1])
                + r[0, 1] * (r[1, 2] * r[2, 0] - r[1, 0] * r[2, 2])
                + r[0, 2] * (r[1, 0] * r[2, 1] - r[1, 1] * r[2, 0])
            )
            dots = distance[0] * distance[1] * distance[2]
            for k in range(3):
                p, q = (k + 1) % 3, (k + 2) % 3
                dots += distance[k] * (r[p, 0] * r[q, 0] + r[p, 1] * r[q, 1] + r[p, 2] * r[q, 2])
            angle = 2.0 * math.atan2(triple, dots)
            inverse = -height * angle  # of 1 / r
            for c in range(3):
                along[c] = 0.0  # of r / r^3 in the plane
                for d in range(3):
                    across[c, d] = 0.0
            for k in range(3):
                p, q = k, (k + 1) % 3
                length = 0.0
                for c in range(3):
                    t[c] = r[q, c] - r[p, c]
                    length += t[c] ** 2
                length = math.sqrt(length)
                for c in range(3):
                    t[c] /= length
                m[0] = t[1] * n[2] - t[2] * n[1]
                m[1] = t[2] * n[0] - t[0] * n[2]
                m[2] = t[0] * n[1] - t[1] * n[0]
                reach = m[0] * r[p, 0] + m[1] * r[p, 1] + m[2] * r[p, 2]
                start = t[0] * r[p, 0] + t[1] * r[p, 1] + t[2] * r[p, 2]
                end = start + length
                # ln((R2 + s2) / (R1 + s1)), without cancellation
                if start + end > 0.0:
                    log = math.log((distance[q] + end) / (distance[p] + start))
                else:
                    log = math.log((distance[p] - start) / (distance[q] - end))
                inverse += reach * log
                step = distance[q] - distance[p]
                for c in range(3):
                    along[c] -= m[c] * log
                    for d in range(3):
                        across[c, d] -= m[c] * (reach * m[d] * log + t[d] * step)
            # r = rho + height n:  r r / r^3 = rho rho / r^3 + height (rho n + n rho) / r^3 + height^2 n n / r^3
            for c in range(3):
                for d in range(3):
                    value = across[c, d] + height * (along[c] * n[d] + n[c] * along[d])
                    value += (height * angle - inverse) * n[c] * n[d]
                    if c == d:
                        value += 2.0 * inverse
                    A[3 * i + c, 3 * j + d] = value
