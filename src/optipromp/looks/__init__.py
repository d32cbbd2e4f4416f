"""What robots and scenes look like, as coloured surfaces: for pages, files, films and pictures."""

from optipromp.looks.arm import arm_parts as arm_parts
from optipromp.looks.part import Part as Part
from optipromp.looks.scene import object_parts as object_parts
from optipromp.looks.scene import scene_parts as scene_parts
from optipromp.looks.scene import scenery as scenery
