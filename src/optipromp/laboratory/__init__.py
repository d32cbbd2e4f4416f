"""What studies need and no plan does: the paper's planners, and others to compare with."""
