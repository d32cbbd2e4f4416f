"""The interactive page: look at a plan, move its scene and plan again, record, replay."""
