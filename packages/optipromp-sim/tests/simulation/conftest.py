"""A gantry (three slides) with a cup: an instrument that goes exactly where a test wants it."""

import pytest
from tests.simulation.bench import Bench

from optipromp.core.errors import InvalidRequestError
from optipromp_sim.simulation.engine import engine

try:
    engine()  # before anything else imports MuJoCo, so that it draws off screen
except InvalidRequestError as error:
    pytest.skip(error.message, allow_module_level=True)


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)
