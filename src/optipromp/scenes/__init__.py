"""Scenes: objects with roles, their files, and the built-in scenarios."""

from optipromp.scenes.io import load_scene as load_scene
from optipromp.scenes.io import save_scene as save_scene
from optipromp.scenes.io import scene_from_dict as scene_from_dict
from optipromp.scenes.io import scene_names as scene_names
from optipromp.scenes.io import scene_to_dict as scene_to_dict
from optipromp.scenes.scene import Approach as Approach
from optipromp.scenes.scene import JointGoal as JointGoal
from optipromp.scenes.scene import Pose as Pose
from optipromp.scenes.scene import PoseGoal as PoseGoal
from optipromp.scenes.scene import Role as Role
from optipromp.scenes.scene import Scene as Scene
from optipromp.scenes.scene import SceneObject as SceneObject
from optipromp.scenes.scene import Stem as Stem
from optipromp.scenes.scene import ToolSpec as ToolSpec
