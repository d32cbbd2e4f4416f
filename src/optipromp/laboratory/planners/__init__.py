"""Planners beside the core's: the paper's own, and those that studies compare with.

They join by entry points in ``pyproject.toml``, as the planners of any other package do.
"""
