"""Robots: description files, kinematics, body spheres, tools."""
