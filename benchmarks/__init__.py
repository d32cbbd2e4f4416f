"""The benchmark suite: ours and its peers in one run. Start it with ``python -m benchmarks``."""
