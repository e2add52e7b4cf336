"""Nouns and pure maths that every room shares; numpy and scipy only."""
