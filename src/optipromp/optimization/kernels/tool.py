"""Kernels of the tool point and its axis: F_p, drift, funnel, corridor, steps, tilt, goal."""

import math

from numba import njit

from optipromp.optimization.kernels.outer import add_outer


@njit(cache=True, error_model="numpy", nogil=True)
def drift_penalty(  # type: ignore[no-untyped-def]
    points, tool, centers, directions, approach, windows, offset, slope, most, first, weight,
    force, stiffness,
):  # fmt: skip
    r"""½ Σ weight·max(0, min(offset_n − slope·outside, most_tn) − d_n·(fk − X_n))².

    ``outside`` is how far the height of the tool point over the pushable, along ``approach``, is
    out of the passing window [low_n, high_n]. Inside it this is the drift constraint; the slope
    lets it fade outside, so that the penalty is continuous when a knot enters the window. Knots
    before ``first`` are free, and none is asked for more than ``most`` (M, N); those from M on are
    asked for all.
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
            wanted = offset[n] - slope * outside
            tilt = 0.0 if outside == 0.0 else (slope if over > under else -slope)
            if t < most.shape[0] and most[t, n] < wanted:
                wanted, tilt = most[t, n], 0.0
            short = wanted - aside
            if short <= 0.0:
                continue
            total += 0.5 * weight * short * short
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
def corridor_penalty(  # type: ignore[no-untyped-def]
    points, tool, reference, axes, tolerance, within, first, weight, force, stiffness
):
    """½ Σ weight·max(0, |axis·(fk − reference)| − tolerance)² along each of ``axes`` (m, 3).

    Between the walls there is no force, and ``within`` of the walls' curvature.
    """
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
                add_outer(stiffness[t, tool], within * weight, ax, ay, az)
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
