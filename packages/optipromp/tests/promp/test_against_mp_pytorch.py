"""The independent library `mp_pytorch` (extra `peers`), which has no conditioning."""

import numpy as np
import pytest

from optipromp.core.promp import Basis, ProMP

INSIDE, N, STEPS, DURATION = 6, 3, 41, 2.0


@pytest.mark.parametrize("outside", [0, 1, 2])
@pytest.mark.parametrize("width", [2, 4, 5])
def test_the_same_weights_give_the_same_distribution(outside: int, width: int) -> None:
    """Mean and standard deviation of the positions, to 1e-10."""
    torch = pytest.importorskip("torch", reason="torch not installed")  # takes seconds
    library = pytest.importorskip("mp_pytorch.mp", reason="mp_pytorch not installed")
    count = INSIDE + 2 * outside
    rng = np.random.default_rng(outside)
    factor = np.tril(rng.normal(size=(N * count, N * count)))
    factor[np.diag_indices_from(factor)] = 1.0 + rng.random(N * count)
    ours = ProMP(Basis(count, width, outside), rng.normal(size=(N, count)), factor @ factor.T)
    theirs = library.MPFactory.init_mp(
        "promp",
        {"num_basis": count, "basis_bandwidth_factor": width, "num_basis_outside": outside},
        num_dof=N, tau=DURATION, dtype=torch.float64,
    )  # fmt: skip
    times = torch.linspace(0.0, DURATION, STEPS, dtype=torch.float64)
    theirs.update_inputs(
        times=times, params=torch.tensor(ours.weights), params_L=torch.tensor(factor)
    )

    theirs.get_traj_pos_cov(reg=0.0)  # kept for what follows, which adds to the variance else
    for mine, other in (
        (ours.mean_trajectory(STEPS), theirs.get_traj_pos()),
        (ours.standard_deviation(STEPS), theirs.get_traj_pos_std()),
    ):
        np.testing.assert_allclose(mine, other.numpy(), rtol=1e-10, atol=1e-10)
