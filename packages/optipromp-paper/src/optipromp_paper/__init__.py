"""Planners beside the core's: the paper's own and baselines, which join by entry points."""
