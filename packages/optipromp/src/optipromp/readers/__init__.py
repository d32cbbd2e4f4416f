"""Robot readers: robots from URDF, SRDF, xacro, MJCF and robot files.

The core finds them by the entry points ``optipromp.robot_readers``, and imports none of them.
"""
