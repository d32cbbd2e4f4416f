"""The fixtures of the tests of planning."""

from tests.planning.fixtures import bare as bare
from tests.planning.fixtures import compiled as compiled
from tests.planning.fixtures import four as four
from tests.planning.fixtures import moved_fixture as moved_fixture
from tests.planning.fixtures import noisy_fixture as noisy_fixture
from tests.planning.fixtures import obstructed as obstructed
from tests.planning.fixtures import planned as planned
from tests.planning.fixtures import recorded as recorded
from tests.planning.fixtures import three as three
