"""Shapes, posed obstacles and their signed distances."""

from optipromp.geometry.distances import distances, signed_distance
from optipromp.geometry.obstacles import Obstacles, near, pack
from optipromp.geometry.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Shape,
    Sphere,
)

__all__ = [
    "Box",
    "Capsule",
    "Cone",
    "Cylinder",
    "Ellipsoid",
    "HalfSpace",
    "MeshShape",
    "Obstacles",
    "PointCloudShape",
    "Shape",
    "Sphere",
    "distances",
    "near",
    "pack",
    "signed_distance",
]
