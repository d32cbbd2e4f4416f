"""The commands of the benchmark and studies."""
