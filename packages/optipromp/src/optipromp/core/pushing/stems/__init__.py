"""Fruits that hang: their stems bend as beams, and a cup presses fruits and stems aside."""
