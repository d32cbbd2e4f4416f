"""How a plant moves: a common sway, a swing of each fruit, and rest positions, as a linear model.

The state of F fruits has n = 4 K + 7 F values, K being the number of sway frequencies:
``[displacements (m,) | their velocities (m,) | rest positions (3 F,)]`` with m = 2 K + 2 F. The
first 2 K displacements are the sway (frequency by frequency, two horizontal axes each), the others
the swing of each fruit. Fruit i is at rest_i + sway + swing_i.

Each displacement is a damped oscillator that white noise drives,
x'' + 2 ζ ω x' + ω² x = w, discretised exactly: with the transition F over a time and the
stationary covariance P = diag(σ², σ² ω²), the noise is P - F P Fᵀ. What the noise of the sway adds
to the swings within a time is left out. The acceleration of the sway s
drives every swing, as that of its support drives a pendulum: y'' + 2 ζ ω y' + ω² y = w - s''.

With the dynamics R of a frequency of the sway, Y of a swing and the drive B (of -s'' on y''), the
matrix X of X R - Y X = B gives the transition from sway to swing exactly: X e^{R t} - e^{Y t} X.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frame_along


@dataclass(frozen=True, eq=False)
class Oscillators:
    """Independent damped oscillators, driven by white noise."""

    omega: FloatArray  # (m,) undamped angular frequencies [rad/s]
    zeta: FloatArray  # (m,) damping ratios, below 1
    sigma: FloatArray  # (m,) stationary standard deviations of the displacements [m]

    def transition(self, dt: FloatArray) -> tuple[FloatArray, ...]:
        """a, b, c, d: after ``dt`` [s] (broadcast against (m,)) x is a x + b v, v is c x + d v."""
        decay = self.zeta * self.omega
        damped = self.omega * np.sqrt(1.0 - self.zeta**2)
        shrunk = np.exp(-decay * dt)
        cosine, sine = shrunk * np.cos(damped * dt), shrunk * np.sin(damped * dt) / damped
        return cosine + decay * sine, sine, -(self.omega**2) * sine, cosine - decay * sine

    def noise(self, steps: tuple[FloatArray, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Variances and covariance (m,) of the noise: of x, of x with v, of v."""
        a, b, c, d = steps
        square, stiff = self.sigma**2, self.omega**2
        return (
            square * (1.0 - a**2 - b**2 * stiff),
            -square * (a * c + b * d * stiff),
            square * (stiff - c**2 - d**2 * stiff),
        )

    def some(self, rows: slice | IntArray) -> "Oscillators":
        """Those at ``rows``."""
        return Oscillators(self.omega[rows], self.zeta[rows], self.sigma[rows])

    def joined(self, other: "Oscillators") -> "Oscillators":
        """These oscillators, then ``other``."""
        return Oscillators(
            np.concatenate([self.omega, other.omega]),
            np.concatenate([self.zeta, other.zeta]),
            np.concatenate([self.sigma, other.sigma]),
        )


def coupling(sway: Oscillators, swing: Oscillators) -> FloatArray:
    """X (F, K, 2, 2) of the module, of K frequencies of the sway and F swings."""
    ws, zs, wy, zy = sway.omega, sway.zeta, swing.omega, swing.zeta
    count, bank = len(wy), len(ws)
    system = np.zeros((count, bank, 4, 4))  # of X in rows: x00, x01, x10, x11
    stiff, damp = ws**2, 2.0 * zs * ws
    own, loss = wy[:, None] ** 2, 2.0 * (zy * wy)[:, None]
    for row in (0, 1):  # (X R)[row] - (Y X)[row] = B[row]
        a, b = 2 * row, 2 * row + 1
        system[:, :, a, b] -= stiff
        system[:, :, b, a] += 1.0
        system[:, :, b, b] -= damp
    for column in (0, 1):
        system[:, :, column, 2 + column] -= 1.0
        system[:, :, 2 + column, column] += own
        system[:, :, 2 + column, 2 + column] += loss
    drive = np.zeros((count, bank, 4, 1))
    drive[:, :, 2, 0], drive[:, :, 3, 0] = stiff, damp
    return np.asarray(np.linalg.solve(system, drive).reshape(count, bank, 2, 2))


