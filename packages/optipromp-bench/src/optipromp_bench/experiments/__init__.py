"""Experiments: the paper's four scenarios."""
