"""The looks of robots and scenes, where the viewer looks for them; see :mod:`optipromp.looks`."""

from optipromp.looks import Part, arm_parts, object_parts, scene_parts, scenery

__all__ = ["Part", "arm_parts", "object_parts", "scene_parts", "scenery"]
