"""Scenes to and from files."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

import yaml

from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.files import is_there, write_atomically
from optipromp.core.scenes.reading import scene_from_dict
from optipromp.core.scenes.scene import Scene
from optipromp.core.scenes.values import suggest
from optipromp.core.scenes.writing import scene_to_dict

__all__ = ["load_scene", "save_scene", "scene_from_dict", "scene_names", "scene_to_dict"]

_SUFFIXES = (".yaml", ".yml", ".json")


def scene_names() -> tuple[str, ...]:
    """Names of the built-in scenes."""
    folder = resources.files("optipromp.core.scenes") / "data"
    return tuple(sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".yaml")))


def load_scene(name_or_path: str | Path) -> Scene:
    """Load a built-in scene by name, or a scene file (YAML, or JSON by its suffix).

    Paths inside the file are relative to its folder. Lengths are metres unless the file states a
    ``scale``, which multiplies every length in it, but not joint values, nor mesh files, which have
    a scale of their own.

    Raises:
        InvalidSceneError: the scene cannot be used; names the file, the field and the value.
        InvalidRequestError: ``name_or_path`` is neither a name nor a path.
    """
    value: object = name_or_path
    if not isinstance(value, str | Path):
        kind = type(value).__name__
        raise InvalidRequestError(f"a scene is given as {kind}: must be a name or a path")
    name = str(name_or_path)
    if isinstance(name_or_path, str) and name in scene_names():
        built_in = resources.files("optipromp.core.scenes") / "data" / f"{name}.yaml"
        with resources.as_file(built_in) as path:
            return scene_from_dict(_read(path), source=f"{name}.yaml")
    path = Path(name_or_path)
    if path.suffix not in _SUFFIXES and not is_there(path):
        raise InvalidSceneError(
            f"scene {name!r} is neither a file nor built in: {suggest(name, scene_names())}"
        )
    return scene_from_dict(_read(path), base_dir=path.absolute().parent, source=str(path))


def _read(path: Path) -> Any:
    return read_document(path, InvalidSceneError, "a scene (format: 1, name, robot, ...)")


def save_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene file (JSON if the suffix is ``.json``, else YAML), whole or not at all.

    Loading the file returns the same scene; paths in it are relative to its folder.

    Raises:
        InvalidSceneError: a mesh or point cloud was made in memory.
        InvalidRequestError: the file cannot be written.
    """
    path = Path(path)
    document = scene_to_dict(scene, base_dir=path.absolute().parent)
    if path.suffix == ".json":
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    else:
        text = yaml.safe_dump(
            document, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
        )
    write_atomically(path, text.encode("utf-8"))
