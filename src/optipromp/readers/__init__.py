"""Robot readers: what URDF, SRDF, xacro, MJCF and robot files say, as robots of this package.

The core asks for them through the entry points ``optipromp.robot_readers``, and imports none.
"""
