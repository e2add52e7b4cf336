"""Flexible mixtures of deformable parts: joints found together by dynamic programming over a tree, from depth."""
