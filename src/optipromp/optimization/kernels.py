r"""Kernels of the planning loop: distances, functionals and penalties over all knots.

Everything that happens in the workspace happens at *points*: the B body spheres, the tool point and
a second point on the tool axis (the tip). A kernel reads point positions, adds the gradient of its
value with respect to them to ``force`` (T, B+2, 3), and a positive semi-definite curvature to
``stiffness`` (T, B+2, 6), stored as xx, yy, zz, xy, xz, yz; that of the tip is with respect to its
place about the tool point, where a term of the tool's axis lives. One pass pulls both back
to the joints:
the forces by :func:`optipromp.robots.kernels.pull_back`, the stiffnesses by :func:`add_stiffness`.
"""

import math

import numpy as np
from numba import njit

from optipromp.geometry.distances import signed_distance
from optipromp.robots.kernels import PRISMATIC


@njit(cache=True, error_model="numpy", nogil=True)
def add_outer(stiffness, weight, x, y, z):  # type: ignore[no-untyped-def]
    """Add ``weight`` times the outer product of (x, y, z) to a symmetric matrix of six numbers."""
    stiffness[0] += weight * x * x
    stiffness[1] += weight * y * y
    stiffness[2] += weight * z * z
    stiffness[3] += weight * x * y
    stiffness[4] += weight * x * z
    stiffness[5] += weight * y * z


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
    gradient = np.empty(3)
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
                    d = signed_distance(obstacles, k, x, y, z, gradient) - radius[b]
                    if d < distance[t, b]:
                        distance[t, b] = d
                        normal[t, b, 0] = gradient[0]
                        normal[t, b, 1] = gradient[1]
                        normal[t, b, 2] = gradient[2]


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
def clearance_penalty(distance, normal, margin, weight, force, stiffness):  # type: ignore[no-untyped-def]
    """½ Σ weight·max(0, margin − D)²; ``margin`` and ``weight`` (B,) per sphere."""
    n_knots, n_spheres = distance.shape
    total = 0.0
    for b in range(n_spheres):
        if weight[b] == 0.0:
            continue
        for t in range(n_knots):
            short = margin[b] - distance[t, b]
            if short <= 0.0:
                continue
            total += 0.5 * weight[b] * short * short
            nx, ny, nz = normal[t, b, 0], normal[t, b, 1], normal[t, b, 2]
            push = -weight[b] * short
            force[t, b, 0] += push * nx
            force[t, b, 1] += push * ny
            force[t, b, 2] += push * nz
            add_outer(stiffness[t, b], weight[b], nx, ny, nz)
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
def drift_penalty(  # type: ignore[no-untyped-def]
    points, tool, centers, directions, approach, windows, offset, slope, first, weight,
    force, stiffness,
):  # fmt: skip
    r"""½ Σ weight·max(0, offset_n − slope·(z outside [low_n, high_n]) − d_n·(fk − X_n))².

    ``z`` is the height of the tool point over the pushable along ``approach``. Inside the passing
    window low_n ≤ z ≤ high_n this is the drift constraint; the slope lets it fade outside, so that
    the penalty is continuous when a knot enters the window. Knots before ``first`` are free.
    """
    total = 0.0
    for n in range(centers.shape[0]):
        for t in range(first, points.shape[0]):
            x = points[t, tool, 0] - centers[n, 0]
            y = points[t, tool, 1] - centers[n, 1]
            z = points[t, tool, 2] - centers[n, 2]
            height = x * approach[0] + y * approach[1] + z * approach[2]
            over, under = height - windows[n, 1], windows[n, 0] - height
            outside = max(0.0, over, under)
            aside = x * directions[n, 0] + y * directions[n, 1] + z * directions[n, 2]
            short = offset[n] - slope * outside - aside
            if short <= 0.0:
                continue
            total += 0.5 * weight * short * short
            tilt = 0.0 if outside == 0.0 else (slope if over > under else -slope)
            nx = directions[n, 0] + tilt * approach[0]
            ny = directions[n, 1] + tilt * approach[1]
            nz = directions[n, 2] + tilt * approach[2]
            push = -weight * short
            force[t, tool, 0] += push * nx
            force[t, tool, 1] += push * ny
            force[t, tool, 2] += push * nz
            add_outer(stiffness[t, tool], weight, nx, ny, nz)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def funnel_penalty(  # type: ignore[no-untyped-def]
    points, tool, goal, approach, below, width, slope, widest, first, weight, force, stiffness
):
    r"""½ Σ weight·max(0, ρ − min(width + slope·max(0, −z − below), widest))².

    ρ is the tool point's distance from the approach line through ``goal`` and z its height over it:
    ``below`` the goal the funnel opens, up to ``widest``.
    """
    total = 0.0
    for t in range(first, points.shape[0]):
        x = points[t, tool, 0] - goal[0]
        y = points[t, tool, 1] - goal[1]
        z = points[t, tool, 2] - goal[2]
        height = x * approach[0] + y * approach[1] + z * approach[2]
        x -= height * approach[0]
        y -= height * approach[1]
        z -= height * approach[2]
        away = math.sqrt(x * x + y * y + z * z)
        opened = width + slope * max(0.0, -height - below)
        tilt = slope if -height > below else 0.0
        if opened > widest:
            opened, tilt = widest, 0.0
        over = away - opened
        if over <= 0.0 or away < 1e-12:
            continue
        total += 0.5 * weight * over * over
        nx = x / away + tilt * approach[0]
        ny = y / away + tilt * approach[1]
        nz = z / away + tilt * approach[2]
        force[t, tool, 0] += weight * over * nx
        force[t, tool, 1] += weight * over * ny
        force[t, tool, 2] += weight * over * nz
        add_outer(stiffness[t, tool], weight, nx, ny, nz)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def corridor_penalty(points, tool, reference, axes, tolerance, first, weight, force, stiffness):  # type: ignore[no-untyped-def]
    """½ Σ weight·max(0, |axis·(fk − reference)| − tolerance)² along each of ``axes`` (m, 3)."""
    total = 0.0
    for t in range(first, points.shape[0]):
        for a in range(axes.shape[0]):
            ax, ay, az = axes[a, 0], axes[a, 1], axes[a, 2]
            off = (
                ax * (points[t, tool, 0] - reference[t, 0])
                + ay * (points[t, tool, 1] - reference[t, 1])
                + az * (points[t, tool, 2] - reference[t, 2])
            )
            over = abs(off) - tolerance
            if over <= 0.0:
                continue
            total += 0.5 * weight * over * over
            push = math.copysign(weight * over, off)
            force[t, tool, 0] += push * ax
            force[t, tool, 1] += push * ay
            force[t, tool, 2] += push * az
            add_outer(stiffness[t, tool], weight, ax, ay, az)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def tool_step_penalty(points, tool, largest, first, weight, force, stiffness):  # type: ignore[no-untyped-def]
    """½ Σ weight·max(0, ‖fk(ξ_{t+1}) − fk(ξ_t)‖ − largest)² over the knots from ``first`` on."""
    total = 0.0
    for t in range(first, points.shape[0] - 1):
        x = points[t + 1, tool, 0] - points[t, tool, 0]
        y = points[t + 1, tool, 1] - points[t, tool, 1]
        z = points[t + 1, tool, 2] - points[t, tool, 2]
        step = math.sqrt(x * x + y * y + z * z)
        over = step - largest
        if over <= 0.0:
            continue
        total += 0.5 * weight * over * over
        nx, ny, nz = x / step, y / step, z / step
        push = weight * over
        for u, sign in ((t, -1.0), (t + 1, 1.0)):
            force[u, tool, 0] += sign * push * nx
            force[u, tool, 1] += sign * push * ny
            force[u, tool, 2] += sign * push * nz
            add_outer(stiffness[u, tool], 2.0 * weight, nx, ny, nz)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def axis_penalty(points, tool, lever, axis, tolerance, first, weight, force, stiffness):  # type: ignore[no-untyped-def]
    """½ Σ weight·max(0, ‖a − axis‖ − tolerance)², a the tool axis; both are unit vectors."""
    total = 0.0
    for t in range(first, points.shape[0]):
        ex = (points[t, tool + 1, 0] - points[t, tool, 0]) / lever - axis[0]
        ey = (points[t, tool + 1, 1] - points[t, tool, 1]) / lever - axis[1]
        ez = (points[t, tool + 1, 2] - points[t, tool, 2]) / lever - axis[2]
        off = math.sqrt(ex * ex + ey * ey + ez * ez)
        over = off - tolerance
        if over <= 0.0:
            continue
        total += 0.5 * weight * over * over
        if off < 1e-12:
            continue
        k = weight * over / (off * lever)
        force[t, tool + 1, 0] += k * ex
        force[t, tool + 1, 1] += k * ey
        force[t, tool + 1, 2] += k * ez
        force[t, tool, 0] -= k * ex
        force[t, tool, 1] -= k * ey
        force[t, tool, 2] -= k * ez
        add_outer(stiffness[t, tool + 1], weight / lever**2, ex / off, ey / off, ez / off)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def goal_penalty(points, tool, position, axis, lever, weight, axis_weight, force, stiffness):  # type: ignore[no-untyped-def]
    """½ weight·‖fk − position‖² + ½ axis_weight·‖a − axis‖² at the last knot.

    Written for the tool point and the tip, so that both residuals are linear in point positions.
    """
    t = points.shape[0] - 1
    total = 0.0
    for i in range(3):
        e = points[t, tool, i] - position[i]
        total += 0.5 * weight * e * e
        force[t, tool, i] += weight * e
        stiffness[t, tool, i] += weight
        if axis_weight > 0.0:
            k = axis_weight / (lever * lever)
            f = points[t, tool + 1, i] - points[t, tool, i] - lever * axis[i]
            total += 0.5 * k * f * f
            force[t, tool + 1, i] += k * f
            force[t, tool, i] -= k * f
            stiffness[t, tool + 1, i] += k
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def push_quadratic(points, tool, goal, frame, axis_weights, dt, first, weight, force, stiffness):  # type: ignore[no-untyped-def]
    """F_p = ∫_{t1}^{T} Σ_a w_a (frame_a·(fk − X_g))² dt by the trapezoid rule."""
    total = 0.0
    n_knots = points.shape[0]
    for t in range(first, n_knots):
        w = dt * (0.5 if t == first or t == n_knots - 1 else 1.0)
        for a in range(3):
            if axis_weights[a] == 0.0:
                continue
            fx, fy, fz = frame[a, 0], frame[a, 1], frame[a, 2]
            off = (
                fx * (points[t, tool, 0] - goal[0])
                + fy * (points[t, tool, 1] - goal[1])
                + fz * (points[t, tool, 2] - goal[2])
            )
            total += w * axis_weights[a] * off * off
            push = 2.0 * weight * w * axis_weights[a]
            force[t, tool, 0] += push * off * fx
            force[t, tool, 1] += push * off * fy
            force[t, tool, 2] += push * off * fz
            add_outer(stiffness[t, tool], push, fx, fy, fz)
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def push_reciprocal(points, tool, goal, lateral, softening, first, weight, force):  # type: ignore[no-untyped-def]
    """The authors' Σ_t 1/|y_g·(fk − X_g)|, finite near zero: Σ_t (y² + softening²)^(-1/2).

    The last knot is left out: it is at the target, where the term is without bound and without use.
    """
    total = 0.0
    for t in range(first, points.shape[0] - 1):
        y = (
            lateral[0] * (points[t, tool, 0] - goal[0])
            + lateral[1] * (points[t, tool, 1] - goal[1])
            + lateral[2] * (points[t, tool, 2] - goal[2])
        )
        value = 1.0 / math.sqrt(y * y + softening * softening)
        total += value
        push = -weight * y * value**3
        force[t, tool, 0] += push * lateral[0]
        force[t, tool, 1] += push * lateral[1]
        force[t, tool, 2] += push * lateral[2]
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def limit_penalty(q, lower, upper, weight, gradient, band):  # type: ignore[no-untyped-def]
    """½ Σ weight·(excess over the joint limits)²."""
    total = 0.0
    for t in range(q.shape[0]):
        for j in range(q.shape[1]):
            over = 0.0
            if q[t, j] > upper[j]:
                over = q[t, j] - upper[j]
            elif q[t, j] < lower[j]:
                over = q[t, j] - lower[j]
            if over != 0.0:
                total += 0.5 * weight * over * over
                gradient[t, j] += weight * over
                band[t, 0, j] += weight
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def step_penalty(q, largest, weight, gradient, band):  # type: ignore[no-untyped-def]
    """½ Σ weight·max(0, |q_{t+1} − q_t| − largest)², ``largest`` (n,) [rad or m]."""
    total = 0.0
    for t in range(q.shape[0] - 1):
        for j in range(q.shape[1]):
            step = q[t + 1, j] - q[t, j]
            over = abs(step) - largest[j]
            if over <= 0.0:
                continue
            total += 0.5 * weight * over * over
            push = math.copysign(weight * over, step)
            gradient[t + 1, j] += push
            gradient[t, j] -= push
            band[t, 0, j] += weight
            band[t + 1, 0, j] += weight
            band[t, 1, j] -= weight
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def velocity_functional(q, dt, weight, gradient, band):  # type: ignore[no-untyped-def]
    """F_v = ∫ ξ̇ᵀ ξ̇ dt with the velocity of each interval."""
    total = 0.0
    for t in range(q.shape[0] - 1):
        for j in range(q.shape[1]):
            step = q[t + 1, j] - q[t, j]
            total += step * step / dt
            push = 2.0 * weight * step / dt
            gradient[t + 1, j] += push
            gradient[t, j] -= push
            k = 2.0 * weight / dt
            band[t, 0, j] += k
            band[t + 1, 0, j] += k
            band[t, 1, j] -= k
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def smoothness(q, dt, weight, gradient, band):  # type: ignore[no-untyped-def]
    """½ ∫ ‖ξ̈‖² dt, the trajectory at rest before its first and after its last knot."""
    n_knots, n = q.shape
    total = 0.0
    k = weight / dt**3
    for t in range(n_knots):
        before, after = max(t - 1, 0), min(t + 1, n_knots - 1)
        ends = before == t or after == t
        for j in range(n):
            e = q[before, j] - 2.0 * q[t, j] + q[after, j]
            total += 0.5 * e * e / dt**3
            gradient[before, j] += k * e
            gradient[t, j] -= 2.0 * k * e
            gradient[after, j] += k * e
            if ends:
                low = min(before, t)
                band[low, 0, j] += k
                if after == t:
                    band[t, 0, j] += k
                else:
                    band[after, 0, j] += k
                band[low, 1, j] -= k
            else:
                band[before, 0, j] += k
                band[t, 0, j] += 4.0 * k
                band[after, 0, j] += k
                band[before, 1, j] -= 2.0 * k
                band[t, 1, j] -= 2.0 * k
                band[before, 2, j] += k
    return total


