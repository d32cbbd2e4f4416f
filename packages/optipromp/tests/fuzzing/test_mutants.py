"""Mutated input, a little of it; ``scripts/fuzz.py`` runs the same for as long as one likes."""

import os
import tempfile
import warnings
from pathlib import Path
from random import Random

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tests.fuzzing.changes import damaged, value
from tests.fuzzing.mutants import demonstrations, mutant, plan_folder, robot

from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidSceneError

randoms = st.randoms(use_true_random=False)
few = settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))


def run(made) -> None:
    """A typed error, a plan that failed, or a result that the judge confirms."""
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        before = Path.cwd()
        os.chdir(name)
        try:
            assert made.run(Path(name)).split()[0] in ("error", "no", "success")
        finally:
            os.chdir(before)


@pytest.mark.slow
@settings(few, max_examples=30)
@given(st.sampled_from([mutant, robot, demonstrations, plan_folder]), randoms)
def test_what_is_mutated_is_refused_or_right(make, random: Random) -> None:
    run(make(random))


@settings(few, max_examples=60)
@given(randoms, st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers(-10**6, 10**6) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
))  # fmt: skip
def test_a_document_is_read_or_refused(random: Random, document) -> None:
    content = yaml.safe_dump(document, allow_unicode=True).encode("utf-8", "replace")
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "scene.yaml"
        path.write_bytes(damaged(random, content))
        try:
            found = read_document(path, InvalidSceneError, "a scene")
        except InvalidSceneError as error:
            found = error.message
        assert found is None or isinstance(found, str | int | float | list | dict)


@settings(few, max_examples=40)
@given(randoms)
def test_plain_documents_read_as_pyyaml_reads_them(random: Random) -> None:
    """But for the words that YAML 1.2 no longer knows, which the values here have none of."""
    keep = {"a": [1, 2.5, "x", None, True], "b": {"c": "d", "e": [[], {}]}, "f": [-1e-3, "1:30"]}
    document = {f"k{k}": random.choice(list(keep.values())) for k in range(random.randrange(4))}
    document["v"] = value(Random(0)) or 0
    flow = random.choice([True, False, None])
    text = yaml.safe_dump(document, default_flow_style=flow)
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "scene.yaml"
        path.write_text(text)
        assert read_document(path, InvalidSceneError, "a scene") == yaml.safe_load(text)
