"""Every benchmark of the suite: importing a module registers what it measures."""
