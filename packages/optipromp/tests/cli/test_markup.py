"""Names that look like markup are printed as they are, wherever a command prints them."""

from pathlib import Path

import pytest
from tests.cli.fixtures import invoke

from optipromp.core.scenes import load_scene, save_scene
from optipromp.core.scenes.scene import Scene

NAME = "a[/bold][red]:smile:\\[x"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def named(name: str, scene: str = "scenario-3") -> Scene:
    found = load_scene(scene)
    objects = [o if o.id != "n1" else type(o)(**vars(o) | {"id": name}) for o in found.objects]
    return type(found)(**vars(found) | {"name": name, "objects": tuple(objects)})


def told(*words: str) -> str:
    done = invoke(*words)
    assert done.exit_code < 2, done.output
    assert done.exception is None or isinstance(done.exception, SystemExit)
    return done.stdout


def test_names_and_folders_that_look_like_markup(here: Path) -> None:
    name = NAME
    save_scene(named(name), here / "scene.yaml")
    out = f"o{name}"
    printed = told("plan", "scene.yaml", "--no-figures", "--details", "--out", out)
    assert printed.startswith(f"{name}  opti-promp")
    assert f"M_p {name}" in printed
    assert f" to {out}" in printed
    assert told("check", out).startswith(f"plan {out}: right")
    assert told("validate", out).startswith(f"{name}  ")
    assert f"wrote {out}/report.html" in told("report", out)
    Path("folder[/bold]").mkdir(parents=True)
    save_scene(named(name), here / "folder[/bold]" / f"{name.replace('/', '')}.yaml")
    assert name.replace("/", "") in told("plan", "folder[/bold]", "--reach", "--out", f"all{name}")
    assert told("check", "scene.yaml").startswith("scene scene.yaml: right\n")


def test_a_run_of_them(here: Path) -> None:
    pytest.importorskip("mujoco")
    name = NAME
    save_scene(named(name), here / "scene.yaml")
    printed = told("simulate", "scene.yaml", "--out", f"o{name}")
    assert printed.startswith(f"{name}  opti-promp")
    assert f"  {name} " in printed
    assert f" to o{name}" in printed
