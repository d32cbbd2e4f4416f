"""Packs that stand: they slide on their board, and a hand presses them aside."""
