"""A gantry (three slides) with a cup: an instrument that goes exactly where a test wants it."""

import pytest
from tests.simulation.bench import Bench


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path)
