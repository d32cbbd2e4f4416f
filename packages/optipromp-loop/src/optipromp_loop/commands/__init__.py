"""The commands of the loop."""
