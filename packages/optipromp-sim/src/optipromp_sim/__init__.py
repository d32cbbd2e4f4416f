"""The simulation, random scenes, photographs and films."""
