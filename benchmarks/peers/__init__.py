"""Other planners, each called as its user would call it, on our scenes."""
