"""What robots and scenes look like, as coloured surfaces: for pages, files, films and pictures."""

from optipromp.looks.arm import arm_parts
from optipromp.looks.part import Part
from optipromp.looks.scene import object_parts, scene_parts, scenery

__all__ = ["Part", "arm_parts", "object_parts", "scene_parts", "scenery"]