@njit(cache=True, error_model="numpy", nogil=True)
def add_stiffness(kin, segment, points, stiffness, origins, axes, band, first, out):  # type: ignore[no-untyped-def]
    r"""The banded Gauss-Newton matrix :math:`\sum_b J_b^\top C_b J_b` plus the joint-space bands.

    The point stiffnesses of each segment are gathered as 6×6 spatial stiffnesses about the world
    origin and summed down the chain, as forces are; then
    :math:`H_{ij} = s_i^\top K_{\max(i,j)} s_j` with the joints' twists s. ``out``
    ((bandwidth+1), N) is LAPACK's lower banded form for the knots ``first`` … ``first + N/n − 1``;
    ``band`` (T, 3, n) couples a knot with itself, the next and the one after.
    """
    n = band.shape[2]
    n_segments = kin.kind.shape[0]
    n_points = stiffness.shape[1]
    spatial = np.empty((n_segments, 6, 6))
    twist = np.empty((n_segments, 6))
    used = np.empty(n_segments, dtype=np.bool_)
    block = np.empty((n, n))
    kt = np.empty(6)
    count = out.shape[1] // n
    out[:] = 0.0
    for u in range(count):
        t = first + u
        used[:] = False
        for b in range(n_points):
            s = segment[b]
            c = stiffness[t, b]
            if s < 0 or (c[0] == 0.0 and c[1] == 0.0 and c[2] == 0.0):
                continue
            if not used[s]:
                spatial[s, :, :] = 0.0
                used[s] = True
            x, y, z = points[t, b, 0], points[t, b, 1], points[t, b, 2]
            if b == n_points - 1:  # the tip moves about the tool point: rotation only
                x -= points[t, b - 1, 0]
                y -= points[t, b - 1, 1]
                z -= points[t, b - 1, 2]
            k = spatial[s]
            c00, c11, c22, c01, c02, c12 = c[0], c[1], c[2], c[3], c[4], c[5]
            # M = C·(−[x]×): velocity of the point is v − x × ω
            m00, m01, m02 = -c01 * z + c02 * y, c00 * z - c02 * x, -c00 * y + c01 * x
            m10, m11, m12 = -c11 * z + c12 * y, c01 * z - c12 * x, -c01 * y + c11 * x
            m20, m21, m22 = -c12 * z + c22 * y, c02 * z - c22 * x, -c02 * y + c12 * x
            if b < n_points - 1:
                k[0, 0] += c00
                k[0, 1] += c01
                k[0, 2] += c02
                k[1, 1] += c11
                k[1, 2] += c12
                k[2, 2] += c22
                k[0, 3] += m00
                k[0, 4] += m01
                k[0, 5] += m02
                k[1, 3] += m10
                k[1, 4] += m11
                k[1, 5] += m12
                k[2, 3] += m20
                k[2, 4] += m21
                k[2, 5] += m22
            # (−[x]×)ᵀ M = [x]× M
            k[3, 3] += -z * m10 + y * m20
            k[3, 4] += -z * m11 + y * m21
            k[3, 5] += -z * m12 + y * m22
            k[4, 4] += z * m01 - x * m21
            k[4, 5] += z * m02 - x * m22
            k[5, 5] += -y * m02 + x * m12
        last = -1
        for s in range(n_segments - 1, -1, -1):
            if used[s]:
                last = s
                break
        block[:] = 0.0
        if last >= 0:
            for s in range(last + 1):
                a, o = axes[t, s], origins[t, s]
                g = kin.multiplier[s]
                if kin.kind[s] == PRISMATIC:
                    twist[s, 0], twist[s, 1], twist[s, 2] = g * a[0], g * a[1], g * a[2]
                    twist[s, 3], twist[s, 4], twist[s, 5] = 0.0, 0.0, 0.0
                else:
                    twist[s, 0] = g * (o[1] * a[2] - o[2] * a[1])
                    twist[s, 1] = g * (o[2] * a[0] - o[0] * a[2])
                    twist[s, 2] = g * (o[0] * a[1] - o[1] * a[0])
                    twist[s, 3], twist[s, 4], twist[s, 5] = g * a[0], g * a[1], g * a[2]
            for s in range(last, -1, -1):
                k = spatial[s]
                if not used[s]:
                    k[:, :] = 0.0
                if s < last:
                    up = spatial[s + 1]
                    for i in range(6):
                        for j in range(i, 6):
                            k[i, j] += up[i, j]
                for i in range(6):
                    v = 0.0
                    for j in range(6):
                        v += (k[i, j] if i <= j else k[j, i]) * twist[s, j]
                    kt[i] = v
                for p in range(s + 1):
                    v = 0.0
                    for i in range(6):
                        v += twist[p, i] * kt[i]
                    i, j = kin.dof[p], kin.dof[s]
                    block[i, j] += v
                    if p != s:
                        block[j, i] += v
        for j in range(n):
            column = u * n + j
            for i in range(j, n):
                out[i - j, column] += block[i, j]
            out[0, column] += band[t, 0, j]
            if u + 1 < count:
                out[n, column] += band[t, 1, j]
            if u + 2 < count:
                out[2 * n, column] += band[t, 2, j]
