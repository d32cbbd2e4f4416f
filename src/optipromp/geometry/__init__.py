"""Shapes, posed obstacles and their signed distances."""

from optipromp.geometry.distances import distances as distances
from optipromp.geometry.distances import signed_distance as signed_distance
from optipromp.geometry.obstacles import Obstacles as Obstacles
from optipromp.geometry.obstacles import near as near
from optipromp.geometry.obstacles import pack as pack
from optipromp.geometry.shapes import Box as Box
from optipromp.geometry.shapes import Capsule as Capsule
from optipromp.geometry.shapes import Cone as Cone
from optipromp.geometry.shapes import Cylinder as Cylinder
from optipromp.geometry.shapes import Ellipsoid as Ellipsoid
from optipromp.geometry.shapes import HalfSpace as HalfSpace
from optipromp.geometry.shapes import MeshShape as MeshShape
from optipromp.geometry.shapes import PointCloudShape as PointCloudShape
from optipromp.geometry.shapes import Shape as Shape
from optipromp.geometry.shapes import Sphere as Sphere
