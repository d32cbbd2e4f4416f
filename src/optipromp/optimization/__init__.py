"""Functionals, constraints, the problem they make, and its solvers."""
