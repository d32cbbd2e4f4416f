"""The laboratory: simulation, random scenes, studies, and the planners of comparisons."""
