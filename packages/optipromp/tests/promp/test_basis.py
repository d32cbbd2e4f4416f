import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from optipromp.core.errors import InvalidRequestError
from optipromp.core.promp import Basis

bases = st.builds(
    lambda inside, width, outside: Basis(inside + 2 * outside, width, outside),
    st.integers(2, 12),
    st.floats(0.5, 50.0),
    st.integers(0, 3),
)


def test_is_the_formula() -> None:
    basis = Basis(5, 4.0, 1)
    z = np.linspace(0, 1, 11)
    assert basis.centers.tolist() == [-0.5, 0.0, 0.5, 1.0, 1.5]
    raw = np.exp(-2.0 * ((z[:, None] - basis.centers) / 0.5) ** 2)
    np.testing.assert_allclose(basis.evaluate(z), raw / raw.sum(1, keepdims=True), rtol=1e-13)


@given(bases)
def test_sums_to_one_and_derivatives_to_zero(basis: Basis) -> None:
    for order, total in enumerate((1.0, 0.0, 0.0, 0.0)):
        values = basis.evaluate(17, order)
        scale = max(1.0, basis.width / basis.spacing**2) ** order
        np.testing.assert_allclose(values.sum(axis=1), total, atol=1e-12 * scale)


@given(bases, st.integers(1, 3))
def test_derivatives_are_those_of_finite_differences(basis: Basis, order: int) -> None:
    z, h = np.linspace(0.05, 0.95, 13), 1e-4 * basis.spacing / np.sqrt(basis.width)
    difference = (basis.evaluate(z + h, order - 1) - basis.evaluate(z - h, order - 1)) / (2 * h)
    scale = (basis.width**0.5 / basis.spacing) ** order
    np.testing.assert_allclose(basis.evaluate(z, order), difference, atol=1e-6 * 10 * scale)


def test_very_narrow_bases_stay_finite() -> None:
    basis = Basis(10, 1e6, 0)
    for order in range(4):
        assert np.isfinite(basis.evaluate(1001, order)).all()


@pytest.mark.parametrize(
    "arguments",
    [
        {"count": 3},
        {"count": 4.5},
        {"count": True},
        {"width": 0.0},
        {"width": float("nan")},
        {"outside": -1},
        {"count": 1, "outside": 0},
    ],
)
def test_refuses(arguments: dict[str, float]) -> None:
    with pytest.raises(InvalidRequestError):
        Basis(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("phases", [[1.1], [-0.1], [np.nan], 0, -3, True, [[0.1]], ["a"]])
def test_refuses_phases(phases: object) -> None:
    with pytest.raises(InvalidRequestError, match="phase"):
        Basis().evaluate(phases)  # type: ignore[arg-type]


def test_refuses_an_order() -> None:
    with pytest.raises(InvalidRequestError, match="order"):
        Basis().evaluate(5, 4)
