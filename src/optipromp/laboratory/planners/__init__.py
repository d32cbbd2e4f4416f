"""Planners beside the core's: the paper's own, and those that studies compare with.

They join by the entry points of this package's pyproject.toml, as a stranger's would.
"""
