"""Bringing a model to the user's own frames, which nobody has labelled."""
