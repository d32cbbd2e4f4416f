"""Costs, constraints, the optimisation problem and its solver."""
