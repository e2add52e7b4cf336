"""Lifting: 2D joints of one person to 3D with a residual fully connected network."""
