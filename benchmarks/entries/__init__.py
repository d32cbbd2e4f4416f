"""Entries of other people's methods, for the benchmark of this library (docs/benchmark.md)."""
