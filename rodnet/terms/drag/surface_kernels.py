"""Compiled single-layer potential of Stokes flow over flat triangles.

The traction is constant on each triangle, and its integrals are exact: with r = y - x, the kernel
1/r + r r / r^3 is integrated over a triangle by way of the divergence theorem, which leaves a logarithm
for each edge and the triangle's solid angle (docs, theory: drag). The average over a second triangle is
taken by a rule of three points on parts of it that are small beside their distance from the edges of the first,
where alone the potential is not smooth.
"""

import math

import numpy as np

from rodnet.compiled import kernel

SMOOTH = 1.0  # sides of a part, in distances from the edges of the other triangle
DEPTH = 16  # halvings of a triangle at most


@kernel
def potential(r, distance, n, out):
    """Integral of 1/r + r r / r^3 over a triangle.

    Parameters
    ----------
    r : ndarray, shape (3, 3)
        Its corners as seen from the point, one after another about the normal [m].
    distance : ndarray, shape (3,)
        Their distances [m].
    n : ndarray, shape (3,)
        Its unit normal.
    out : ndarray, shape (3, 3)
        The integral [m].
    """
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
    a0 = a1 = a2 = 0.0  # of r / r^3 in the plane
    out[:] = 0.0
    for k in range(3):
        p, q = k, (k + 1) % 3
        t0, t1, t2 = r[q, 0] - r[p, 0], r[q, 1] - r[p, 1], r[q, 2] - r[p, 2]
        length = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        t0, t1, t2 = t0 / length, t1 / length, t2 / length
        m0, m1, m2 = t1 * n[2] - t2 * n[1], t2 * n[0] - t0 * n[2], t0 * n[1] - t1 * n[0]
        reach = m0 * r[p, 0] + m1 * r[p, 1] + m2 * r[p, 2]
        start = t0 * r[p, 0] + t1 * r[p, 1] + t2 * r[p, 2]
        end = start + length
        # ln((R2 + s2) / (R1 + s1)), without cancellation
        if start >= 0.0:
            log = math.log((distance[q] + end) / (distance[p] + start))
        elif end <= 0.0:
            log = math.log((distance[p] - start) / (distance[q] - end))
        else:
            off = max(reach * reach + height * height, 1e-300)
            log = math.log((distance[q] + end) * (distance[p] - start) / off)
        inverse += reach * log
        step = distance[q] - distance[p]
        a0, a1, a2 = a0 - m0 * log, a1 - m1 * log, a2 - m2 * log
        v0, v1, v2 = reach * m0 * log + t0 * step, reach * m1 * log + t1 * step, reach * m2 * log + t2 * step
        for d, v in enumerate((v0, v1, v2)):
            out[0, d] -= m0 * v
            out[1, d] -= m1 * v
            out[2, d] -= m2 * v
    # r = rho + height n:  r r / r^3 = rho rho / r^3 + height (rho n + n rho) / r^3 + height^2 n n / r^3
    across = height * angle - inverse
    for c, a in enumerate((a0, a1, a2)):
        for d, b in enumerate((a0, a1, a2)):
            out[c, d] += height * (a * n[d] + n[c] * b) + across * n[c] * n[d]
        out[c, c] += 2.0 * inverse


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
    r, distance, out = np.empty((3, 3)), np.empty(3), np.empty((3, 3))
    for j in range(corners.shape[0]):
        for i in range(x.shape[0]):
            _see(corners[j], x[i, 0], x[i, 1], x[i, 2], r, distance)
            potential(r, distance, normals[j], out)
            A[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = out


@kernel
def _see(corners, x, y, z, r, distance):
    for k in range(3):
        r[k, 0], r[k, 1], r[k, 2] = corners[k, 0] - x, corners[k, 1] - y, corners[k, 2] - z
        distance[k] = math.sqrt(r[k, 0] ** 2 + r[k, 1] ** 2 + r[k, 2] ** 2)


@kernel
def _side_to_halve(part, corners):
    """Side of a part of a triangle along which the potential of another one varies most; -1 if it is smooth.

    Next to an edge a potential varies across it with the distance from it, and along it with that
    from its ends.
    """
    worst, side = SMOOTH * SMOOTH, -1
    x = (part[0, 0] + part[1, 0] + part[2, 0]) / 3.0
    y = (part[0, 1] + part[1, 1] + part[2, 1]) / 3.0
    z = (part[0, 2] + part[1, 2] + part[2, 2]) / 3.0
    for k in range(3):
        p, q = corners[k], corners[(k + 1) % 3]
        t0, t1, t2 = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        length = math.sqrt(t0 * t0 + t1 * t1 + t2 * t2)
        t0, t1, t2 = t0 / length, t1 / length, t2 / length
        w0, w1, w2 = x - p[0], y - p[1], z - p[2]
        s = w0 * t0 + w1 * t1 + w2 * t2
        square = w0 * w0 + w1 * w1 + w2 * w2
        beyond = max(-s, s - length, 0.0)
        off = max(square - s * s, 0.0)
        near = off + beyond * beyond + 1e-300
        end = off + min(s * s, (s - length) ** 2) + 1e-300
        for i in range(3):
            a, b = part[i], part[(i + 1) % 3]
            u0, u1, u2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
            along = u0 * t0 + u1 * t1 + u2 * t2
            across = max(u0 * u0 + u1 * u1 + u2 * u2 - along * along, 0.0)
            rough = across / near + along * along / end
            if rough > worst:
                worst, side = rough, i
    return side


@kernel
def averaged_layer(corners, normals, areas, A):
    """Fill A (3 n, 3 n): integral of (1/r + r r / r^3) over each of n triangles, integrated over each of them.

    Parameters
    ----------
    corners : ndarray, shape (n, 3, 3)
        Corners of the triangles, one after another about the normal [m].
    normals : ndarray, shape (n, 3)
        Unit normals.
    areas : ndarray, shape (n,)
        Areas [m^2].
    A : ndarray, shape (3 n, 3 n)
        The integrals [m^3].
    """
    n = corners.shape[0]
    middle, radius = np.empty((n, 3)), np.empty(n)
    for i in range(n):
        radius[i] = 0.0
        for c in range(3):
            middle[i, c] = (corners[i, 0, c] + corners[i, 1, c] + corners[i, 2, c]) / 3.0
        for k in range(3):
            square = 0.0
            for c in range(3):
                square += (corners[i, k, c] - middle[i, c]) ** 2
            radius[i] = max(radius[i], math.sqrt(square))
    parts, depth = np.empty((DEPTH + 2, 3, 3)), np.empty(DEPTH + 2, np.int64)
    part = np.empty((3, 3))
    r, distance, out, block = np.empty((3, 3)), np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for i in range(n):
        for j in range(i + 1):
            outer, inner = (i, j) if radius[i] <= radius[j] else (j, i)
            gap = 0.0
            for c in range(3):
                gap += (middle[i, c] - middle[j, c]) ** 2
            far = math.sqrt(gap) > radius[inner] + 2.0 * radius[outer] / SMOOTH
            block[:] = 0.0
            parts[0] = corners[outer]
            depth[0] = 0
            count = 1
            while count > 0:
                count -= 1
                part[:] = parts[count]
                level = depth[count]
                side = -1 if far or level == DEPTH else _side_to_halve(part, corners[inner])
                if side >= 0:
                    p, q = side, (side + 1) % 3
                    for c in range(3):
                        half = 0.5 * (part[p, c] + part[q, c])
                        for k in range(3):
                            parts[count, k, c] = half if k == p else part[k, c]
                            parts[count + 1, k, c] = half if k == q else part[k, c]
                    depth[count] = depth[count + 1] = level + 1
                    count += 2
                    continue
                weight = areas[outer] / (3.0 * 2.0**level)
                for k in range(3):
                    p, q = (k + 1) % 3, (k + 2) % 3
                    x = (4.0 * part[k, 0] + part[p, 0] + part[q, 0]) / 6.0
                    y = (4.0 * part[k, 1] + part[p, 1] + part[q, 1]) / 6.0
                    z = (4.0 * part[k, 2] + part[p, 2] + part[q, 2]) / 6.0
                    _see(corners[inner], x, y, z, r, distance)
                    potential(r, distance, normals[inner], out)
                    for c in range(3):
                        for d in range(3):
                            block[c, d] += weight * out[c, d]
            A[3 * i : 3 * i + 3, 3 * j : 3 * j + 3] = block
            A[3 * j : 3 * j + 3, 3 * i : 3 * i + 3] = block
