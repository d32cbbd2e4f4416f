"""Experiments: studies, their rows, statistics and tables."""
