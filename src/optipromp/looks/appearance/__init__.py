"""The looks of robots and scenes as coloured surfaces: for pages, files, films and pictures."""

from optipromp.looks.appearance.arm import arm_parts as arm_parts
from optipromp.looks.appearance.scene import Part as Part
from optipromp.looks.appearance.scene import object_parts as object_parts
from optipromp.looks.appearance.scene import scene_parts as scene_parts
from optipromp.looks.appearance.scene import scenery as scenery
