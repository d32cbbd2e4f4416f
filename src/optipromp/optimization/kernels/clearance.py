"""Kernels of body points and obstacles: distances, F_s and F_d, clearance, self-collision."""

import math

import numpy as np
from numba import njit

from optipromp.geometry.cells import cell_at
from optipromp.geometry.distances import distance_and_gradient
from optipromp.optimization.kernels.outer import add_outer


@njit(cache=True, error_model="numpy", nogil=True)
def clearance_field(  # type: ignore[no-untyped-def]
    points, radius, link_start, link_bound, link_distal, obstacles, shared, cutoff,
    distance, normal,
):  # fmt: skip
    """Distance from every body sphere's surface to the nearest obstacle, where below ``cutoff``.

    ``points`` (T, B+2+L, 3) holds the bounding-sphere centres of the L links after the spheres and
    the two tool points. Obstacles from index ``shared`` on concern only links that are not distal.
    Writes ``distance`` (T, B) and the outward ``normal`` (T, B, 3), zero where beyond the cutoff.
    """
    n_spheres = radius.shape[0]
    n_links = link_start.shape[0] - 1
    for t in range(points.shape[0]):
        for b in range(n_spheres):
            distance[t, b] = cutoff
            normal[t, b, 0] = 0.0
            normal[t, b, 1] = 0.0
            normal[t, b, 2] = 0.0
        for k in range(obstacles.kind.shape[0]):
            px, py, pz = (
                obstacles.position[k, 0],
                obstacles.position[k, 1],
                obstacles.position[k, 2],
            )
            reach = obstacles.bound[k] + cutoff
            for link in range(n_links):
                if k >= shared and link_distal[link]:
                    continue
                c = points[t, n_spheres + 2 + link]
                far = reach + link_bound[link]
                if (c[0] - px) ** 2 + (c[1] - py) ** 2 + (c[2] - pz) ** 2 >= far * far:
                    continue
                for b in range(link_start[link], link_start[link + 1]):
                    x, y, z = points[t, b, 0], points[t, b, 1], points[t, b, 2]
                    far = reach + radius[b]
                    if (x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2 >= far * far:
                        continue
                    d, nx, ny, nz = distance_and_gradient(obstacles, k, x, y, z)
                    d -= radius[b]
                    if d < distance[t, b]:
                        distance[t, b] = d
                        normal[t, b, 0] = nx
                        normal[t, b, 1] = ny
                        normal[t, b, 2] = nz


@njit(cache=True, error_model="numpy", nogil=True)
def clearance_in_cells(  # type: ignore[no-untyped-def]
    points, radius, link_start, link_distal, obstacles, shared, cutoff, distance, normal
):
    """:func:`clearance_field` where ``obstacles`` have cells: each sphere meets those of its cell.

    What it costs hardly grows with the number of obstacles. The cells' reach must be ``cutoff`` and
    the largest radius at least.
    """
    cells = obstacles.cells
    distance[:] = cutoff
    normal[:] = 0.0
    for t in range(points.shape[0]):
        for link in range(link_start.shape[0] - 1):
            stop = shared if link_distal[link] else obstacles.kind.shape[0]
            for b in range(link_start[link], link_start[link + 1]):
                x, y, z = points[t, b, 0], points[t, b, 1], points[t, b, 2]
                cell = cell_at(cells, x, y, z)
                for i in range(cells.start[cell], cells.start[cell + 1]):
                    k = cells.member[i]
                    if k >= stop:
                        break
                    dx = x - obstacles.position[k, 0]
                    dy = y - obstacles.position[k, 1]
                    dz = z - obstacles.position[k, 2]
                    far = obstacles.bound[k] + cutoff + radius[b]
                    if dx * dx + dy * dy + dz * dz >= far * far:
                        continue
                    d, nx, ny, nz = distance_and_gradient(obstacles, k, x, y, z)
                    d -= radius[b]
                    if d < distance[t, b]:
                        distance[t, b] = d
                        normal[t, b, 0] = nx
                        normal[t, b, 1] = ny
                        normal[t, b, 2] = nz


@njit(cache=True, error_model="numpy", nogil=True)
def obstacle_cost(d, epsilon):  # type: ignore[no-untyped-def]
    """The CHOMP cost c(D), and its derivative, with the safety distance ``epsilon``."""
    if d >= epsilon:
        return 0.0, 0.0
    if d >= 0.0:
        return (d - epsilon) ** 2 / (2.0 * epsilon), (d - epsilon) / epsilon
    return 0.5 * epsilon - d, -1.0


@njit(cache=True, error_model="numpy", nogil=True)
def point_speed(points, t, b, dt):  # type: ignore[no-untyped-def]
    """Speed of a point at a knot, its direction, and the two knots of the difference."""
    before, after = max(t - 1, 0), min(t + 1, points.shape[0] - 1)
    span = (after - before) * dt
    vx = (points[after, b, 0] - points[before, b, 0]) / span
    vy = (points[after, b, 1] - points[before, b, 1]) / span
    vz = (points[after, b, 2] - points[before, b, 2]) / span
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    if speed > 1e-12:
        return speed, vx / speed, vy / speed, vz / speed, before, after, span
    return 0.0, 0.0, 0.0, 0.0, before, after, span


@njit(cache=True, error_model="numpy", nogil=True)
def obstacle_functional(points, distance, normal, epsilon, dt, use_max, weight, force, stiffness):  # type: ignore[no-untyped-def]
    r"""F = ∫ max_u c(x_u) ‖dx_u/dt‖ dt (or the sum over u), by the trapezoid rule.

    The gradient is that of the discrete sum, so it agrees with finite differences at any T, and
    tends to the functional gradient as T grows. Returns F without its ``weight``.
    """
    n_knots, n_spheres = distance.shape
    total = 0.0
    for t in range(n_knots):
        w = dt * (0.5 if t == 0 or t == n_knots - 1 else 1.0)
        best, chosen = 0.0, -1
        for b in range(n_spheres):
            if distance[t, b] >= epsilon:
                continue
            c, slope = obstacle_cost(distance[t, b], epsilon)
            speed, ux, uy, uz, before, after, span = point_speed(points, t, b, dt)
            if use_max:
                if c * speed > best:
                    best, chosen = c * speed, b
                continue
            total += w * c * speed
            _obstacle_force(
                t, b, weight * w, c, slope, speed, ux, uy, uz, before, after, span, epsilon, normal,
                force, stiffness,
            )  # fmt: skip
        if chosen >= 0:
            total += w * best
            c, slope = obstacle_cost(distance[t, chosen], epsilon)
            speed, ux, uy, uz, before, after, span = point_speed(points, t, chosen, dt)
            _obstacle_force(
                t, chosen, weight * w, c, slope, speed, ux, uy, uz, before, after, span, epsilon,
                normal, force, stiffness,
            )  # fmt: skip
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def _obstacle_force(  # type: ignore[no-untyped-def]
    t,
    b,
    weight,
    c,
    slope,
    speed,
    ux,
    uy,
    uz,
    before,
    after,
    span,
    epsilon,
    normal,
    force,
    stiffness,
):
    nx, ny, nz = normal[t, b, 0], normal[t, b, 1], normal[t, b, 2]
    push = weight * slope * speed
    force[t, b, 0] += push * nx
    force[t, b, 1] += push * ny
    force[t, b, 2] += push * nz
    drag = weight * c / span
    force[after, b, 0] += drag * ux
    force[after, b, 1] += drag * uy
    force[after, b, 2] += drag * uz
    force[before, b, 0] -= drag * ux
    force[before, b, 1] -= drag * uy
    force[before, b, 2] -= drag * uz
    add_outer(stiffness[t, b], weight * speed / epsilon, nx, ny, nz)


@njit(cache=True, error_model="numpy", nogil=True)
def clearance_penalty(distance, normal, margin, chosen, weight, force, stiffness):  # type: ignore[no-untyped-def]
    """½ Σ weight·max(0, margin − D)² over the ``chosen`` (B,) spheres."""
    n_knots, n_spheres = distance.shape
    total = 0.0
    for t in range(n_knots):
        for b in range(n_spheres):
            short = margin - distance[t, b]
            if short <= 0.0 or not chosen[b]:
                continue
            total += 0.5 * weight * short * short
            nx, ny, nz = normal[t, b, 0], normal[t, b, 1], normal[t, b, 2]
            push = -weight * short
            force[t, b, 0] += push * nx
            force[t, b, 1] += push * ny
            force[t, b, 2] += push * nz
            add_outer(stiffness[t, b], weight, nx, ny, nz)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def self_penalty(points, radius, groups, pairs, link_bound, margin, weight, force, stiffness):  # type: ignore[no-untyped-def]
    """½ Σ weight·max(0, margin − D)² over the pairs of body spheres that must keep apart.

    ``groups`` (G, 4): two links and the range of their ``pairs`` (P, 2), so that a pair of links
    whose bounding spheres are apart costs one test.
    """
    n_spheres = radius.shape[0]
    total = 0.0
    for t in range(points.shape[0]):
        for g in range(groups.shape[0]):
            first, second = groups[g, 0], groups[g, 1]
            c, d = points[t, n_spheres + 2 + first], points[t, n_spheres + 2 + second]
            far = link_bound[first] + link_bound[second] + margin
            if (c[0] - d[0]) ** 2 + (c[1] - d[1]) ** 2 + (c[2] - d[2]) ** 2 >= far * far:
                continue
            last, skip = -1, False
            for p in range(groups[g, 2], groups[g, 3]):
                i, j = pairs[p, 0], pairs[p, 1]
                if i != last:  # pairs are sorted: one test for all partners of a sphere
                    last = i
                    far = radius[i] + link_bound[second] + margin
                    dx = points[t, i, 0] - d[0]
                    dy = points[t, i, 1] - d[1]
                    dz = points[t, i, 2] - d[2]
                    skip = dx * dx + dy * dy + dz * dz >= far * far
                if skip:
                    continue
                dx = points[t, i, 0] - points[t, j, 0]
                dy = points[t, i, 1] - points[t, j, 1]
                dz = points[t, i, 2] - points[t, j, 2]
                keep = radius[i] + radius[j] + margin
                squared = dx * dx + dy * dy + dz * dz
                if squared >= keep * keep:
                    continue
                apart = math.sqrt(squared)
                short = keep - apart
                total += 0.5 * weight * short * short
                if apart < 1e-9:
                    continue
                nx, ny, nz = dx / apart, dy / apart, dz / apart
                push = weight * short
                force[t, i, 0] -= push * nx
                force[t, i, 1] -= push * ny
                force[t, i, 2] -= push * nz
                force[t, j, 0] += push * nx
                force[t, j, 1] += push * ny
                force[t, j, 2] += push * nz
                add_outer(stiffness[t, i], 2.0 * weight, nx, ny, nz)
                add_outer(stiffness[t, j], 2.0 * weight, nx, ny, nz)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def self_penalties(points, radius, groups, pairs, link_bound, margin, force, stiffness):  # type: ignore[no-untyped-def]
    """Σ max(0, margin − D)² of each of the configurations (T,), as :func:`self_penalty` has it."""
    out = np.empty(points.shape[0])
    for t in range(points.shape[0]):
        out[t] = self_penalty(
            points[t : t + 1], radius, groups, pairs, link_bound, margin, 2.0, force[t : t + 1],
            stiffness[t : t + 1],
        )  # fmt: skip
    return out
