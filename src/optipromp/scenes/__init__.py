"""Scenes: objects with roles, their files, and the built-in scenarios."""

from optipromp.scenes.io import load_scene, save_scene, scene_from_dict, scene_names, scene_to_dict
from optipromp.scenes.scene import (
    Approach,
    JointGoal,
    Pose,
    PoseGoal,
    Role,
    Scene,
    SceneObject,
    Stem,
    ToolSpec,
)

__all__ = [
    "Approach",
    "JointGoal",
    "Pose",
    "PoseGoal",
    "Role",
    "Scene",
    "SceneObject",
    "Stem",
    "ToolSpec",
    "load_scene",
    "save_scene",
    "scene_from_dict",
    "scene_names",
    "scene_to_dict",
]
