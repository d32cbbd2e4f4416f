"""The commands of the eyes."""
