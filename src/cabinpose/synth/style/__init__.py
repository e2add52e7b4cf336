"""Depth with the look of a real camera: neural style transfer that keeps to the labels."""