@dataclass(frozen=True, eq=False)
class Layout:
    """Where the values of a state are, and which of them make up a position."""

    bank: int  # number of sway frequencies K
    count: int  # number of fruits F
    axes: FloatArray  # (2, 3) horizontal unit vectors across each other

    @property
    def half(self) -> int:
        """Number m of displacements."""
        return 2 * (self.bank + self.count)

    @property
    def size(self) -> int:
        """Number n of values."""
        return 2 * self.half + 3 * self.count

    @cached_property
    def position(self) -> FloatArray:
        """(3 F, n) that maps a state to the positions of the fruits."""
        matrix = np.zeros((self.count, 3, self.size))
        matrix[:, :, : 2 * self.bank] = np.tile(self.axes.T, self.bank)
        for k in range(self.count):
            at = 2 * (self.bank + k)
            matrix[k, :, at : at + 2] = self.axes.T
            matrix[k, :, 2 * self.half + 3 * k :][:, :3] = np.eye(3)
        return matrix.reshape(-1, self.size)

    def rests(self, tracks: IntArray) -> IntArray:
        """Indices (3 k,) of the rest positions of ``tracks`` (k,)."""
        return (2 * self.half + 3 * tracks[:, None] + np.arange(3)).ravel()

    def of(self, tracks: IntArray) -> IntArray:
        """Indices of the sway and of all values of ``tracks`` (k,), as a layout of k has them."""
        swing = (2 * self.bank + 2 * tracks[:, None] + np.arange(2)).ravel()
        moving = np.concatenate([np.arange(2 * self.bank), swing])
        return np.concatenate([moving, self.half + moving, self.rests(tracks)])


