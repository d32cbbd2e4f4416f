"""Values are checked by the annotations of their fields, also those of somebody's own class."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pytest
from annotated_types import Gt, Le, Unit
from tests.refusals import assert_refused

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.values import Array, Validated, fitted

if TYPE_CHECKING:
    from nowhere import Unknown


@dataclass(frozen=True, eq=False)
class Basket(Validated, error=InvalidSceneError, label="basket.", largest=100.0):
    depth: Annotated[float, Gt(0.0), Le(2.0), Unit("m")] = 1.0
    wait: Annotated[float | None, Gt(0.0), Unit("s or inf")] = None
    kind: Literal["round", "square"] = "round"
    weights: tuple[float, ...] | Mapping[str, float] = ()
    corners: Annotated[FloatArray, Array(None, 3, most=5.0)] | None = None
    other: Any = None


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"depth": 3.0}, "basket.depth is 3.0: must be above 0 and at most 2 [m]"),
        ({"depth": "0.5"}, "basket.depth is '0.5': must be a number, without quotes [m]"),
        ({"depth": True}, "basket.depth is True: must be a number [m]"),
        ({"depth": float("nan")}, "basket.depth is nan: must be finite [m]"),
        ({"wait": 0}, "basket.wait is 0: must be above 0 [s or inf]"),
        ({"kind": "rond"}, "kind is 'rond': valid are round, square; did you mean 'round'?"),
        ({"weights": {"a": 101.0}}, "basket.weights.a is 101.0: must be at most 100"),
        ({"corners": [[0.0, 0.0]]}, "basket.corners has shape (1, 2): must be (n, 3)"),
        ({"corners": [[0.0, 0.0, 6.0]]}, "basket.corners[0, 2] is 6.0: must be at most 5"),
    ],
)
def test_a_refusal_names_value_limit_and_unit(given: dict[str, Any], told: str) -> None:
    assert_refused(InvalidSceneError, told, Basket, **given)


def test_what_is_meant_is_taken() -> None:
    made = Basket(np.float32(0.5), float("inf"), weights=[1, np.float64(2.0)])  # type: ignore[arg-type]
    assert (made.depth, made.wait, made.weights) == (0.5, float("inf"), (1.0, 2.0))
    corners = Basket(corners=np.ones((2, 3))).corners
    assert not corners.flags.writeable


def test_a_class_of_somebody_else_is_checked_as_far_as_its_types_are_known() -> None:
    @dataclass
    class Known:
        speed: float = 0.1
        shape: "np.ndarray[Any, Any] | None" = None

    @dataclass
    class Hidden:
        thing: "Unknown | None" = None

    assert fitted(Known, {"speed": 1, "shape": np.zeros(2)})["speed"] == 1.0
    with pytest.raises(InvalidRequestError, match="speed is 'fast': must be a number"):
        fitted(Known, {"speed": "fast"})
    assert fitted(Hidden, {"thing": "anything"}) == {"thing": "anything"}
