"""Scenes: objects with roles, their files, and the built-in scenarios."""

from optipromp.core.scenes.crops import Crop as Crop
from optipromp.core.scenes.crops import load_crop as load_crop
from optipromp.core.scenes.goals import HeldUpright as HeldUpright
from optipromp.core.scenes.goals import Lines as Lines
from optipromp.core.scenes.goals import OnPlane as OnPlane
from optipromp.core.scenes.goals import PathConstraints as PathConstraints
from optipromp.core.scenes.held import Place as Place
from optipromp.core.scenes.io import load_scene as load_scene
from optipromp.core.scenes.io import save_scene as save_scene
from optipromp.core.scenes.io import scene_from_dict as scene_from_dict
from optipromp.core.scenes.io import scene_names as scene_names
from optipromp.core.scenes.io import scene_to_dict as scene_to_dict
from optipromp.core.scenes.objects import ObjectMotion as ObjectMotion
from optipromp.core.scenes.scene import Approach as Approach
from optipromp.core.scenes.scene import Attached as Attached
from optipromp.core.scenes.scene import JointGoal as JointGoal
from optipromp.core.scenes.scene import Pose as Pose
from optipromp.core.scenes.scene import PoseGoal as PoseGoal
from optipromp.core.scenes.scene import RegionGoal as RegionGoal
from optipromp.core.scenes.scene import Role as Role
from optipromp.core.scenes.scene import Scene as Scene
from optipromp.core.scenes.scene import SceneObject as SceneObject
from optipromp.core.scenes.scene import Stem as Stem
from optipromp.core.scenes.scene import ToolSpec as ToolSpec
from optipromp.core.scenes.scene import bare_robot as bare_robot
