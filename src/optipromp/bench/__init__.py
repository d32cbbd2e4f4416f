"""A public benchmark of reaching in hanging clutter, and the door of learners to the simulation."""
