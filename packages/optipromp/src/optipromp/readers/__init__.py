"""Readers of files that other programs wrote: robots, and demonstrations.

Robots are read from URDF, SRDF, xacro, MJCF and robot files. The core finds the readers by the
entry points ``optipromp.robot_readers`` and ``optipromp.demonstration_readers``, and imports none.
"""
