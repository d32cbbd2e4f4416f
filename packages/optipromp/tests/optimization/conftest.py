"""The fixtures of the tests of optimization."""

from tests.optimization.fixtures import case as case
from tests.optimization.fixtures import cases as cases
from tests.optimization.fixtures import check_gradient as check_gradient
from tests.optimization.fixtures import panda as panda
from tests.optimization.fixtures import robots as robots
from tests.optimization.fixtures import unbanded_fixture as unbanded_fixture
