"""The compact detector: places vote for joints in 2D and 3D."""