@dataclass(frozen=True, eq=False)
class PlantState:
    """A Gaussian over the values of a layout."""

    layout: Layout  # of the values
    oscillators: Oscillators  # (m,) of the sway and of the swings
    mean: FloatArray  # (n,)
    covariance: FloatArray  # (n, n)

    def after(self, dt: float, drift: float) -> "PlantState":
        """The prediction ``dt`` [s] ahead; rests walk by ``drift`` [m/√s] an axis."""
        if dt == 0.0:
            return self
        m, moving = self.layout.half, slice(0, 2 * self.layout.half)
        steps = self.oscillators.transition(np.asarray(dt))
        whole = self._transition(steps)
        mean, new = self.mean.copy(), self.covariance.copy()
        mean[moving] = whole @ mean[moving]
        new[moving] = whole @ new[moving]
        new[:, moving] = new[:, moving] @ whole.T
        xx, xv, vv = self.oscillators.noise(steps)
        k = np.arange(m)
        new[k, k] += xx
        new[k, k + m] += xv
        new[k + m, k] += xv
        new[k + m, k + m] += vv
        rest = np.arange(2 * m, self.layout.size)
        new[rest, rest] += drift**2 * dt
        return PlantState(self.layout, self.oscillators, mean, new)

    def _transition(self, steps: tuple[FloatArray, ...]) -> FloatArray:
        """(2 m, 2 m) of displacements and velocities, of the oscillators' own ``steps``."""
        bank, m = self.layout.bank, self.layout.half
        p = m // 2  # oscillators along one axis
        a, b, c, d = (step[::2] for step in steps)
        one, k = np.zeros((2, p, 2, p)), np.arange(p)
        one[0, k, 0, k], one[0, k, 1, k], one[1, k, 0, k], one[1, k, 1, k] = a, b, c, d
        x = self.drives
        own = np.stack([np.stack([a, b], 1), np.stack([c, d], 1)], 1)  # (p, 2, 2)
        coupled = x @ own[None, :bank] - own[bank:, None] @ x
        one[:, bank:, :, :bank] = coupled.transpose(2, 0, 3, 1)
        both = np.zeros((2, p, 2, 2, p, 2))
        both[:, :, 0, :, :, 0] = both[:, :, 1, :, :, 1] = one
        return both.reshape(2 * m, 2 * m)

    @property
    def spreads(self) -> FloatArray:
        """Covariances (F, 3, 3) of the fruits' positions [m²]."""
        count, looked = self.layout.count, self.layout.position
        moved = (looked @ self.covariance).reshape(count, 3, self.layout.size)
        return np.asarray(np.einsum("kin,kjn->kij", moved, looked.reshape(moved.shape)))

    @cached_property
    def drives(self) -> FloatArray:
        """X (F, K, 2, 2), see :func:`coupling`."""
        bank, own = 2 * self.layout.bank, self.oscillators
        return coupling(own.some(slice(0, bank, 2)), own.some(slice(bank, None, 2)))

    def moves(self, ahead: FloatArray) -> FloatArray:
        """Displacements (M, F, 3) of the fruits from their rests, ``ahead`` (M,) [s] from now."""
        bank, m, axes = self.layout.bank, self.layout.half, self.layout.axes
        steps = self.oscillators.transition(ahead[:, None])
        a, b, c, d = (step[:, ::2, None] for step in steps)
        begin, rate = self.mean[:m].reshape(-1, 2), self.mean[m : 2 * m].reshape(-1, 2)
        now = np.stack([begin[:bank], rate[:bank]], 1)  # (K, 2, axes)
        sway = np.stack(
            [a[:, :bank] * now[:, 0] + b[:, :bank] * now[:, 1],
             c[:, :bank] * now[:, 0] + d[:, :bank] * now[:, 1]], 2,
        )  # fmt: skip
        x = self.drives
        led = np.einsum("fkij,kja->fia", x, now)
        free = np.stack([begin[bank:], rate[bank:]], 1) - led
        swing = a[:, bank:] * free[:, 0] + b[:, bank:] * free[:, 1]
        swing = swing + np.einsum("fkj,mkja->mfa", x[:, :, 0], sway)
        return np.asarray((swing + sway[:, :, 0].sum(axis=1)[:, None]) @ axes)

    def only(self, tracks: IntArray) -> "PlantState":
        """The state without the fruits that are not in ``tracks`` (k,)."""
        layout = Layout(self.layout.bank, len(tracks), self.layout.axes)
        kept = self.layout.of(tracks)
        fewer = self.oscillators.some(kept[: layout.half])
        return PlantState(layout, fewer, self.mean[kept], self.covariance[np.ix_(kept, kept)])

    def turned(self, swings: Oscillators) -> "PlantState":
        """The state with other frequencies of its fruits' ``swings``; amplitudes stay."""
        bank = 2 * self.layout.bank
        swings = Oscillators(swings.omega, swings.zeta, self.oscillators.sigma[bank:])
        oscillators = self.oscillators.some(slice(bank)).joined(swings)
        return PlantState(self.layout, oscillators, self.mean, self.covariance)

    def learnt(self, share: float, bounds: tuple[FloatArray, FloatArray]) -> "PlantState":
        """The state with amplitudes of sway and swings that follow what was seen.

        The variance of each oscillator moves by ``share`` towards its posterior energy,
        the mean over both axes of (x² + v² / ω²) / 2, as expectation maximisation does, and stays
        within ``bounds``, two (m,) [m²]. All swings have the mean of their energies.
        """
        bank, m = 2 * self.layout.bank, self.layout.half
        own = self.oscillators
        moments = self.mean**2 + self.covariance.diagonal()
        energy = 0.5 * (moments[:m] + moments[m : 2 * m] / own.omega**2)
        energy = np.repeat(energy.reshape(-1, 2).mean(axis=1), 2)
        if m > bank:
            energy[bank:] = energy[bank:].mean()
        variance = np.clip(own.sigma**2 + share * (energy - own.sigma**2), *bounds)
        oscillators = Oscillators(own.omega, own.zeta, np.sqrt(variance))
        return PlantState(self.layout, oscillators, self.mean, self.covariance)

    def shaken(self, size: float) -> "PlantState":
        """The state after a common displacement of about ``size`` [m] that nobody foresaw: a gust,
        which the sway holds, or a plant that was moved, which the rests hold."""
        bank, m = self.layout.bank, self.layout.half
        covariance, k = self.covariance.copy(), np.arange(2 * bank)
        covariance[k, k] += size**2 / bank
        covariance[m + k, m + k] += size**2 / bank * self.oscillators.omega[k] ** 2
        for axis in range(3):
            rest = slice(2 * m + axis, None, 3)
            covariance[rest, rest] += size**2
        return PlantState(self.layout, self.oscillators, self.mean, covariance)

    def loosened(self, tracks: IntArray, sizes: FloatArray) -> "PlantState":
        """The state after rests of ``tracks`` (k,) changed by about ``sizes`` (k,) [m]."""
        covariance = self.covariance.copy()
        rest = self.layout.rests(tracks)
        covariance[rest, rest] += np.repeat(sizes**2, 3)
        return PlantState(self.layout, self.oscillators, self.mean, covariance)

    def with_fruits(
        self, swings: Oscillators, seen: FloatArray, spread: FloatArray, known: bool = False
    ) -> "PlantState":
        """The state with B more fruits, seen at ``seen`` (B, 3) with errors ``spread`` (B, 3, 3).

        The present sway and swing are part of what was seen: rest = seen - sway - swing - error.
        ``known``: the fruits were seen at another time, when sway and swing were others: rest =
        seen - error, and the spread includes them.
        """
        old = self.layout
        layout = Layout(old.bank, old.count + len(seen), old.axes)
        kept, new = layout.of(np.arange(old.count)), np.arange(old.count, layout.count)
        mean, covariance = np.zeros(layout.size), np.zeros((layout.size, layout.size))
        mean[kept] = self.mean
        covariance[np.ix_(kept, kept)] = self.covariance
        at = (2 * old.bank + 2 * new[:, None] + np.arange(2)).ravel()
        covariance[at, at] = swings.sigma**2
        covariance[at + layout.half, at + layout.half] = (swings.sigma * swings.omega) ** 2
        rest, rows = layout.rests(new), (3 * new[:, None] + np.arange(3)).ravel()
        if not known:
            spreading = np.eye(layout.size)
            spreading[rest] = -layout.position[rows]
            spreading[rest, rest] = 0.0
            covariance = spreading @ covariance @ spreading.T
            mean = spreading @ mean
        for k in range(len(new)):
            own = rest[3 * k : 3 * k + 3]
            covariance[np.ix_(own, own)] += spread[k]
            mean[own] += seen[k]
        return PlantState(layout, self.oscillators.joined(swings), mean, covariance)

    def updated(
        self, tracks: IntArray, seen: FloatArray, noise: FloatArray, held: IntArray
    ) -> tuple["PlantState", FloatArray]:
        """The state after ``tracks`` (k,) were seen at ``seen`` (k, 3).

        Joseph's form, in one step for all tracks. The squared innovations are of each track given
        the tracks before: under the model they are independent χ² of 3 degrees of freedom.

        ``tracks``: (k,) indices of fruits. ``seen``: (k, 3) positions [m]. ``noise``: (k, 3, 3)
        covariances of their errors [m²]. ``held``: indices of fruits whose rests do not change.

        Returns: The state, and the normalised innovations squared (k,).
        """
        size, layout = 3 * len(tracks), self.layout
        rows = (3 * tracks[:, None] + np.arange(3)).ravel()
        looked = layout.position[rows]
        known = looked @ self.covariance
        errors = np.zeros((len(tracks), 3, len(tracks), 3))
        errors[np.arange(len(tracks)), :, np.arange(len(tracks))] = noise
        error = errors.reshape(size, size)
        innovation = seen.ravel() - looked @ self.mean
        lower = np.linalg.cholesky(known @ looked.T + error)
        inverse = np.linalg.inv(lower)
        white = inverse @ innovation
        gain = known.T @ (inverse.T @ inverse)
        if len(held):
            gain[layout.rests(held)] = 0.0
        kept = np.eye(layout.size) - gain @ looked
        covariance = kept @ self.covariance @ kept.T + gain @ error @ gain.T
        state = PlantState(
            layout,
            self.oscillators,
            self.mean + gain @ innovation,
            0.5 * (covariance + covariance.T),
        )
        return state, np.asarray((white.reshape(-1, 3) ** 2).sum(axis=1))


def bare_plant(
    up: FloatArray, frequencies: tuple[float, ...], damping: float, sway: float
) -> PlantState:
    """The prior of a plant without a fruit: its stationary sway.

    ``up``: (3,) upward vertical in the base frame. ``frequencies``: (K,) of the sway [Hz], each
    with an equal share of its variance. ``damping``: ratio of the sway. ``sway``: standard
    deviation of the common displacement along a horizontal axis [m].
    """
    count = len(frequencies)
    omega = np.repeat(2.0 * np.pi * np.array(frequencies), 2)
    sigma = np.full(2 * count, sway / np.sqrt(count))
    bank = Oscillators(omega, np.full(2 * count, damping), sigma)
    layout = Layout(count, 0, np.asarray(frame_along(up).T[:2]))
    variances = np.concatenate([sigma**2, (sigma * omega) ** 2])
    return PlantState(layout, bank, np.zeros(layout.size), np.diag(variances))
