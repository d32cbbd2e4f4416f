"""Shapes, posed obstacles and their signed distances."""

from optipromp.core.geometry.distances import distances as distances
from optipromp.core.geometry.distances import signed_distance as signed_distance
from optipromp.core.geometry.obstacles import Obstacles as Obstacles
from optipromp.core.geometry.obstacles import near as near
from optipromp.core.geometry.obstacles import pack as pack
from optipromp.core.geometry.shapes import Box as Box
from optipromp.core.geometry.shapes import Capsule as Capsule
from optipromp.core.geometry.shapes import Cone as Cone
from optipromp.core.geometry.shapes import Cylinder as Cylinder
from optipromp.core.geometry.shapes import Ellipsoid as Ellipsoid
from optipromp.core.geometry.shapes import HalfSpace as HalfSpace
from optipromp.core.geometry.shapes import MeshShape as MeshShape
from optipromp.core.geometry.shapes import PointCloudShape as PointCloudShape
from optipromp.core.geometry.shapes import Shape as Shape
from optipromp.core.geometry.shapes import Sphere as Sphere
